"""Check the step budgets of a scene's episodes against the configuration, the walks and the texts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from condvln.verify.findings import Findings
from condvln.verify.heading import yaw_of
from condvln.verify.rules import VerifierRules
from condvln.verify.scene_leaves import SceneLeaves
from condvln.verify.walks import Walks
from schemas.config.constants import GROUP_SIZE
from schemas.evaluation import ManifestEpisode

__all__ = ["check_budgets"]

F64 = NDArray[np.float64]


def check_budgets(
    rows: Sequence[ManifestEpisode],
    placed: SceneLeaves,
    points: F64,
    findings: Findings,
    walks: Walks,
    rules: VerifierRules,
) -> None:
    """Check the step budget of each row against the configuration, the actions of the longest leaf and, if the budget
    is proportional to the text, the number of words. Rows whose start is not turned about the vertical are left out.
    """
    yaws = [yaw_of(row.start_rotation) for row in rows]
    upright = np.array([yaw is not None for yaw in yaws])
    findings.rows("start_rotation", upright, lambda k: ("a turn about the vertical", rows[k].start_rotation))
    leaves = np.flatnonzero(upright[placed.row])
    stop_counts = np.diff(placed.stop_ends, prepend=0)
    walked = upright[placed.row]
    ends = placed.goals[placed.ends_of_paths()]
    counts = stop_counts[leaves] + 1
    last = np.cumsum(counts)
    stops = np.empty(int(counts.sum()), np.int64)
    inner = np.ones(len(stops), dtype=bool)
    inner[last - 1] = False
    stops[inner], stops[last - 1] = placed.stops[np.repeat(walked, stop_counts)], ends[leaves]
    own = placed.row[leaves]
    turned = np.array([yaw or 0.0 for yaw in yaws])
    lengths = walks.lengths(points, placed.start[own], turned[own], stops, last)
    arrived, outcome = np.ones(len(placed.leaves), dtype=bool), dict(zip(leaves.tolist(), lengths, strict=True))
    arrived[leaves] = [length.arrived for length in lengths]
    findings.leaves("budget", arrived, lambda k: ("a walk that arrives", outcome[k].outcome), of=upright)
    steps = np.zeros(len(rows), np.int64)
    np.maximum.at(steps, own, [length.actions for length in lengths])
    twice, ceiling, per_word = 2 * steps, rules.episodes.step_ceiling, rules.text.steps_per_word
    findings.rows(
        "budget",
        twice <= ceiling,
        lambda k: (f"at most {ceiling}", int(twice[k])),
        "twice the actions",
        of=upright,
    )
    members = _members(rows)
    alone = np.array([row.group_id is None for row in rows])
    findings.rows(
        "group",
        np.array([len(its) == GROUP_SIZE for its in members]),
        lambda k: (GROUP_SIZE, len(members[k])),
        lambda k: f"members of {rows[k].group_id}",
        of=upright & ~alone,
    )
    expected = [ceiling] * len(rows)
    if rules.episodes.max_steps == "proportional":
        expected = [max(per_word * max(its), actions) for its, actions in zip(members, twice.tolist(), strict=True)]
    right = np.array([row.max_steps == its for row, its in zip(rows, expected, strict=True)])
    findings.rows("budget", right, lambda k: (rows[k].max_steps, expected[k]), of=upright)


def _members(rows: Sequence[ManifestEpisode]) -> list[list[int]]:
    """Return for each row the numbers of words of the texts of its counterfactual group, or of its own text if it has
    no group. All step budgets of a group follow from the group's longest text.
    """
    words = [len(row.instruction_text.split()) for row in rows]
    groups: dict[str, list[int]] = {}
    for row, count in zip(rows, words, strict=True):
        if row.group_id is not None:
            groups.setdefault(row.group_id, []).append(count)
    return [[count] if row.group_id is None else groups[row.group_id] for row, count in zip(rows, words, strict=True)]
