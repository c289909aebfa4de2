"""The instruction program: a decision tree over object references; its text is one rendering of it.

The tree is kept flat, as the tables keep it: conditions in the order in which the text asks them, branches that
point at each other by index, leaves in reading order. ``Program.walk`` gives the nested view.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final, Literal

from pydantic import Field, model_validator

from schemas.base import Frozen

__all__ = [
    "BEARINGS",
    "CATEGORIES",
    "PREDICATE_GROUPS",
    "QUALIFIER_ONLY",
    "SHAPES",
    "SUPERLATIVES",
    "Anchor",
    "Branch",
    "Category",
    "Condition",
    "Leaf",
    "ObjectRef",
    "Predicate",
    "Program",
    "Qualifier",
    "RoomRef",
    "Shape",
    "anchors_of",
    "asked_in",
    "leaf_truths",
    "route_through",
]

Category = Literal["simple", "nested", "deep_nested", "chain", "long_chain", "nested_chain"]

Predicate = Literal[
    "on",
    "under",
    "in",
    "near",
    "above",
    "below",
    "between",
    "closest to",
    "east of",
    "north-east of",
    "north of",
    "north-west of",
    "west of",
    "south-west of",
    "south of",
    "south-east of",
    "bigger",
    "smaller",
    "higher than",
    "lower than",
    "far from",
    "left",
    "right",
    "ahead",
    "behind",
]
"""Predicates that text may use. ``S north of T`` holds iff S lies north of T, ``S left`` iff S lies to the left of an
agent that stands at the start as the episode begins."""

PREDICATE_GROUPS: Final[dict[str, tuple[Predicate, ...]]] = {
    "on": ("on",),
    "under": ("under",),
    "inside": ("in",),
    "near": ("near",),
    "vertical": ("above", "below"),
    "between": ("between",),
    "closest": ("closest to",),
    "compass": (
        "east of",
        "north-east of",
        "north of",
        "north-west of",
        "west of",
        "south-west of",
        "south of",
        "south-east of",
    ),
    "bearing": ("left", "right", "ahead", "behind"),
    "size": ("bigger", "smaller"),
    "height": ("higher than", "lower than"),
    "far": ("far from",),
}
"""Groups of predicates with similar wording, in order of preference; named as the keys of ``sampling.predicates``."""

BEARINGS: Final = PREDICATE_GROUPS["bearing"]
"""Predicates without an anchor: the direction of an object as seen from the start pose."""

SUPERLATIVES: Final = PREDICATE_GROUPS["size"]
"""Predicates without an anchor: one of two objects with the same label."""

QUALIFIER_ONLY: Final = ("under", "closest to", *SUPERLATIVES)
"""Predicates that distinguish a stop from its rivals and that no condition asks for."""

_ASKED_EVERYWHERE: Final = frozenset(("near", "far from", *BEARINGS, *PREDICATE_GROUPS["compass"]))
_ASKED_BESIDES: Final = {
    "ithor": frozenset(("on",)),
    "procthor": frozenset(("on", "between", "higher than", "lower than")),
}


def asked_in(family: str) -> frozenset[str]:
    """Return the predicates that conditions may ask for in scenes of a family.

    Predicates with at least about 20 pairs of labels of either truth over at least 5 scenes of the family, as counted
    when the list was made; docs/predicates.md has today's counts, and says which are below. With fewer, the words would
    give the truth away, and they only distinguish stops. Bearings are true or false as the start is chosen.
    """
    return _ASKED_EVERYWHERE | _ASKED_BESIDES.get(family, frozenset())


def anchors_of(predicate: Predicate) -> int:
    """Return the number of anchors that a predicate has."""
    return 0 if predicate in SUPERLATIVES or predicate in BEARINGS else 2 if predicate == "between" else 1


class Anchor(Frozen):
    """An object that a qualifier refers to, unique in its room by canonical label."""

    object_id: str
    label: str


class Qualifier(Frozen):
    """``near the bed``, ``between the bed and the desk``, ``the bigger``: a predicate and its anchors."""

    predicate: Predicate
    anchors: tuple[Anchor, ...] = ()

    @model_validator(mode="after")
    def _has_its_anchors(self) -> Qualifier:
        wanted = anchors_of(self.predicate)
        if len({anchor.object_id for anchor in self.anchors}) != wanted or len(self.anchors) != wanted:
            raise ValueError(f"{self.predicate!r} needs {wanted} different anchors, got {len(self.anchors)}")
        return self

    @property
    def anchor_ids(self) -> tuple[str, ...]:
        """Return the ids of the anchors, in the order in which the text names them."""
        return tuple([anchor.object_id for anchor in self.anchors])

    @property
    def anchor_labels(self) -> tuple[str, ...]:
        """Return the canonical labels of the anchors, in the order in which the text names them."""
        return tuple([anchor.label for anchor in self.anchors])


class RoomRef(Frozen):
    """A room as text names it. ``anchor_*`` is set where the room's label alone is not unique (``the bedroom with the
    piano``).
    """

    room_id: str
    label: str
    anchor_id: str | None = None
    anchor_label: str | None = None


class ObjectRef(Frozen):
    """A reference to one object, unique in its room by its label, or by label and qualifier."""

    object_id: str
    label: str
    room: RoomRef
    qualifier: Qualifier | None = None

    @property
    def is_bearing(self) -> bool:
        """Whether the qualifier is a bearing: left, right, ahead or behind at the start."""
        return self.qualifier is not None and self.qualifier.predicate in BEARINGS


class Condition(Frozen):
    """``there is a <label> [<qualifier>] in <room>``, with its truth and the objects that make it true.

    definite : exactly one thing of the room can be meant by the label, so that a person says "the lamp is near the bed"
    """

    label: str
    room: RoomRef
    qualifier: Qualifier | None = None
    definite: bool = False
    truth: bool
    witnesses: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _witnessed(self) -> Condition:
        if self.truth != bool(self.witnesses):
            raise ValueError("a condition must have witnesses if it is true, and none if it is false")
        if self.qualifier is not None and self.qualifier.predicate in QUALIFIER_ONLY:
            raise ValueError(f"{self.qualifier.predicate!r} only distinguishes stops; no condition asks for it")
        if self.definite and self.qualifier is None:
            raise ValueError("only a condition with a relation can be about one definite thing")
        if self.qualifier is not None and self.qualifier.predicate in BEARINGS and not self.definite:
            raise ValueError(f"{self.qualifier.predicate!r} is asked of one definite thing only")
        return self

    @property
    def is_bearing(self) -> bool:
        """Whether the condition asks for a bearing: left, right, ahead or behind at the start."""
        return self.qualifier is not None and self.qualifier.predicate in BEARINGS

    @property
    def kind(self) -> Literal["presence", "relation"]:
        """Return ``presence`` (a label occurs in a room) or ``relation`` (an object is in a relation)."""
        return "presence" if self.qualifier is None else "relation"


class Branch(Frozen):
    """``if conditions[condition] then A else B``. A target ≥ 0 is the index of a branch; a target t < 0 is the leaf
    ``-1 - t``.
    """

    condition: int = Field(ge=0)
    then: int
    otherwise: int
    lead: RoomRef | None = None
    """the room to go to before the condition is decided; null where one is there already, or is not sent there"""


class Leaf(Frozen):
    """One to three moves: the last one is the leaf's goal; those before it are subgoals, after the leads on the way."""

    moves: tuple[ObjectRef, ...] = Field(min_length=1, max_length=3)

    @property
    def goal(self) -> ObjectRef:
        """Return the object at which the agent must stop."""
        return self.moves[-1]


