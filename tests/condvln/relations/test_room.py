"""Predicates of a room: the definitions, English reading, symmetry, and invariance under turning and moving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from condvln.relations import CANONICAL, COMPASS, SECTORS, SEMANTIC, RoomRelations, relate_room
from condvln.scene import RoomArrays, SceneObject, round_mm
from schemas.config import Thresholds

T = Thresholds()

Maker = Callable[..., SceneObject]
RoomOf = Callable[[Sequence[SceneObject]], RoomArrays]


def moved(item: SceneObject, turn: np.ndarray, shift: np.ndarray) -> SceneObject:
    """An object turned by a multiple of 90° and moved."""
    box = None if item.aabb is None else item.aabb @ turn.T + shift
    return replace(
        item,
        center=round_mm(turn @ item.center + shift),
        aabb=None if box is None else round_mm([box.min(axis=0), box.max(axis=0)]),
    )


def names(relations: RoomRelations, subject: str, target: str) -> set[str]:
    """All predicates of the edges from one object to another."""
    i, j = relations.objects.object_ids.index(subject), relations.objects.object_ids.index(target)
    code = relations.canonical[i, j]
    found = {p for p in SEMANTIC if relations.semantic[p][i, j]}
    return found | ({CANONICAL[code]} if code >= 0 else set())


def test_edges_read_as_english(make: Maker, room_of: RoomOf) -> None:
    """North is −Z, east is +X, up is +Y: the stool north of the dishwasher has the smaller z."""
    relations = relate_room(
        room_of(
            [
                make("dishwasher", (0, 0.4, 0), (0.3, 0.4, 0.3)),
                make("stool", (0, 0.4, -1.2), (0.2, 0.4, 0.2)),
                make("clock", (0.1, 1.8, 0), (0.1, 0.1, 0.02)),
                make("door", (4.5, 0.4, 0), (0.05, 0.4, 0.5)),
            ]
        ),
        T,
    )
    assert names(relations, "stool", "dishwasher") == {"north of", "near"}
    assert names(relations, "dishwasher", "stool") == {"south of", "near"}
    assert names(relations, "clock", "dishwasher") == {"east-and-up of", "near", "higher than", "above"}
    assert names(relations, "dishwasher", "clock") == {"west-and-down of", "near", "lower than", "below"}
    assert names(relations, "door", "dishwasher") == {"east of", "far from"}
    assert names(relations, "stool", "stool") == set()


@pytest.mark.parametrize(
    ("shift", "expected"),
    [
        ((1.2, 0, 0), {"near"}),
        ((1.201, 0, 0), set()),
        ((3.2, 0, 0), {"far from"}),
        ((3.199, 0, 0), set()),
        ((0, 0.3, 1.5), {"higher than"}),
        ((0, 0.299, 1.5), set()),
        ((0, -0.3, 1.5), {"lower than"}),
        ((0, -0.299, 1.5), set()),
        ((0.3, 0.3, 0.4), {"near", "higher than", "above"}),
        ((0.3, 0.3, 0.401), {"near", "higher than"}),
        ((0.5, -0.3, 0), {"near", "lower than", "below"}),
        ((0.501, -0.3, 0), {"near", "lower than"}),
    ],
)
def test_semantic_thresholds_are_closed(
    make: Maker, room_of: RoomOf, shift: tuple[float, float, float], expected: set[str]
) -> None:
    relations = relate_room(room_of([make("a", shift, (0.1,) * 3), make("b", (0, 0, 0), (0.1,) * 3)]), T)
    assert names(relations, "a", "b") & set(SEMANTIC) == expected


def test_degenerate_and_coincident_pairs(make: Maker, room_of: RoomOf) -> None:
    half = (0.1, 0.1, 0.1)
    relations = relate_room(
        room_of(
            [
                make("a", (0, 0, 0), half),
                make("b", (0, 0, 0), half),
                make("c", (0, 1, 0), half),
                make("d", (0.001, 0, 0), half),
                make("e", (0.1, 0, 0), half),
            ]
        ),
        T,
    )
    assert names(relations, "a", "b") == {"near"}
    assert names(relations, "c", "a") == {"up of", "near", "higher than", "above"}
    assert names(relations, "a", "c") == {"down of", "near", "lower than", "below"}
    assert names(relations, "d", "a") == {"east of", "near"}
    assert relations.degenerate[0].tolist() == [False, True, True, True, False]


def test_a_quarter_turn_turns_every_sector_by_two(furnished: list[SceneObject], room_of: RoomOf) -> None:
    """Counter-clockwise from above takes east (+X) to north (−Z)."""
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    before = relate_room(room_of(furnished), T)
    after = relate_room(room_of([moved(o, quarter, np.zeros(3)) for o in furnished]), T)
    circle = before.canonical < 3 * len(COMPASS)
    sector = before.canonical % len(SECTORS)
    turned = before.canonical - sector + (sector + 2) % len(SECTORS)
    np.testing.assert_array_equal(after.canonical, np.where(circle & (before.canonical >= 0), turned, before.canonical))
    for field in ("centre", "horizontal", "aabb", "sphere", "used", "elevation", "footprint_overlap"):
        np.testing.assert_array_equal(getattr(after.metrics, field), getattr(before.metrics, field), err_msg=field)
    np.testing.assert_array_equal(after.surface, before.surface)
    for predicate in SEMANTIC:
        np.testing.assert_array_equal(after.semantic[predicate], before.semantic[predicate])


@pytest.mark.parametrize("count", [0, 1])
def test_small_rooms_have_no_pairs(make: Maker, room_of: RoomOf, count: int) -> None:
    relations = relate_room(room_of([make("a", (0, 0, 0), (1, 1, 1))][:count]), T)
    assert len(relations) == count
    assert not any(mask.any() for mask in relations.semantic.values())
    assert (relations.canonical == -1).all()


@pytest.mark.parametrize(
    "numbers",
    [
        {"near_true": 1.0},
        {"near_false": 0.9},
        {"far_false": 3.0},
        {"height_true": 0.2},
        {"over_horizontal_true": 0.0},
        {"sector_true": 22.5},
        {"surface_within": 0.4},
        {"sector_true": float("nan")},
    ],
)
def test_thresholds_that_contradict_are_refused(numbers: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"must be below .* must be above it|greater than|finite|surface_within"):
        Thresholds(**numbers)
