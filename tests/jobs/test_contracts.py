"""The rows that a run publishes hold together."""

from __future__ import annotations

from typing import Any

import pytest

from condvln.export.tables import rows_of
from factory.snapshot import Snapshot
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config


@pytest.fixture(scope="module")
def snapshot(made_run: tuple[Config, Report]) -> Snapshot:
    return published(made_run[0])


def rows(snapshot: Snapshot, table: str) -> list[dict[str, Any]]:
    return rows_of(snapshot.table(table).drop_columns(["source"]))


def test_an_episode_holds_together(snapshot: Snapshot) -> None:
    episodes = rows(snapshot, "episodes")
    assert episodes
    for episode in episodes:
        gold = episode["leaves"][episode["gold_leaf"]]
        assert [leaf["leaf"] for leaf in episode["leaves"]] == list(range(episode["n_leaves"]))
        assert all(gold[name] == episode[name] for name in ("geodesic_distance", "route_length"))
        assert len(gold["subgoals"]) == episode["leads"] + episode["moves"] - 1
        assert len(episode["locations"]) == episode["actions"].count(1) + 1
        assert len(episode["actions"]) <= episode["ground_truth_steps"]
        assert episode["locations"][0] == episode["start_position"]


def test_every_room_and_object_is_counted_in_its_scene(snapshot: Snapshot) -> None:
    rooms, objects = rows(snapshot, "rooms"), rows(snapshot, "objects")
    for scene in rows(snapshot, "scenes"):
        own = [row["room_id"] for row in rooms if row["scene_id"] == scene["scene_id"]]
        inside = [row["room_id"] for row in objects if row["scene_id"] == scene["scene_id"]]
        assert (len(own), len(inside)) == (scene["n_rooms"], scene["n_objects"])
        assert {*inside} <= {*own}
