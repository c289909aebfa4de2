"""Candidate programs of a scene, drawn as placing asks for them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from condvln.instructions.cell_drawing import CellDrawing, Seen
from condvln.instructions.programs import instruction_id
from condvln.instructions.sampling import ProgramSampler, group_id
from condvln.own_tables import own_rows
from schemas.config import InstructionCell
from schemas.config.constants import GROUP_SIZE
from schemas.program import CATEGORIES, SHAPES, Category, Program

__all__ = [
    "DRAWING",
    "PLACING",
    "REASONS",
    "UNPLACED",
    "Candidate",
    "CandidateSupply",
    "cell_name",
    "draw_candidates",
    "unplaced_programs",
    "unplaced_table",
]


DRAWING: Final = "programs"
PLACING: Final = "episodes"
"""What rejects, in the column ``stage`` of the rejections table: draws of programs that fail, and candidates that can't
be placed.
"""

REASONS: Final = {row["reason"]: row["meaning"] for row in own_rows("condvln.episodes", "rejections.csv")}
"""All reasons for which placing rejects a candidate, as counted in the rejections table, from ``rejections.csv``."""


GROUPS: Final = "counterfactual groups"
"""Cell name of the candidates in counterfactual groups."""

UNPLACED: Final = pa.schema([("instruction_id", pa.string())])
"""Schema of the ids of instructions that are published without an episode because their scene has no navmesh; stored in
the unit.
"""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A program to be placed, and the cell for which it was drawn; `cell` is None for a member of a counterfactual
    group.
    """

    instruction_id: str
    program: Program
    cell: InstructionCell | None
    group_id: str | None = None

    @property
    def moves(self) -> tuple[int, ...]:
        """Number of moves of each leaf."""
        return tuple([len(leaf.moves) for leaf in self.program.leaves])

    @property
    def labels(self) -> tuple[str, ...]:
        """Target label of each leaf."""
        return tuple([leaf.moves[-1].label for leaf in self.program.leaves])

    @property
    def gold(self) -> int:
        """Index of the gold leaf."""
        return self.program.gold_leaf()


def cell_name(cell: InstructionCell | None) -> str:
    """Return the name of a cell in the tables; None gives the name for counterfactual groups."""
    return GROUPS if cell is None else cell.name


def draw_candidates(sampler: ProgramSampler) -> list[Candidate]:
    """Draw all candidates, for a scene in which none is placed: the programs of each cell, then the counterfactual
    groups, which may repeat some programs.
    """
    supply = CandidateSupply(sampler)
    found = [supply.candidate(program, cell) for category in CATEGORIES for cell, program in sampler.drawn(category)]
    while group := supply.group():
        found += group
    return found


class CandidateSupply:
    """Draws the candidates of a scene one after the other, as placing asks for them. Counterfactual groups may repeat
    programs of cells.

    Attributes
    ----------
    labels : number of labels that leaves of the scene can have
    group_leaves : mean number of leaves of all programs of a counterfactual group
    """

    def __init__(self, sampler: ProgramSampler) -> None:
        self._sampler = sampler
        self._groups = sampler.groups()
        self._seen: defaultdict[Category, Seen] = defaultdict(Seen)
        self._drawings: dict[tuple[InstructionCell, bool], CellDrawing | None] = {}
        self.labels = len(sampler.stop_sampler.weights)
        leaves = [SHAPES[category].leaves for category in CATEGORIES if sampler.wanted.cells_of(category)]
        self.group_leaves = GROUP_SIZE * sum(leaves) / max(1, len(leaves))

    def candidate(self, program: Program, cell: InstructionCell | None, group: str | None = None) -> Candidate:
        """Return a candidate of the scene."""
        scene = self._sampler.scene
        return Candidate(instruction_id(scene.family, scene.scene_id, program), program, cell, group)

    def group(self) -> list[Candidate]:
        """Return the next counterfactual group; empty if there are no more."""
        group = next(self._groups, ())
        if not group:
            return []
        name = group_id(self._sampler.scene.family, self._sampler.scene.scene_id, group)
        return [self.candidate(program, None, name) for program in group]

    def leads_of(self, cell: InstructionCell) -> int:
        """Return how many episodes of a cell shall have leads."""
        return round(self._sampler.leads_of(cell) * cell.count)

    def more(
        self,
        cell: InstructionCell,
        count: int,
        golds: Sequence[int],
        moves: Sequence[float] | None,
        leads: bool = False,
    ) -> list[Candidate]:
        """Return the next `count` candidates of a cell, fewer if the cell is exhausted.

        golds : their gold leaves, which are dealt in a random order, and again if there are fewer than `count`
        moves : shares of their leaves with 1, 2, … moves; None for the shares of the configuration
        leads : whether they have leads; each kind is exhausted by itself
        """
        if (cell, leads) not in self._drawings:
            self._drawings[cell, leads] = self._sampler.drawing(cell, self._seen[cell.category], leads=leads)
        drawing = self._drawings[cell, leads]
        if drawing is None:
            return []
        drawing.aim(golds, moves or self._sampler.sampling.drawn_move_shares(cell.category))
        return [self.candidate(program, cell) for program in self._sampler.programs(cell, drawing, count)]


def unplaced_programs(candidates: Iterable[Candidate]) -> list[str]:
    """Return the ids of the programs to keep if a scene's programs can't be placed: the first ones of each cell, up to
    the number of programs that the cell asks for.

    As in a pool of episodes, no gold index gets more than its equal share of a cell. Without a navmesh there are
    neither starts, views nor routes, so a cell's limits on observability, routes and shared starts are ignored.
    """
    taken: Counter[InstructionCell] = Counter()
    golds: dict[InstructionCell, Counter[int]] = defaultdict(Counter)
    chosen = []
    for candidate in candidates:
        cell, gold = candidate.cell, candidate.program.gold_leaf()
        if cell is None:
            continue
        quota = -(-cell.count // len(candidate.program.leaves))
        if taken[cell] >= cell.count or golds[cell][gold] >= quota:
            continue
        taken[cell] += 1
        golds[cell][gold] += 1
        chosen.append(candidate.instruction_id)
    return chosen


def unplaced_table(names: Iterable[str]) -> pa.Table:
    """Return the program ids `names` as rows of the schema UNPLACED."""
    return pa.table({"instruction_id": pa.array(names, pa.string())}, schema=UNPLACED)
