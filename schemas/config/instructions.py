"""What is wanted of each scene: instructions and cells, the sampling of candidates, and their wording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import Field, field_validator, model_validator

from schemas.base import Finite, Metres, Section, Share
from schemas.config.constants import MOST_MOVES_OF_FOUR_LEAVES
from schemas.episode import Composition
from schemas.program import CATEGORIES, SHAPES, Category

__all__ = [
    "PAPER",
    "CompositionWeights",
    "InstructionCell",
    "InstructionsConfig",
    "PredicateWeights",
    "SamplingConfig",
    "TextConfig",
    "VoiceName",
    "WordingConfig",
]

VoiceName = Literal["brief", "check", "question", "otherwise", "formal", "list"]
"""Voices: ways to word an instruction. ``condvln/instructions/grammar`` holds their phrases."""

Wanted = Annotated[int, Field(ge=0, le=10_000)]
"""Number of episodes wanted per scene. It is bounded since all candidates are held in memory."""

Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]

SEEN_FACTOR: Final = 3
"""Factor on the candidates of a cell that asks for an observability or a route length, since placing rejects many of
them."""

PRESENCE_MARGIN: Final = 0.75
"""Fraction of the allowed share of label-only conditions that is drawn, so that random variation stays within the
bound."""


class InstructionCell(Section):
    """One cell: values of the axes, and the episodes wanted per scene. An axis that is not given may have any value."""

    category: Category
    """shape of the program"""
    composition: Composition | None = None
    """composition: how many rooms the program spans"""
    observability: Literal["O0f", "O0", "O1", "O2"] | None = None
    """observability: where the evidence is visible: O0 from the start, O0f of these in the first view, O1 on the way
    that all leaves share, O2 after a detour only"""
    moves: int | None = Field(None, ge=1, le=3)
    """number of moves of every leaf; it is the same for all leaves, so that it doesn't reveal the gold leaf"""
    route: tuple[Finite, Finite] | None = Field(None, json_schema_extra={"unit": "m"})
    """[minimum, maximum] length of the route through the stops to every leaf"""
    leads: Literal["with", "without"] | None = None
    """whether programs have leads, in scenes of several rooms with a navmesh; if not given, instructions.leads says how
    many have"""
    words: tuple[int, int] | None = None
    """[minimum, maximum] number of words of the text, including the opening with the start heading"""
    count: int = Field(ge=1, le=10_000)
    """number of episodes wanted per scene"""

    @field_validator("route", "words", mode="before")
    @classmethod
    def _yes_is_no_bound(cls, value: Any) -> Any:
        if isinstance(value, list | tuple) and any(isinstance(bound, bool) for bound in value):
            raise ValueError("true and false are not allowed as bounds; write [least, most]")
        return value

    @model_validator(mode="after")
    def _moves_fit_the_leaves(self) -> InstructionCell:
        most = MOST_MOVES_OF_FOUR_LEAVES
        if self.moves is not None and self.moves > most and SHAPES[self.category].leaves == 4:
            raise ValueError(f"moves: {self.category} has four leaves, of at most {most} moves each, got {self.moves}")
        return self

    @model_validator(mode="after")
    def _bounds_are_ranges(self) -> InstructionCell:
        if self.route is not None and not 0 <= self.route[0] < self.route[1]:
            least, most = self.route
            raise ValueError(
                f"route: the first bound must be at least 0 m and below the second, got [{least:g}, {most:g}]"
            )
        if self.words is not None and not 1 <= self.words[0] <= self.words[1]:
            raise ValueError(
                f"words: the first bound must be at least 1 and at most the second, got {list(self.words)}"
            )
        return self

    @property
    def name(self) -> str:
        """Return the cell's name in the tables: ``nested C2 O1 3 moves 5-15 m 20-60 words``, or the category alone
        where nothing else is fixed. Different cells have different names.
        """
        moves = None if self.moves is None else f"{self.moves} move{'s' if self.moves > 1 else ''}"
        route = None if self.route is None else f"{_span(self.route)} m"
        words = None if self.words is None else f"{_span(self.words)} words"
        leads = f"{self.leads} leads" if self.leads else None
        parts = (self.category, self.composition, self.observability, moves, leads, route, words)
        return " ".join(part for part in parts if part)

    @property
    def drawn(self) -> bool:
        """Whether the cell fixes any axis besides the category."""
        return self.name != self.category


def _span(bounds: tuple[float, float]) -> str:
    least, most = (str(bound).removesuffix(".0") for bound in bounds)
    return f"{least}-{most}"


class WordingConfig(Section):
    """Wording of programs. Only the text stage reads it, unless a cell bounds the number of words."""

    language: Literal["en", "es"] = "en"
    """language of the texts: English or Spanish"""
    voices: tuple[VoiceName, ...] = Field(get_args(VoiceName), min_length=1)
    """voices that texts are drawn from; each text has one voice"""
    length: Literal["any", "short"] = "any"
    """any: wordings are drawn from all templates of the voice; short: always from its shortest templates"""

    @model_validator(mode="after")
    def _voices_differ(self) -> WordingConfig:
        twice = sorted({name for name in self.voices if self.voices.count(name) > 1})
        if twice:
            raise ValueError(f"voices: {', '.join(twice)} occurs twice")
        return self

    @property
    def wording(self) -> WordingConfig:
        """Return the keys of the wording alone."""
        return WordingConfig(language=self.language, voices=self.voices, length=self.length)


