"""A scene goes to its tables and back without losing a bit."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.scene import MeshPart, NavmeshFile, OrientedBox, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import rounded_box
from condvln.scene.rotations import to_matrix
from condvln.scene.tables import scene_from_tables, scene_tables
from schemas.tables import TABLES

ROOT = Path("somewhere")

metres = st.floats(-100, 100).map(lambda v: float(round_mm(v)))
sizes = st.floats(0, 10).map(lambda v: float(round_mm(v)))
texts = st.text(st.characters(blacklist_categories=("Cs",)), max_size=8)


def vectors(numbers: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    return st.tuples(numbers, numbers, numbers).map(lambda v: np.array(v, dtype=np.float64))


parts = st.builds(
    MeshPart,
    path=texts,
    transform=st.lists(st.floats(-1e6, 1e6), min_size=16, max_size=16).map(lambda v: np.array(v).reshape(4, 4)),
)
boxes = st.builds(
    lambda centre, half, q: rounded_box(OrientedBox(centre, half, to_matrix(q))),
    vectors(metres),
    vectors(sizes),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(v * v for v in q) > 0.01),
)
aabbs = st.tuples(vectors(metres), vectors(metres)).map(lambda ends: np.array([np.minimum(*ends), np.maximum(*ends)]))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    rooms = draw(st.lists(texts, min_size=1, max_size=3, unique=True))
    made_rooms = tuple(
        Room(
            room_id=name,
            raw_label=draw(texts),
            label=draw(texts),
            level=draw(st.integers(-2, 5)),
            floor_y=draw(metres),
            ceiling_y=draw(metres),
            polygon=draw(st.none() | st.lists(st.tuples(metres, metres), min_size=3, max_size=5).map(np.array)),
            annotation=draw(st.sampled_from(["dataset", "user", "scene"])),
            complete=draw(st.booleans()),
        )
        for name in sorted(rooms)
    )
    objects = tuple(
        SceneObject(
            object_id=name,
            room_id=draw(st.sampled_from(rooms)),
            raw_label=draw(texts),
            label=draw(texts),
            center=draw(vectors(metres)),
            aabb=draw(st.none() | aabbs),
            obb=draw(st.none() | boxes),
            radius=draw(st.none() | sizes),
            mesh=tuple(draw(st.lists(parts, max_size=2))),
            static=draw(st.booleans()),
            parts=tuple(draw(st.lists(boxes, max_size=2))),
            receptacles=draw(st.none() | st.lists(texts, max_size=2).map(tuple)),
            openness=draw(st.none() | st.floats(0, 1)),
            parent=draw(st.none() | texts),
            support=draw(st.none() | texts),
            hidden=draw(st.booleans()),
        )
        for name in sorted(draw(st.lists(texts, max_size=4, unique=True)))
    )
    numbers = [draw(st.floats(0, 50)) for _ in range(4)]
    navmesh = NavmeshFile(draw(texts), draw(texts), draw(st.booleans()), draw(st.booleans()), *numbers)
    return Scene(
        family="replicacad",
        scene_id=draw(texts),
        root=ROOT,
        rooms=made_rooms,
        objects=objects,
        navmesh=draw(st.none() | st.just(navmesh)),
        stage=tuple(draw(st.lists(parts, max_size=2))),
        warnings=tuple(SceneWarning(draw(texts), draw(texts), draw(texts)) for _ in range(draw(st.integers(0, 2)))),
    )


def exact(value: Any) -> Any:
    """A value with its arrays as bytes, so that equality means every bit."""
    if isinstance(value, np.ndarray):
        return value.shape, np.ascontiguousarray(value, dtype=np.float64).tobytes()
    if isinstance(value, tuple):
        return tuple(exact(v) for v in value)
    names = getattr(type(value), "__dataclass_fields__", None)
    return value if names is None else {name: exact(getattr(value, name)) for name in names}


@pytest.mark.costly
@given(scenes())
def test_a_scene_comes_back_to_the_bit(scene: Scene) -> None:
    tables = scene_tables(scene)
    assert exact(scene_from_tables(tables, ROOT, family="replicacad")) == exact(scene)


@pytest.mark.costly
@given(scenes())
def test_tables_come_back_to_the_bit_through_parquet(scene: Scene) -> None:
    tables = scene_tables(scene, status="skipped", reason="no navmesh")
    for name, table in tables.items():
        assert table.schema == TABLES[name]
        table.validate(full=True)
    stored = {name: through_parquet(table) for name, table in tables.items()}
    again = scene_tables(scene_from_tables(stored, ROOT, family="x"), status="skipped", reason="no navmesh")
    assert all(again[name].equals(tables[name]) for name in tables)


def through_parquet(table: pa.Table) -> pa.Table:
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return pq.read_table(buffer)


def test_rows_are_sorted_and_counted() -> None:
    room = Room("r", "Kitchen", "kitchen", 0, 0.0, 2.5, None, "dataset", True)
    box = np.array([[0.0, 0, 0], [1, 2, 3]])
    objects = tuple(
        SceneObject(name, "r", "chair", "chair", np.array([0.5, 1, 1.5]), aabb=aabb)
        for name, aabb in (("b", box), ("a", None), ("c", box + 1))
    )
    tables = scene_tables(Scene("f", "s", ROOT, (room,), objects))
    assert tables["objects"]["object_id"].to_pylist() == ["a", "b", "c"]
    (row,) = tables["scenes"].to_pylist()
    assert (row["n_objects"], row["n_objects_without_extent"], row["status"]) == (3, 1, "ok")
    assert (row["bounds_min"], row["bounds_max"]) == ({"x": 0, "y": 0, "z": 0}, {"x": 2, "y": 3, "z": 4})
    assert tables["rooms"]["n_objects"].to_pylist() == [3]
    assert tables["objects"]["geometry"].to_pylist() == ["none", "aabb", "aabb"]
