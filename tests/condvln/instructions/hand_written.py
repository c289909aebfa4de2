"""Programs written by hand, for tests of single wordings."""

from __future__ import annotations

from schemas.program import SHAPES, Anchor, Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef

__all__ = ["KITCHEN", "LAMP", "LIVING", "PROGRAM", "ROOM", "nested_chain"]

ROOM = RoomRef(room_id="r", label="bedroom", anchor_id="p", anchor_label="piano")
LAMP = Condition(
    label="lamp",
    room=ROOM,
    qualifier=Qualifier(predicate="north-east of", anchors=(Anchor(object_id="b", label="bed"),)),
    truth=False,
)
PROGRAM = Program(
    category="simple",
    conditions=(LAMP,),
    branches=SHAPES["simple"].branches,
    leaves=(
        Leaf(
            moves=(
                ObjectRef(object_id="a", label="alarm clock", room=ROOM),
                ObjectRef(object_id="d", label="desk", room=ROOM),
            )
        ),
        Leaf(moves=(ObjectRef(object_id="s", label="sink", room=RoomRef(room_id="k", label="kitchen")),)),
    ),
)


KITCHEN, LIVING = RoomRef(room_id="k", label="kitchen"), RoomRef(room_id="l", label="living room")


def nested_chain(conditions: tuple[Condition, ...], leaves: list[tuple[ObjectRef, ...]]) -> Program:
    return Program(
        category="nested_chain",
        conditions=conditions,
        branches=SHAPES["nested_chain"].branches,
        leaves=tuple(Leaf(moves=moves) for moves in leaves),
    )