class InstructionsConfig(WordingConfig):
    """The instructions that are wanted of each scene, and their wording."""

    directions: Literal["compass", "egocentric", "none"] = "compass"
    """directions that texts may use. compass: compass words, and such texts open with the start heading; egocentric:
    left, right, ahead and behind as seen from the start; none: no directions"""
    style: Literal["natural", "paper"] = "natural"
    """natural: one is sent to a place before it is decided there, goals go with what is asked, compass words are rare;
    paper: the form of the paper, that is other defaults of leads, thresholds.sector_within and keys of sampling"""
    per_category: dict[Category, Wanted] = Field(default_factory=lambda: dict.fromkeys(CATEGORIES, 20))
    """number of episodes wanted per scene, by category"""
    cells: tuple[InstructionCell, ...] = ()
    """cells, each with the number of episodes wanted; per_category is ignored for a category that has cells here"""
    counterfactual_groups: int = Field(2, ge=0, le=1000)
    """number of counterfactual groups wanted per scene, in addition to the episodes; a group is four episodes with one
    start, in which the truth of a condition and the order of two leaves vary"""
    leads: Share = 0.7
    """share of programs with leads, in scenes of several rooms: one goes to the room of a condition before one decides
    it (“Go to the kitchen. If there's a kettle, …”)"""
    label_cap: Share = 0.15
    """maximum share of a scene's leaves that have the same target label (where the scene has few labels, an equal share
    for each label)"""

    @model_validator(mode="after")
    def _cells_differ(self) -> InstructionsConfig:
        axes = [tuple(cell.model_dump(exclude={"count"}).values()) for cell in self.cells]
        for name in axes:
            if axes.count(name) > 1:
                raise ValueError(
                    f"cells: {' '.join(str(part) for part in name if part)} occurs twice; add up the counts"
                )
        return self

    def cells_of(self, category: Category) -> tuple[InstructionCell, ...]:
        """Return the configured cells of a category. If there are none, return one cell that wants as many episodes as
        `per_category` says and fixes nothing else (no cell if that number is 0).
        """
        asked = tuple(cell for cell in self.cells if cell.category == category)
        count = self.per_category.get(category, 0)
        return asked or ((InstructionCell(category=category, count=count),) if count else ())

    @property
    def wanted(self) -> tuple[InstructionCell, ...]:
        """Return the cells that are wanted of every scene, in the order of the categories."""
        return tuple(cell for category in CATEGORIES for cell in self.cells_of(category))


class CompositionWeights(Section):
    """Weights of the compositions, used where the scene has enough rooms and the cell does not fix the composition."""

    C0: Weight = 1.0
    """weight of C0: programs in one room"""
    C1: Weight = 1.0
    """weight of C1: programs in several rooms that are not C2"""
    C2: Weight = 0.3
    """weight of C2: programs with a branch over three rooms"""


class PredicateWeights(Section):
    """Weights of the groups of predicates; a group with weight 0 is not used in conditions."""

    # What people say most comes first; heights are correct but stilted.
    on: Weight = 0.60
    """weight of “on”"""
    under: Weight = 0.10
    """weight of “under”, which only distinguishes stops"""
    inside: Weight = 0.30
    """weight of “in”"""
    near: Weight = 0.15
    """weight of “near”"""
    vertical: Weight = 0.05
    """weight of “above” and “below”"""
    between: Weight = 0.05
    """weight of “between”"""
    closest: Weight = 0.20
    """weight of “closest to”, which only distinguishes stops"""
    compass: Weight = 0.05
    """weight of the eight compass words"""
    bearing: Weight = 0.30
    """weight of “left”, “right”, “ahead” and “behind”, where directions are egocentric"""
    size: Weight = 0.20
    """weight of “the bigger” and “the smaller”, which only distinguish stops"""
    height: Weight = 0.05
    """weight of “higher than” and “lower than”"""
    far: Weight = 0.0
    """weight of “far from”"""


PAPER: Final[Mapping[str, Mapping[str, Any]]] = {
    "instructions": {"leads": 0.0},
    "thresholds": {"sector_within": 100.0},
    "sampling": {
        "compass_share": 1.0,
        "compass_phrases": 8,
        "purpose": 0.0,
        "presence_share": 0.4,
        "usual_places": False,
        "compositions": {"C2": 1.0},
        "predicates": {"on": 0.2, "inside": 0.1, "near": 0.4, "vertical": 0.1, "between": 0.15, "compass": 0.25},
        "moves": (0.4, 0.4, 0.2),
        "moves_four_leaves": (0.6, 0.4),
        "moves_drawn": (0.27, 0.39, 0.34),
        "moves_drawn_four_leaves": (0.5, 0.5),
    },
}
"""Values of the style "paper", by section, where a configuration does not give them."""


