"""The ladder of agents: an oracle, an agent that looks with more and more errors, and guessers.

``python -m benchmarks ladder`` makes episodes in made scenes, and in real ones where their folder is there
(CONDVLN_REAL_DATA, or shared/data beside the checkout), walks every agent through them, and writes the tables of
docs/ladder.md. CONDVLN_LADDER sets the number of episodes of a category and scene, CONDVLN_LADDER_WORKERS that of
processes. Errors are paired: a level keeps the errors of the one below. With CONDVLN_LADDER_ROWS, a file, every scene's
results are added to it once its agents have walked; a run that was stopped goes on from there. CONDVLN_LADDER_SCENES is
the number of scenes to take: no more of them than the file has results of are printed without walking. Scenes whose
building has no mesh at hand, so that neither walls nor floor are seen, are left out.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from condvln.evaluation.agents import AGENTS
from condvln.evaluation.aggregate import estimate
from condvln.evaluation.looker import LookingAgent
from condvln.evaluation.score import score
from condvln.evaluation.task import Task, task_of
from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.world import World, label_priors, open_world
from schemas.config import InstructionsConfig, LookerConfig, NoiseConfig
from schemas.program import CATEGORIES

REPOSITORY: Final = Path(__file__).resolve().parents[1]
PAGE: Final = REPOSITORY / "docs" / "ladder.md"
MARK: Final = "<!-- ladder: python -m benchmarks ladder -->"
REAL: Final = Path(os.environ.get("CONDVLN_REAL_DATA", REPOSITORY.parent / "shared" / "data"))
PER_CATEGORY: Final = int(os.environ.get("CONDVLN_LADDER", "1"))
MADE: Final = {"procthor": 6, "replicacad": 6}
SCANNED: Final = {"procthor": 12, "ithor": 7, "replicacad": 6}
LEVELS: Final = (0.0, 0.1, 0.2, 0.3)
GUESSERS: Final = ("oracle", "coin-flip", "nearest", "random-leaf")
OTHERS: Final = {
    "looker, 20 % of answers wrong": LookerConfig(logic=0.2),
}


@dataclass(frozen=True)
class Row:
    """The result of one agent in one episode; `why` it failed, empty where it did not."""

    agent: str
    data: str
    scene: str
    category: str
    seen: str
    episode: str
    success: float
    bsa: float
    csr: float
    right: float
    steps: float
    why: str


def agents() -> dict[str, LookerConfig | str]:
    """Return all rungs by name: a configuration of the agent that looks, or the name of another agent."""
    rungs: dict[str, LookerConfig | str] = {"oracle": "oracle"}
    for level in LEVELS:
        noise = NoiseConfig(missed=level, confused=level, false=level)
        rungs[f"looker, {level:.0%} noise" if level else "looker"] = LookerConfig(noise=noise)
    return rungs | OTHERS | {name: name for name in GUESSERS if name != "oracle"}


@cache
def scenes_of(data: str, made: Path) -> tuple[Any, list[str], Any]:
    """Return the source of ``made/<family>`` or ``real/<family>``, the ids of the scenes that are taken, and how usual
    labels are in them.

    made : folder of the made scenes of all families
    """
    kind, _, family = data.partition("/")
    if kind == "real":
        source = open_source(family, REAL / family)
        names = source.scene_ids()[: SCANNED[family]]
    else:
        source = open_source(family, made / family)
        names = source.scene_ids()
    return source, names, label_priors(source.read(name) for name in names)


def walked(job: tuple[str, int], made: Path) -> list[Row]:
    """Walk every agent through the episodes of one scene, given by its data and its number there."""
    data, number = job
    source, names, priors = scenes_of(data, made)
    if number >= len(names):
        return []
    world = open_world(source, names[number])
    if world.geometry is None:
        return []  # the mesh of the building is missing: neither walls nor floor are seen
    wanted = InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY), counterfactual_groups=0)
    tasks = [task_of(row) for row in world.episodes(instructions=wanted, priors=priors)]
    return [row for name, rung in agents().items() for row in in_scene(data, name, rung, world, tasks)]


def in_scene(data: str, name: str, rung: LookerConfig | str, world: World, tasks: Sequence[Task]) -> Iterator[Row]:
    """Walk one agent through the episodes of one scene."""
    looking = None if isinstance(rung, str) else LookingAgent(lambda scene: world, rung)
    for task in tasks:
        why = ""
        if looking is None:
            assert isinstance(rung, str)
            prediction = AGENTS[rung](task, world.pathfinder, 0)
            leaf = None
        else:
            walk = looking.walk(task, world.pathfinder, 0)
            prediction, leaf = walk.prediction, walk.leaf
        found = score(task, prediction, world.pathfinder)
        if not found.csr_all:
            if leaf is not None and leaf != task.gold_leaf:
                why = "not decided in time" if walk.forced else "a condition judged wrongly"
            elif not found.stopped:
                why = "the budget ended"
            elif not found.success:
                why = "stopped elsewhere"
            else:
                why = "a stop on the way missed"
        right = found.leaf_correct if leaf is None else float(leaf == task.gold_leaf)
        yield Row(
            name,
            data,
            str(task.axes["scene"]),
            str(task.axes["category"]),
            str(task.axes["observability"] or "unknown")[:2],
            task.episode_id,
            found.success,
            found.bsa_all,
            found.csr_all,
            right,
            found.steps,
            why,
        )


def cell(rows: Sequence[Row], measure: str) -> str:
    """Format a mean in percent with its interval over scenes."""
    if not rows:
        return "–"
    found = estimate(np.array([getattr(row, measure) for row in rows], np.float64), [row.scene for row in rows])
    interval = "" if np.isnan(found.low) else f" ({100 * found.low:.0f}–{100 * found.high:.0f})"
    return f"{100 * found.mean:.1f}{interval}"


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    rule = ["---"] * len(head)
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *lines))


def grouped(rows: Sequence[Row], key: Callable[[Row], str], names: Sequence[str]) -> str:
    """Format a table of every agent's CSR-all by some property of episodes."""
    values = sorted({key(row) for row in rows})
    lines = [
        [name, *(cell([row for row in rows if row.agent == name and key(row) == value], "csr") for value in values)]
        for name in names
    ]
    return table(["agent", *values], lines)


