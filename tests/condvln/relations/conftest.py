"""Rooms made for the tests of relations, and the definitions of edges once more in plain Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from condvln.scene import Room, RoomArrays, Scene, SceneObject, round_mm

WORDS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


def make_object(
    name: str, center: Sequence[float], half: Sequence[float] | None, radius: float | None = None
) -> SceneObject:
    """An object with a box of `half` extents about its centre, or without a box."""
    middle = round_mm(center)
    box = None if half is None else round_mm([middle - half, middle + half])
    return SceneObject(name, "room", name, name, middle, aabb=box, radius=radius)


@pytest.fixture
def make() -> Callable[..., SceneObject]:
    """Maker of one object."""
    return make_object


@pytest.fixture
def room_of() -> Callable[[Sequence[SceneObject]], RoomArrays]:
    """Maker of a room's arrays."""
    return lambda objects: RoomArrays.of("room", objects)


@pytest.fixture
def scene_of() -> Callable[[Sequence[SceneObject]], Scene]:
    """Maker of a one-room scene."""

    def scene(objects: Sequence[SceneObject]) -> Scene:
        room = Room("room", "apartment", "apartment", 0, 0.0, 2.5, None, "scene", True)
        return Scene("made", "scene", Path(), (room,), tuple(objects))

    return scene


@pytest.fixture
def furnished() -> list[SceneObject]:
    """Thirty-odd boxes at random, with some objects of unknown extent, two stacked and two coincident ones."""
    rng = np.random.default_rng(7)
    objects = [
        make_object(f"box{k:02d}", rng.uniform([-4, 0, -4], [4, 2, 4]), rng.uniform(0.02, 0.6, 3)) for k in range(28)
    ]
    objects += [
        make_object("ball", (1, 1, 1), None, radius=0.3),
        make_object("ball2", (1.4, 1, -2), None, radius=0.2),
        make_object("point", (0, 0.5, 0), None),
        make_object("table", (2, 0.4, 2), (0.6, 0.4, 0.5)),
        make_object("lamp", (2, 1.0, 2), (0.1, 0.2, 0.1)),
        make_object("twin", (2, 0.4, 2), (0.2, 0.2, 0.2)),
    ]
    return objects


def canonical_of(row: dict[str, Any]) -> str | None:
    """The canonical predicate, from the row's delta alone."""
    dx, dy, dz = (-row["delta"][axis] for axis in "xyz")
    if dx == dz == 0:
        return "up of" if dy > 0 else "down of" if dy < 0 else None
    azimuth = math.degrees(math.atan2(-dz, dx)) % 360
    sector = WORDS[int(((azimuth + 22.5) % 360) // 45)]
    elevation = math.degrees(math.atan2(dy, math.hypot(dx, dz)))
    return f"{sector} of" if abs(elevation) < 22.5 else f"{sector}-and-{'up' if elevation > 0 else 'down'} of"


def semantic_of(row: dict[str, Any]) -> set[str]:
    """All semantic predicates, from the row's metrics."""
    dy, used = -row["delta"]["y"], row["used_distance"]
    found = {"near"} if used <= 1.0 else {"far from"} if used >= 3.0 else set()
    if abs(dy) >= 0.3:
        found.add("higher than" if dy > 0 else "lower than")
        if row["horizontal_distance"] <= 0.5:
            found.add("above" if dy > 0 else "below")
    return found


def check_metrics(row: dict[str, Any]) -> None:
    delta = [row["delta"][axis] for axis in "xyz"]
    assert row["centre_distance"] == pytest.approx(math.dist(delta, (0, 0, 0)), abs=1e-12)
    assert row["horizontal_distance"] == pytest.approx(math.hypot(delta[0], delta[2]), abs=1e-12)
    known = {"aabb": row["aabb_distance"], "sphere": row["sphere_distance"], "centre": row["centre_distance"]}
    first = next(name for name, value in known.items() if value is not None)
    assert (row["used_metric"], row["used_distance"]) == (first, known[first])
    assert row["degenerate"] == (row["horizontal_distance"] < 0.1)
    assert (row["surface_distance"] is not None) == (known["aabb"] is not None and known["aabb"] <= 1.15)


def _check_edges(table: pa.Table, scene: Scene) -> None:
    """Each edge follows from the metrics of its own row, and no edge is missing."""
    edges = [row for row in table.to_pylist() if row["kind"] != "containment"]
    pairs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in edges:
        check_metrics(row)
        pairs.setdefault((row["subject"], row["target"]), []).append(row)
    for rows in pairs.values():
        assert {r["predicate"] for r in rows if r["kind"] == "semantic"} == semantic_of(rows[0])
        assert [r["predicate"] for r in rows if r["kind"] == "canonical"] == [p for p in [canonical_of(rows[0])] if p]
    boxed = {o.object_id for o in scene.objects if o.aabb is not None}
    centre = {o.object_id: o.center for o in scene.objects}
    assert all((row["aabb_distance"] is not None) == ({row["subject"], row["target"]} <= boxed) for row in edges)
    apart = {(a, b) for a in centre for b in centre if (centre[a] != centre[b]).any()}
    assert {(row["subject"], row["target"]) for row in edges if row["kind"] == "canonical"} == apart
    for row in edges:
        delta = centre[row["target"]] - centre[row["subject"]]
        np.testing.assert_allclose([row["delta"][axis] for axis in "xyz"], delta, atol=1e-9)


@pytest.fixture(name="check_edges")
def check_edges_fixture() -> Callable[[pa.Table, Scene], None]:
    """Asserts that a table's edges are those of its own metrics."""
    return _check_edges