class Shape(Frozen):
    """The tree of a category: its branches, its number of leaves, depth and chain length."""

    depth: int
    chain: int
    leaves: int
    branches: tuple[Branch, ...]


def _b(condition: int, then: int, otherwise: int) -> Branch:
    return Branch(condition=condition, then=then, otherwise=otherwise)


SHAPES: Final[dict[Category, Shape]] = {
    # IF A x ELSE y
    "simple": Shape(depth=1, chain=1, leaves=2, branches=(_b(0, -1, -2),)),
    # IF A (IF B x ELSE y) ELSE z
    "nested": Shape(depth=2, chain=1, leaves=3, branches=(_b(0, 1, -3), _b(1, -1, -2))),
    # IF A (IF B (IF C x ELSE y) ELSE z) ELSE w
    "deep_nested": Shape(depth=3, chain=1, leaves=4, branches=(_b(0, 1, -4), _b(1, 2, -3), _b(2, -1, -2))),
    # IF A x ELSE IF B y ELSE z
    "chain": Shape(depth=1, chain=2, leaves=3, branches=(_b(0, -1, 1), _b(1, -2, -3))),
    # IF A x ELIF B y ELIF C z ELSE w
    "long_chain": Shape(depth=1, chain=3, leaves=4, branches=(_b(0, -1, 1), _b(1, -2, 2), _b(2, -3, -4))),
    # IF A (IF B x ELSE y) ELIF C z ELSE w
    "nested_chain": Shape(depth=2, chain=2, leaves=4, branches=(_b(0, 1, 2), _b(1, -1, -2), _b(2, -3, -4))),
}
"""The trees of the six categories. Depth is the deepest nesting of THEN, chain the number of tests in the top chain."""

CATEGORIES: Final[tuple[Category, ...]] = tuple(SHAPES)


def route_through(branches: Sequence[Branch], truths: Sequence[bool]) -> tuple[tuple[int, ...], int]:
    """Return the conditions that a tree asks if they are as `truths` says, and the leaf that it reaches."""
    asked: list[int] = []
    at = 0
    while at >= 0:
        branch = branches[at]
        asked.append(branch.condition)
        at = branch.then if truths[branch.condition] else branch.otherwise
    return tuple(asked), -1 - at