def page(rows: Sequence[Row]) -> str:
    """Format all tables."""
    names = [name for name in agents() if any(row.agent == name for row in rows)]
    main_lines = []
    for name in names:
        own = [row for row in rows if row.agent == name]
        cells = [cell(own, measure) for measure in ("csr", "success", "bsa", "right")]
        main_lines.append([name, *cells, f"{np.mean([row.steps for row in own]):.0f}"])
    count = len({(row.data, row.episode) for row in rows})
    looker = [row for row in rows if row.agent == "looker"]
    reasons = Counter((row.why, row.data) for row in looker if row.why)
    data = sorted({row.data for row in rows})
    kinds = sorted({why for why, _ in reasons})
    counts = [[why, *(str(reasons.get((why, name), 0)) for name in data)] for why in kinds]
    order = [name for name in CATEGORIES if any(row.category == name for row in rows)]
    category = table(
        ["agent", *order],
        [[n, *(cell([r for r in rows if r.agent == n and r.category == c], "csr") for c in order)] for n in names],
    )
    return "\n\n".join(
        [
            f"{count} episodes in {len({row.scene for row in rows})} scenes: {', '.join(data)}. Percent, with 95 % "
            "intervals over scenes.",
            table(["agent", "CSR-all", "SR", "BSA", "right branch", "steps"], main_lines),
            "CSR-all by data:",
            grouped(rows, lambda row: row.data, names),
            "CSR-all by category:",
            category,
            "CSR-all by where the evidence is seen (O0 from the start, O1 on the way, O2 after a detour):",
            grouped(rows, lambda row: row.seen, names),
            "Why `looker` without noise fails, episodes:",
            table(["cause", *data], counts),
        ]
    )


def header() -> dict[str, Any]:
    """Return what results depend on, beside the code: the first line of the file that keeps them."""
    return {"episodes of a category": PER_CATEGORY, "agents": [*agents()], "made": MADE, "real": SCANNED}


def kept_rows(path: Path) -> dict[tuple[str, int], list[Row]]:
    """Return the results in a file by scene; a file that is not there, or has no whole line, begins with its header.

    A last line that is cut, because its writer was killed, is removed.

    Raises
    ------
    SystemExit : the results are of other settings
    """
    data = path.read_bytes() if path.exists() else b""
    whole = data[: data.rfind(b"\n") + 1]
    first, *lines = whole.decode().split("\n")[:-1] or [json.dumps(header())]
    if first != json.dumps(header()):
        raise SystemExit(
            f"{path}: these results are not of the settings {json.dumps(header(), ensure_ascii=False)}. Set "
            "CONDVLN_LADDER as it was, or name another file."
        )
    if whole:
        os.truncate(path, len(whole))
    else:
        path.write_text(first + "\n", encoding="utf-8")
    found = {}
    for data, number, rows in map(json.loads, lines):
        found[data, number] = [Row(**row) for row in rows]
    return found


def walked_all(jobs: Sequence[tuple[str, int]]) -> list[Row]:
    """Walk every agent through all scenes, except those whose results are in the file of CONDVLN_LADDER_ROWS."""
    kept = Path(os.environ["CONDVLN_LADDER_ROWS"]) if "CONDVLN_LADDER_ROWS" in os.environ else None
    done = {} if kept is None else kept_rows(kept)
    left = [job for job in jobs if job not in done]
    if left:
        with tempfile.TemporaryDirectory(prefix="ladder") as name:
            made = Path(name)
            for family in sorted({data.partition("/")[2] for data, _ in left if data.startswith("made/")}):
                make_samples(made / family, family=family, scenes=MADE[family], seed=11)
            with ProcessPoolExecutor(int(os.environ.get("CONDVLN_LADDER_WORKERS", "2"))) as pool:
                for job, rows in zip(left, pool.map(partial(walked, made=made), left), strict=True):
                    done[job] = rows
                    if kept is not None and rows:
                        with kept.open("a", encoding="utf-8") as file:
                            file.write(json.dumps([*job, [asdict(row) for row in rows]]) + "\n")
    return [row for job in jobs for row in done[job]]


def main() -> None:
    """Walk all agents and write the page."""
    counts = {f"made/{family}": count for family, count in MADE.items()}
    counts |= {f"real/{family}": count for family, count in SCANNED.items() if (REAL / family).is_dir()}
    # In turn, so that a run that is stopped has scenes of all data.
    jobs = [(data, number) for number in range(max(counts.values())) for data in counts if number < counts[data]]
    text = page(walked_all(jobs[: int(os.environ.get("CONDVLN_LADDER_SCENES", len(jobs)))]))
    before = PAGE.read_text(encoding="utf-8").split(MARK)[0] if PAGE.exists() else "# The ladder\n\n"
    PAGE.write_text(f"{before}{MARK}\n\n{text}\n", encoding="utf-8")
    sys.stdout.write(f"{text}\n\n{PAGE}\n")
