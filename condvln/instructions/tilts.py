"""By how much the weights of statements are changed so that over all scenes of a family each is drawn about as often
where it is true as where it is false.

A statement that is true in 97 of 100 rooms has a small weight where it is true. But each scene asks as much as any
other, so that in a room where all else has little weight too, it is asked all the same. Here the draws of all rooms are
computed, and one factor for each statement is fitted (``condvln.instructions.expected_draws``). The excess that is
aimed at is about that of a fair coin, and of the truth that a coin says, so that the excesses of a label's statements
do not add up.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.instructions.expected_draws import (
    ExpectedDraws,
    coins,
    rounded_octaves,
)
from condvln.instructions.informative import LabelForm, statement_weights
from condvln.instructions.predicates import GROUP_OF, PREDICATE_GROUPS, sayable
from condvln.instructions.statement_rows import (
    STATEMENT,
    CodedTexts,
    Statement,
    numbered,
    numbered_statements,
    of_each,
)
from schemas.config import SamplingConfig
from schemas.program import asked_in

__all__ = ["SceneRows", "tilts"]

COIN_PART: Final = 0.9
"""Part of a fair coin's excess that is aimed at. With 0, betting against a statement's truth in 800 made houses is
right in 64 % of the draws expected in 200 others; with 0.7, in 54 %; with 1, betting on it is right in 51 %."""

SCENES_ADDED: Final = 30.0
"""Number of scenes whose draws are added to either truth of a statement. Statements of few scenes are changed less:
those with one truth would never be asked otherwise, and scenes with little to ask would be left with nothing. Eleven
scans of Gibson give 46 texts with 10 and 50 texts with 30; 1,000 made houses pass the bias gate with either."""

MOST_SCENES: Final = 8192
"""Number of scenes of a family beyond which every second one is left out, so that the rows that are kept do not grow
with the corpus: of so many houses of ProcTHOR the fit takes 1.1 GB."""

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class _Read(NamedTuple):
    """Occurrences (n,) by number of statement, truth, scene and room."""

    own: NDArray[np.int32]
    truth: NDArray[np.int8]
    scene: NDArray[np.int32]
    room: NDArray[np.int32]


class SceneRows:
    """The occurrences of statements in the rooms of a family's scenes, collected scene by scene from rows as
    ``LabelPriors.of_scene`` counts them. A row without a label begins a room.
    """

    def __init__(self, family: str, directions: str, most_scenes: int = MOST_SCENES) -> None:
        self._most = most_scenes
        self._step = 1
        self._seen = 0
        self._asked = {"", *(asked_in(family) & sayable(directions))}
        self._pending: list[pa.Table] = []
        self._rows = self._scenes = 0
        self._numbers: dict[Statement, int] = {}
        self._rooms: list[int] = []
        self._read: list[_Read] = []

    def add(self, rows: pa.Table, most: int) -> None:
        """Add the rows of one scene, unless it is one of those that are left out. They are kept as they are until there
        are `most` of them.
        """
        self._seen += 1
        if (self._seen - 1) % self._step:
            return
        self._pending.append(rows)
        self._rows += rows.num_rows
        if self._rows > most:
            self.read()

    def read(self) -> None:
        """Read the rows that were only kept."""
        if not self._rows:
            self._pending = []
            return
        table = pa.concat_tables(self._pending).combine_chunks()
        scene = self._scenes + np.repeat(np.arange(len(self._pending)), [one.num_rows for one in self._pending])
        self._scenes += len(self._pending)
        self._pending, self._rows = [], 0
        texts = [CodedTexts.of(table[name]) for name in STATEMENT[:-1]]
        _, label, predicate, _ = texts
        begins = label.among({""})
        room = len(self._rooms) - 1 + np.cumsum(begins)
        self._rooms += scene[begins].tolist()
        said = np.flatnonzero(~begins & predicate.among(self._asked))
        own, found = numbered_statements(texts, table["definite"].to_numpy(), said)
        known = self._numbers
        own = np.array([known.setdefault(statement, len(known)) for statement in found], np.int64)[own]
        for truth, name in ((0, "n_false"), (1, "n_true")):
            at = np.flatnonzero(table[name].to_numpy()[said] > 0)
            self._read.append(
                _Read(
                    own[at].astype(np.int32),
                    np.full(len(at), truth, np.int8),
                    scene[said[at]].astype(np.int32),
                    room[said[at]].astype(np.int32),
                )
            )
        while self._scenes > self._most:
            self._halve()

    def _halve(self) -> None:
        """Leave out every second scene."""
        kept = [_Read(*(column[one.scene % 2 == 0] for column in one)) for one in self._read]
        scenes = np.array(self._rooms, np.int32)
        place = np.cumsum(scenes % 2 == 0, dtype=np.int32) - 1
        self._read = [one._replace(scene=one.scene // 2, room=place[one.room]) for one in kept]
        self._rooms = (scenes[scenes % 2 == 0] // 2).tolist()
        self._scenes, self._step = (self._scenes + 1) // 2, 2 * self._step

    @property
    def statements(self) -> list[Statement]:
        """The statements by number."""
        return list(self._numbers)

    def occurrences(self) -> _Read:
        """Return number of the statement, truth, scene and room of each occurrence."""
        return _Read(*(np.concatenate(column) for column in zip(*self._read, strict=True)))

    @property
    def scene_of_room(self) -> I64:
        """The scene of each room."""
        return np.array(self._rooms, np.int64)


def tilts(
    rows: SceneRows,
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
) -> dict[Statement, int]:
    """Return, by statement, by how many steps (``FACTOR_STEPS`` make an octave) its weight is raised where it is true
    and lowered where it is false; negative, the other way round. Statements that keep their weights are left out.

    Parameters
    ----------
    counts : number of rooms, of all families, in which each statement is true and false, and, for a label that is
        empty, of all rooms of the type
    label_factors : see ``PriorBits.label_weights``
    """
    rows.read()
    statements = rows.statements
    if not statements:
        return {}
    own, truth, scene, room = rows.occurrences()
    weights = _weights(statements, counts, label_factors, sampling)[truth, own]
    present = np.array([not predicate for _, _, predicate, _, _ in statements], bool)
    scene_of_room = rows.scene_of_room
    alone = np.bincount(scene_of_room)[scene] == 1
    kept = (weights > 0) & ~(present[own] & alone)  # of a single room, absence is claimed by the labels of other scenes
    own, truth, scene, room, weights = own[kept], truth[kept], scene[kept], room[kept], weights[kept]
    del kept
    if not len(own):
        return {}
    groups = {name: k for k, name in enumerate(PREDICATE_GROUPS)}
    of_predicate: dict[str, int] = {name: groups[group] for name, group in GROUP_OF.items()}
    of_predicate[""] = len(groups)
    group_of = np.array([of_predicate[p] for _, _, p, _, _ in statements], np.int64)
    forms = {form: k for k, form in enumerate(dict.fromkeys((p, definite) for _, _, p, _, definite in statements))}
    form_of = np.array([forms[p, definite] for _, _, p, _, definite in statements], np.int64)
    form, first = numbered(room, form_of[own])
    group, _ = numbered(room, group_of[own])
    said = np.array([*(getattr(sampling.predicates, name) for name in groups), 0.0])
    asked = np.where(present, sampling.label_only(single_room=False), 0.0)
    room_of_group = of_each(group, room)
    draws = ExpectedDraws(
        own,
        truth,
        scene,
        weights,
        form=form,
        group_of_form=group[first],
        room_of_group=room_of_group,
        group_weights=of_each(group, said[group_of[own]]),
        presence=of_each(group, asked[own]),
        room_weights=1.0 / np.bincount(scene_of_room)[scene_of_room],
    )
    octaves = draws.octaves(COIN_PART * coins(statements)[: draws.count], SCENES_ADDED)
    steps = rounded_octaves(octaves)
    return {statements[k]: int(steps[k]) for k in np.flatnonzero(steps).tolist()}


def _weights(
    statements: list[Statement],
    counts: Mapping[Statement, tuple[int, int]],
    label_factors: Mapping[LabelForm, tuple[float, float]],
    sampling: SamplingConfig,
) -> F64:
    """Return the weights of the statements without tilts, (2, s): where they are false and where they are true."""
    counted = np.array([counts.get(one, (0, 0)) for one in statements], np.float64)
    factors = np.array([label_factors.get((t, x, p, d), (1.0, 1.0)) for t, x, p, _, d in statements])
    weights = statement_weights(counted)
    found: F64 = np.stack([weights[False], weights[True]]) * factors.T
    present = np.array([not one[2] for one in statements], bool)
    rooms = np.array([counts.get((one[0], "", "", "", False), (0, 0))[0] for one in statements], np.float64)
    there = counted[:, 0]
    plausible = there >= sampling.plausible_share * rooms
    varies = plausible & (rooms - there >= sampling.plausible_share * rooms)
    found[0] *= np.where(present, plausible, 1.0)
    found[1] *= np.where(present, varies, 1.0)
    return found
