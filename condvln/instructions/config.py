"""The numbers that decide what is sampled of a scene. Jobs fill them from the configuration file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from schemas.program import CATEGORIES, Category, Predicate

__all__ = ["COMPASS", "PLAUSIBLE_SHARE", "PREDICATES", "PREDICATE_GROUPS", "Cell", "InstructionConfig", "cell_name"]

COMPASS: Final[tuple[Predicate, ...]] = (
    "east of",
    "north-east of",
    "north of",
    "north-west of",
    "west of",
    "south-west of",
    "south of",
    "south-east of",
)
"""The eight compass predicates, counter-clockwise from east."""

PREDICATE_GROUPS: Final[Mapping[str, tuple[Predicate, ...]]] = {
    "near": ("near",),
    "vertical": ("above", "below"),
    "compass": COMPASS,
    "height": ("higher than", "lower than"),
    "far": ("far from",),
}
"""Predicates that read alike, in the order in which text prefers them."""

PREDICATES: Final[tuple[Predicate, ...]] = tuple(p for group in PREDICATE_GROUPS.values() for p in group)


PLAUSIBLE_SHARE: Final = 0.05
"""A label is plausible in a room type when seen in at least this share of its rooms."""


GROUPS: Final = "counterfactual groups"
"""In place of a cell's name."""


SEEN_FACTOR: Final = 3
"""More candidates are drawn of a cell that asks for an observability or a length of the route, which placing may miss:
few starts give one that is not O2, or have every leaf's route within its bounds."""


PRESENCE_MARGIN: Final = 0.75
"""Part of the allowed share of label-only conditions that is drawn, so that chance doesn't carry it over the bound."""


def _even_compositions() -> dict[str, float]:
    return {"C0": 1.0, "C1": 1.0, "C2": 1.0}


def _group_weights() -> dict[str, float]:
    # Nearness is what people say most; heights are correct but stilted.
    return {"near": 0.45, "vertical": 0.15, "compass": 0.30, "height": 0.10, "far": 0.0}


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of the axes that is asked for: a category, and of the rest what is fixed.

    composition : C0, C1 or C2; moves : the moves of every leaf, so that their number doesn't tell the gold one
    observability : O0, O1 or O2, or O0f for O0 in the first view; it is a matter of placing, not of drawing
    route : least and most metres, both allowed, of the route past its stops to every leaf, so that lengths don't tell
        the gold one; a matter of placing
    words : least and most words of the text, both allowed, its opening with the start heading included
    count : episodes wanted a scene
    """

    category: Category
    composition: str | None = None
    moves: int | None = None
    observability: str | None = None
    count: int = 0
    route: tuple[float, float] | None = None
    words: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """What the tables call it: ``nested C2 O1 3 moves 5-15 m 20-60 words``; a category alone where nothing else is
        fixed. Different cells have different names."""
        moves = None if self.moves is None else f"{self.moves} move{'s' if self.moves > 1 else ''}"
        route = None if self.route is None else f"{_span(self.route)} m"
        words = None if self.words is None else f"{_span(self.words)} words"
        parts = (self.category, self.composition, self.observability, moves, route, words)
        return " ".join(part for part in parts if part)

    def document(self) -> dict[str, Any]:
        """As JSON for a key. Bounds that are not given are left out, so that cells without any keep the keys of
        before there were bounds."""
        bounds = {"route": self.route, "words": self.words}
        absent = [name for name, value in bounds.items() if value is None]
        return {name: value for name, value in asdict(self).items() if name not in absent}

    @property
    def drawn(self) -> bool:
        """Whether anything beside the category is fixed."""
        return self.name != self.category


def _span(bounds: tuple[float, float]) -> str:
    least, most = (str(bound).removesuffix(".0") for bound in bounds)
    return f"{least}-{most}"


def cell_name(cell: Cell | None) -> str:
    """What the tables call a cell, or with None what is of counterfactual groups."""
    return GROUPS if cell is None else cell.name


@dataclass(frozen=True, slots=True)
class InstructionConfig:
    """What to sample, in which mix.

    per_category, candidates_per_episode : candidates drawn a scene are their product; more than episodes wanted, since
        placing rejects some
    moves : shares of leaves with 1, 2 and 3 moves
    label_cap : most of a scene's leaf targets one label may have (an equal share where labels are few)
    presence_false_share : bound on the share of label-only conditions among the false ones in scenes that are one
        room; such scenes resemble each other, so that a label alone predicts its truth
    presence_share : share of label-only conditions, of either truth, in other scenes
    plausible_share : a label is plausible in a room type when seen in this share of its rooms
    preamble : open texts that use compass words with the start heading
    compositions : weights with which C0, C1, C2 are asked for where the scene has the rooms for it
    cells : what is wanted of a category instead of `per_category`, drawn as asked instead of from those mixes
    counterfactual_groups : groups of four programs wanted a scene besides those, of the categories that are wanted
    group_weights : weights of the predicate groups in conditions; 0 = only where nothing else serves
    leaf_separation_single_room, leaf_separation : least horizontal distance of two stops' centres in metres, used
        where no better knowledge (goal to goal geodesics) is supplied
    anchor_size : an anchor whose longest side is shorter (metres) is taken only where there is no larger one
    small_target_weight : weight of labels whose objects are all shorter than `anchor_size`, as targets
    attempts : draws of a condition before the candidate is given up
    draws_per_candidate : draws of whole candidates of one composition and numbers of moves before these are given up
    """

    per_category: Mapping[Category, int] = field(default_factory=lambda: dict.fromkeys(CATEGORIES, 20))
    candidates_per_episode: int = 16
    moves: tuple[float, float, float] = (0.4, 0.4, 0.2)
    label_cap: float = 0.15
    presence_false_share: float = 0.2
    presence_share: float = 0.4
    plausible_share: float = PLAUSIBLE_SHARE
    preamble: bool = True
    compositions: Mapping[str, float] = field(default_factory=_even_compositions)
    cells: tuple[Cell, ...] = ()
    counterfactual_groups: int = 0
    group_weights: Mapping[str, float] = field(default_factory=_group_weights)
    leaf_separation_single_room: float = 1.5
    leaf_separation: float = 2.5
    anchor_size: float = 0.3
    small_target_weight: float = 0.25
    attempts: int = 12
    draws_per_candidate: int = 20

    def cells_of(self, category: Category) -> tuple[Cell, ...]:
        """What is wanted of a category: its cells, or its number in `per_category` from the mixes."""
        asked = tuple(cell for cell in self.cells if cell.category == category)
        count = self.per_category.get(category, 0)
        return asked or ((Cell(category, count=count),) if count else ())

    @property
    def wanted(self) -> tuple[Cell, ...]:
        """All that is wanted of a scene, in the order of the categories."""
        return tuple(cell for category in CATEGORIES for cell in self.cells_of(category))

    def document(self) -> dict[str, Any]:
        """As JSON for a key."""
        return asdict(self) | {"cells": [cell.document() for cell in self.cells]}

    def candidates(self, cell: Cell) -> int:
        """Candidates wanted of a cell; more where placing may miss what it asks for."""
        return cell.count * self.candidates_per_episode * (SEEN_FACTOR if cell.observability or cell.route else 1)

    def label_only(self, single_room: bool) -> float:
        """Share of label-only conditions, drawn whatever their truth, so that the kind says nothing about it."""
        return PRESENCE_MARGIN * self.presence_false_share if single_room else self.presence_share
