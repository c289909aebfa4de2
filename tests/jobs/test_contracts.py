"""The documents of ``schemas`` describe the very rows that a run publishes."""

from __future__ import annotations

from typing import Any

import pytest

from condvln.export.rows import rows_of
from factory.snapshot import Snapshot
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config
from schemas.episode import EpisodeRecord
from schemas.relation import RelationRecord
from schemas.scene import NavmeshChoice, ObjectRecord, RoomRecord, SceneRecord
from schemas.tables import EPISODES, RELATIONS


@pytest.fixture(scope="module")
def snapshot(made_run: tuple[Config, Report]) -> Snapshot:
    return published(made_run[0])


def rows(snapshot: Snapshot, table: str) -> list[dict[str, Any]]:
    return rows_of(snapshot.table(table).drop_columns(["source"]))


@pytest.mark.parametrize(
    ("table", "model", "schema"), [("episodes", EpisodeRecord, EPISODES), ("relations", RelationRecord, RELATIONS)]
)
def test_a_record_is_a_row(snapshot: Snapshot, table: str, model: Any, schema: Any) -> None:
    assert list(model.model_fields) == schema.names
    found = rows(snapshot, table)
    assert found
    for row in found:
        assert model.model_validate(row).model_dump(mode="json") == row


def test_an_episode_holds_together(snapshot: Snapshot) -> None:
    for row in rows(snapshot, "episodes"):
        episode = EpisodeRecord.model_validate(row)
        gold = episode.leaves[episode.gold_leaf]
        assert [leaf.leaf for leaf in episode.leaves] == list(range(episode.n_leaves))
        assert (gold.geodesic_distance, gold.route_length) == (episode.geodesic_distance, episode.route_length)
        assert len(gold.subgoals) == episode.moves - 1
        assert episode.actions is not None
        assert episode.locations is not None
        assert len(episode.locations) == episode.actions.count(1) + 1
        assert len(episode.actions) <= episode.ground_truth_steps
        assert episode.locations[0] == episode.start_position


def test_a_scene_record_holds_every_room_and_object(snapshot: Snapshot) -> None:
    rooms, objects = rows(snapshot, "rooms"), rows(snapshot, "objects")
    for row in rows(snapshot, "scenes"):
        mesh = {name: row[name] for name in NavmeshChoice.model_fields if name in row}
        mesh |= {name: row[f"navmesh_{name}"] for name in ("path", "sha256", "built", "fits")}
        scene = SceneRecord(
            family="replicacad",
            scene_id=row["scene_id"],
            rooms=tuple(room_record(r) for r in rooms if r["scene_id"] == row["scene_id"]),
            objects=tuple(object_record(o) for o in objects if o["scene_id"] == row["scene_id"]),
            navmesh=NavmeshChoice.model_validate(mesh),
            stage=row["stage"],
            warnings=row["warnings"],
        )
        assert len(scene.rooms) == row["n_rooms"]
        assert len(scene.objects) == row["n_objects"]
        assert {item.room_id for item in scene.objects} <= {room.room_id for room in scene.rooms}


def room_record(row: dict[str, Any]) -> RoomRecord:
    polygon = None if row["polygon"] is None else [(corner["x"], corner["z"]) for corner in row["polygon"]]
    own = {name: row[name] for name in RoomRecord.model_fields if name != "polygon"}
    return RoomRecord.model_validate({**own, "polygon": polygon})


def object_record(row: dict[str, Any]) -> ObjectRecord:
    aabb = None if row["aabb_min"] is None else {"min": row["aabb_min"], "max": row["aabb_max"]}
    own = {name: row[name] for name in ObjectRecord.model_fields if name != "aabb"}
    return ObjectRecord.model_validate({**own, "aabb": aabb})
