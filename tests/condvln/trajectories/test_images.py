"""Images of a scene's walks: a pose that several walks share is rendered and written once, with the same files."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from condvln.samples import make_samples
from condvln.sensors.renderer import Renderer
from condvln.sources.registry import open_source
from condvln.trajectories.cameras import hub_cameras
from condvln.trajectories.images import ImageWriter
from condvln.trajectories.walks import vector
from condvln.world import open_world
from schemas.config import TrajectoryConfig
from schemas.tables import STEPS


def walk(name: str, places: np.ndarray, turns: list[int]) -> list[dict[str, Any]]:
    """Rows of ``steps``: at each place, the heading is so many turns of 15°."""
    rows = []
    for frame, (place, turn) in enumerate(zip(places, turns, strict=True)):
        heading = turn * np.pi / 12
        half = {"x": 0.0, "y": float(np.sin(heading / 2)), "z": 0.0, "w": float(np.cos(heading / 2))}
        row = {"scene_id": "s", "trajectory": name, "kind": "direct", "episode_id": 1, "leaf": 0, "looks_for": None}
        row |= {"distance_to_goal": 0.0, "frame": frame, "action": 2, "executed": 2, "heading": heading}
        rows.append(row | {"position": vector(place), "rotation": half})
    return rows


def test_a_pose_of_several_walks_is_rendered_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_samples(tmp_path / "made", family="procthor", scenes=1, seed=1)
    source = open_source("procthor", tmp_path / "made")
    world = open_world(source, source.scene_ids()[0])
    world.pathfinder.seed(1)
    places = np.array([world.pathfinder.get_random_navigable_point() for _ in range(3)])
    walks = [walk("one", places, [0, 1, 2]), walk("two", places[[0, 0, 1]], [0, 3, 1]), walk("three", places[:1], [0])]
    cameras = hub_cameras("streamvln", ("internvla-n1",))
    seen: list[tuple[Any, ...]] = []
    look = Renderer.look

    def counted(self: Renderer, camera: Any, position: Any, heading: float = 0.0, **kinds: bool) -> Any:
        seen.append((camera.model_dump_json(), *np.round(position, 6), heading))
        return look(self, camera, position, heading, **kinds)

    monkeypatch.setattr(Renderer, "look", counted)

    def written(out: str, parts: list[list[dict[str, Any]]]) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
        writer = ImageWriter(tmp_path / out, world.renderer, cameras, TrajectoryConfig())
        rows = [row for part in parts for row in writer.write(pa.Table.from_pylist(part, schema=STEPS)).to_pylist()]
        files = {
            f.relative_to(tmp_path / out).as_posix(): f.read_bytes() for f in (tmp_path / out).rglob("*") if f.is_file()
        }
        return files, rows

    alone = written("alone", walks)
    rendered, seen[:] = len(seen), []
    together = written("together", [[row for one in walks for row in one]])
    assert together == alone
    views = len(set(cameras.values()))
    assert rendered == 7 * views
    assert len(seen) == len(set(seen)) == 4 * views
    assert len(alone[0]) == 7 * len(cameras)
    assert inodes(tmp_path / "together") == 4 * len(cameras)

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EMLINK, "too many links")

    monkeypatch.setattr(os, "link", refused)
    assert written("copied", [[row for one in walks for row in one]]) == alone
    assert inodes(tmp_path / "copied") == 7 * len(cameras)


def inodes(folder: Path) -> int:
    """Number of files below the folder; hard links to one file count once."""
    return len({path.stat().st_ino for path in folder.rglob("*") if path.is_file()})
