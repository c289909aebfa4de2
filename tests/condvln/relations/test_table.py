"""The flat table: its rows re-derive from their own metrics, it round-trips, and networkx sees the same edges."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest

from condvln.relations import RoomRelations, relate_scene, relation_table, text_facts, to_networkx
from condvln.scene import Scene, SceneObject
from schemas.config import Thresholds
from schemas.errors import StoreError
from schemas.tables import RELATIONS, SORT_KEYS

SceneOf = Callable[[Sequence[SceneObject]], Scene]


@pytest.fixture
def scene(furnished: list[SceneObject], scene_of: SceneOf) -> Scene:
    return scene_of(furnished)


@pytest.fixture
def table(scene: Scene) -> pa.Table:
    return relation_table(scene, relate_scene(scene, Thresholds()), Thresholds())


def test_every_edge_re_derives_from_its_own_metrics(
    table: pa.Table, scene: Scene, check_edges: Callable[[pa.Table, Scene], None]
) -> None:
    check_edges(table, scene)


def test_what_text_may_say_stands_in_the_rows(table: pa.Table, scene: Scene) -> None:
    relations = relate_scene(scene, Thresholds())["room"]
    facts = text_facts(relations, Thresholds())
    index = {name: k for k, name in enumerate(relations.objects.object_ids)}
    for row in table.to_pylist():
        if row["predicate"] in facts.status:
            i, j = index[row["subject"]], index[row["target"]]
            assert row["true_in_text"] == (facts.status[row["predicate"]][i, j] == 1)
            margin = facts.margin[row["predicate"]][i, j]
            assert row["margin"] == (None if math.isnan(margin) else margin)
            assert not row["true_in_text"] or row["margin"] >= 1 - 1e-9
        else:
            assert not row["true_in_text"]
            assert row["margin"] is None


def test_schema_order_and_containment(table: pa.Table, scene: Scene) -> None:
    assert table.schema.equals(RELATIONS)
    table.validate(full=True)
    keys = list(zip(*(table[key].to_pylist() for key in SORT_KEYS["relations"]), strict=True))
    assert keys == sorted(set(keys))
    contained = [row for row in table.to_pylist() if row["kind"] == "containment"]
    assert [(r["subject"], r["predicate"], r["target"]) for r in contained] == [
        ("room", "contains", o.object_id) for o in sorted(scene.objects, key=lambda o: o.object_id)
    ]
    for column in (
        name for name, kind in zip(table.column_names, table.schema.types, strict=True) if kind == pa.float64()
    ):
        assert np.isfinite(table[column].drop_null().to_numpy()).all(), column


def test_round_trip(table: pa.Table, scene: Scene) -> None:
    before = relate_scene(scene, Thresholds())["room"]
    after = RoomRelations.from_table(table, scene.arrays("room"), Thresholds())
    np.testing.assert_array_equal(after.surface, before.surface)
    np.testing.assert_array_equal(after.canonical, before.canonical)
    again = relation_table(scene, {"room": after}, Thresholds())
    assert again.equals(table)


def test_each_room_takes_its_own_rows(furnished: list[SceneObject], scene_of: SceneOf) -> None:
    one = scene_of(furnished)
    moved = tuple(replace(o, object_id=f"other {o.object_id}", room_id="other") for o in furnished[::2])
    two = replace(one, rooms=(*one.rooms, replace(one.rooms[0], room_id="other")), objects=one.objects + moved)
    relations = relate_scene(two, Thresholds())
    table = relation_table(two, relations, Thresholds())
    assert table.num_rows == relation_table(one, {"room": relations["room"]}, Thresholds()).num_rows + sum(
        row == "other" for row in table["room_id"].to_pylist()
    )
    again = {room: RoomRelations.from_table(table, two.arrays(room), Thresholds()) for room in ("room", "other")}
    assert relation_table(two, again, Thresholds()).equals(table)


def test_rows_of_other_objects_are_refused(
    table: pa.Table, furnished: list[SceneObject], make: Callable[..., SceneObject], scene_of: SceneOf
) -> None:
    fewer = scene_of(furnished[1:])
    shifted = scene_of([make(furnished[0].object_id, (9, 9, 9), (1, 1, 1)), *furnished[1:]])
    more = scene_of([*furnished, make("new", (0, 0, 0), (1, 1, 1))])
    for other in (fewer, shifted, more):
        with pytest.raises(StoreError, match=r"room 'room'.*Compute the scene's relations again"):
            RoomRelations.from_table(table, other.arrays("room"), Thresholds())
    with pytest.raises(StoreError):
        RoomRelations.from_table(table, scene_of(furnished).arrays("room"), Thresholds(near=0.9))


def test_networkx_has_the_same_edges(table: pa.Table, scene: Scene) -> None:
    graph = to_networkx(scene, relate_scene(scene, Thresholds()), Thresholds())
    assert graph.number_of_nodes() == len(scene.objects) + len(scene.rooms)
    assert graph.number_of_edges() == table.num_rows
    rows = Counter((r["subject"], r["target"], r["predicate"]) for r in table.to_pylist())
    assert Counter(iter(graph.edges(keys=True))) == rows
    assert graph.nodes["room"]["kind"] == "room"
    assert set(graph.successors("room")) == {o.object_id for o in scene.objects}
    edge = graph.edges["lamp", "table", "above"]
    assert edge["kind"] == "semantic"
    assert edge["delta"] == {"x": 0.0, "y": -0.6, "z": 0.0}
    assert "azimuth" not in edge  # straight above: unknown is absent, not None


def test_a_scene_without_objects_has_an_empty_table(scene_of: SceneOf) -> None:
    empty = scene_of([])
    table = relation_table(empty, relate_scene(empty, Thresholds()), Thresholds())
    assert table.num_rows == 0
    assert table.schema.equals(RELATIONS)
    assert to_networkx(empty, relate_scene(empty, Thresholds()), Thresholds()).number_of_nodes() == 1