@cache
def leaf_truths(category: Category) -> tuple[tuple[tuple[int, bool], ...], ...]:
    """Return, for each leaf, the (condition index, truth) pairs on the path from the root of the tree to the leaf."""
    shape = SHAPES[category]
    found: dict[int, tuple[tuple[int, bool], ...]] = {}
    ahead: list[tuple[int, tuple[tuple[int, bool], ...]]] = [(0, ())]
    while ahead:
        at, way = ahead.pop()
        if at < 0:
            found[-1 - at] = way
            continue
        branch = shape.branches[at]
        ahead.append((branch.then, (*way, (branch.condition, True))))
        ahead.append((branch.otherwise, (*way, (branch.condition, False))))
    return tuple(found[leaf] for leaf in range(shape.leaves))


class Program(Frozen):
    """A typed conditional instruction.

    ``branches[0]`` is the root; conditions are in the order in which the text asks them.
    """

    category: Category
    conditions: tuple[Condition, ...] = Field(min_length=1)
    branches: tuple[Branch, ...] = Field(min_length=1)
    leaves: tuple[Leaf, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _is_the_category_s_tree(self) -> Program:
        shape = SHAPES[self.category]
        bare = tuple([_b(one.condition, one.then, one.otherwise) for one in self.branches])
        if bare != shape.branches or len(self.leaves) != shape.leaves:
            raise ValueError(f"branches and leaves are not those of category {self.category!r}")
        if len(self.conditions) != len(self.branches):
            raise ValueError("each branch must have one condition")
        rooms = {named.room.room_id for named in self.named if named.is_bearing}
        if len(rooms) > 1:
            raise ValueError(f"bearings must be of things in the room of the start, but these are in {sorted(rooms)}")
        return self

    @property
    def named(self) -> tuple[Condition | ObjectRef, ...]:
        """Return all conditions of the program, then the moves of all its leaves."""
        return (*self.conditions, *(move for leaf in self.leaves for move in leaf.moves))

    @property
    def start_room(self) -> str | None:
        """Return the id of the room that holds the start, which bearings need; None without bearings."""
        return next((named.room.room_id for named in self.named if named.is_bearing), None)

    def gold_leaf(self, truths: Sequence[bool] | None = None) -> int:
        """Return the index of the leaf to which the conditions' own truths lead. If `truths` is given (one for each
        condition, in the conditions' order), these truths decide instead.
        """
        return self.route(truths)[1]

    def route(self, truths: Sequence[bool] | None = None) -> tuple[tuple[int, ...], int]:
        """Return (indices of the conditions evaluated from the root on, index of the leaf reached), by the conditions'
        own truths or, if given, by `truths`.
        """
        return route_through(self.branches, [c.truth for c in self.conditions] if truths is None else truths)

    def led_branches(self, leaf: int) -> tuple[int, ...]:
        """Return the indices of the branches with leads on the way to a leaf, in order."""
        found: dict[int, tuple[int, ...]] = {0: ()}
        for at, branch in enumerate(self.branches):  # a branch comes before those below it
            found[branch.then] = found[branch.otherwise] = found[at] if branch.lead is None else (*found[at], at)
        return found[-1 - leaf]

    def leads(self, leaf: int) -> tuple[RoomRef, ...]:
        """Return the leads on the way to a leaf, in order."""
        return tuple([lead for at in self.led_branches(leaf) if (lead := self.branches[at].lead) is not None])

    @property
    def last_leads(self) -> tuple[RoomRef | None, ...]:
        """Return for each condition the last lead before it is decided; None if there is none."""
        found: dict[int, RoomRef | None] = {0: None}
        leads: list[RoomRef | None] = [None] * len(self.conditions)
        for at, branch in enumerate(self.branches):
            found[branch.then] = found[branch.otherwise] = leads[branch.condition] = branch.lead or found[at]
        return tuple(leads)

    def stops(self, leaf: int) -> tuple[str, ...]:
        """Return the ids of a leaf's stops in order: rooms of the leads on the way to it, then objects of its moves."""
        moves = self.leaves[leaf].moves
        return (*[lead.room_id for lead in self.leads(leaf)], *[move.object_id for move in moves])

    @property
    def depth(self) -> int:
        """Return the maximum depth to which conditions are nested in THEN parts; an outermost condition has depth 1."""
        return SHAPES[self.category].depth

    @property
    def chain(self) -> int:
        """Return the number of conditions in the outermost IF … ELSE IF chain."""
        return SHAPES[self.category].chain

    @property
    def rooms(self) -> tuple[str, ...]:
        """Return the ids of all rooms that the program names, sorted."""
        named = {c.room.room_id for c in self.conditions} | {m.room.room_id for leaf in self.leaves for m in leaf.moves}
        return tuple(sorted(named))