class SamplingConfig(Section):
    """How candidate programs are sampled."""

    candidates_per_episode: int = Field(10, ge=1, le=1000)
    """number of candidates drawn for each episode wanted, since placing rejects some"""
    moves: tuple[Share, Share, Share] = (0.8, 0.17, 0.03)
    """shares of leaves with 1, with 2 and with 3 moves, in programs with two or three leaves"""
    moves_four_leaves: tuple[Share, Share] = (0.85, 0.15)
    """shares of leaves with 1 and with 2 moves, in programs with four leaves"""
    moves_drawn: tuple[Share, Share, Share] = (0.75, 0.19, 0.06)
    """shares as in moves, but among drawn candidates: candidates with long routes are rejected more often, so more of
    these are drawn than are wanted"""
    moves_drawn_four_leaves: tuple[Share, Share] = (0.8, 0.2)
    """shares as in moves_four_leaves, but among drawn candidates"""
    presence_false_share: Share = 0.2
    """maximum share of label-only conditions among the false conditions, where a scene is one room"""
    presence_share: Share = 0.1
    """share of label-only conditions in scenes of several rooms"""
    plausible_share: Share = 0.05
    """minimum share of the rooms of a type that must have an object of a label, for the label to be plausible in this
    room type"""
    compositions: CompositionWeights = Field(default_factory=CompositionWeights)
    predicates: PredicateWeights = Field(default_factory=PredicateWeights)
    usual_places: bool = True
    """ask where something is only beside what it serves a purpose with, such as a book and a desk"""
    anchor_size: Metres = 0.3
    """a movable object whose longest side is shorter than this is not used as an anchor and does not name a room"""
    bearings: int = Field(2, ge=1, le=4)
    """maximum number of phrases with bearings (left, right, ahead, behind) in a program; all of them must hold at one
    start"""
    compass_share: Share = 0.25
    """share of the candidate programs that may use compass words"""
    compass_phrases: int = Field(2, ge=1, le=8)
    """maximum number of phrases with compass words in such a program"""
    purpose: Share = 1.0
    """share of the candidate programs whose goals are, where possible, what goes with what is asked: the desk, if the
    lamp is on it"""
    most_odd: int | None = Field(None, ge=0)
    """programs whose parts have less to do with each other than this are not used: 0 takes only those that look for a
    thing where it may be and go there; by default all are, the least odd first"""
    search: Share = 0.0
    """share of the candidate programs of the categories chain and long_chain that look for one thing in several places,
    where a room has enough places: “if the book is on the desk, …; otherwise, if the book is on the bed, …”. Where
    things usually are tells a part of the answer then, so that the bias gate may refuse an export"""
    attempts: int = Field(24, ge=1, le=10_000)
    """maximum number of draws of a condition before the candidate is given up"""
    draws_per_candidate: int = Field(20, ge=1, le=10_000)
    """maximum number of draws of whole candidates of one composition before the composition is given up"""

    @model_validator(mode="after")
    def _shares_sum_to_one(self) -> SamplingConfig:
        for name, count in (
            ("moves", "three"),
            ("moves_four_leaves", "two"),
            ("moves_drawn", "three"),
            ("moves_drawn_four_leaves", "two"),
        ):
            total = sum(getattr(self, name))
            if abs(total - 1.0) > 1e-9:
                raise ValueError(f"{name}: the {count} shares must sum to 1, got {total:g}")
        return self

    def move_shares(self, category: Category) -> tuple[float, ...]:
        """Return the shares of leaves with 1, 2, … moves in programs of a category."""
        return self.moves_four_leaves if SHAPES[category].leaves == 4 else self.moves

    def drawn_move_shares(self, category: Category) -> tuple[float, ...]:
        """Return the shares of leaves with 1, 2, … moves among the drawn candidates of a category."""
        return self.moves_drawn_four_leaves if SHAPES[category].leaves == 4 else self.moves_drawn

    def candidates(self, cell: InstructionCell) -> int:
        """Return the number of candidates drawn for a cell. More are drawn for a cell that fixes the observability or
        the route, since many placed candidates miss these bounds.
        """
        return cell.count * self.candidates_per_episode * (SEEN_FACTOR if cell.observability or cell.route else 1)

    def label_only(self, single_room: bool) -> float:
        """Return the share of label-only conditions, which ask whether a room has an object of some label. They are
        drawn regardless of their truth, so that a condition's kind does not reveal its truth.
        """
        return PRESENCE_MARGIN * self.presence_false_share if single_room else self.presence_share


class TextConfig(Section):
    """The opening of a text, and the step budget per word."""

    preamble: bool = True
    """begin each text that uses compass words with the start heading"""
    steps_per_word: int = Field(20, ge=1)
    """steps for each word of the text in a proportional step budget; the budget is never less than twice the number of
    ground-truth actions"""
