"""Speed of ``condvln trajectories``: images written against images rendered, and two workers against one.

``python -m benchmarks trajectories`` prints two tables. The first compares the CPU time of writing walks (rendering,
encoding, hashing, files) with that of rendering the same poses alone, in alternating rounds over made scenes of three
families. The second makes the same recipe with one and with two Ray workers, by the clock: it needs a quiet machine
with two cores. Targets: at least 0.85 of the frames of the sensors alone, and 1.9 times as fast with two workers.
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console

from condvln.samples import make_samples
from condvln.sensors.renderer import Renderer
from condvln.sources.registry import open_source
from condvln.trajectories.cameras import hub_cameras
from condvln.trajectories.images import ImageWriter, image_path
from condvln.trajectories.tables import point_of, vector
from condvln.world import open_world
from jobs.trajectories import Request, make_trajectories
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.trajectory_tables import LEFT_OUT, POSES, STEPS, TRAJECTORIES

ROUNDS: Final = 3
WALKS: Final = 4
FRAMES: Final = 60
"""Frames of a walk in the first table."""
SCENES: Final = 8
LONG: Final = 500
"""Frames of each scene in the second table."""

Row = dict[str, Any]


def walked(scene_id: str, pathfinder: Any, walks: int, frames: int) -> list[Row]:
    """Return rows of ``steps``: walks that turn once around at random places, a step of 15° each."""
    pathfinder.seed(1)
    rows = []
    for number in range(walks):
        base: Row = {"scene_id": scene_id, "trajectory": f"{scene_id.replace('/', '-')}_{number}", "kind": "gold"}
        base |= {"episode_id": number, "leaf": 0, "looks_for": None, "distance_to_goal": 0.0}
        for frame in range(frames):
            if frame % 24 == 0:
                place = pathfinder.get_random_navigable_point()
            heading = frame * np.pi / 12 % (2 * np.pi)
            action = 0 if frame == frames - 1 else 2
            half = {"x": 0.0, "y": float(np.sin(heading / 2)), "z": 0.0, "w": float(np.cos(heading / 2))}
            own = {"frame": frame, "action": action, "executed": action, "heading": heading}
            rows.append(base | own | {"position": vector(place), "rotation": half})
    return rows


def cpu_seconds(run: Callable[[], object]) -> float:
    """Return the processor time of a call."""
    begun = time.process_time()
    run()
    return time.process_time() - begun


def compared(renderer: Renderer, cameras: Mapping[str, CameraConfig], steps: pa.Table, out: Path) -> list[str]:
    """Return a row of the first table: frames per CPU second rendered and written, medians, and their ratio."""
    coloured = {camera for name, camera in cameras.items() if name.startswith("rgb")}
    views = {camera: camera in coloured for camera in cameras.values()}
    parts = [steps.slice(at, FRAMES) for at in range(0, len(steps), FRAMES)]
    writer = ImageWriter(out, renderer, cameras, TrajectoryConfig())

    def render(part: pa.Table) -> None:
        for row in part.select(["position", "heading"]).to_pylist():
            for camera, rgb in views.items():
                renderer.look(camera, point_of(row["position"]), row["heading"], rgb=rgb)

    def both() -> tuple[float, float]:
        """Return the CPU seconds of rendering and of writing; they take turns after each walk."""
        shutil.rmtree(out, ignore_errors=True)
        times = [(cpu_seconds(partial(render, part)), cpu_seconds(partial(writer.write, part))) for part in parts]
        return sum(one for one, _ in times), sum(other for _, other in times)

    both()
    rounds = [both() for _ in range(ROUNDS)]
    alone, written = (len(steps) / statistics.median(times) for times in zip(*rounds, strict=True))
    ratios = sorted(one / other for one, other in rounds)
    return [f"{alone:.1f}", f"{written:.1f}", f"{ratios[len(ratios) // 2]:.3f}", f"{ratios[0]:.3f} to {ratios[-1]:.3f}"]


def written_and_rendered(folder: Path) -> None:
    """Print the first table."""
    print("| family | cameras | rendered, frames/CPU s | written | ratio | rounds |\n|---|---|---|---|---|---|")
    for family in ("replicacad", "procthor", "gibson"):
        make_samples(folder / family, family=family, scenes=1, seed=1)
        source = open_source(family, folder / family)
        world = open_world(source, source.scene_ids()[0])
        steps = pa.Table.from_pylist(walked(world.scene.scene_id, world.pathfinder, WALKS, FRAMES), schema=STEPS)
        for layouts in ((), ("internvla-n1",)):
            cameras = hub_cameras("streamvln", layouts)
            row = compared(world.renderer, cameras, steps, folder / "written")
            print(f"| {family} | {', '.join(cameras)} | " + " | ".join(row) + " |", flush=True)


def write_recipe(folder: Path, data: Path) -> None:
    """Write a recipe of one long walk in each scene of a dataset; its hashes are empty."""
    source = open_source("procthor", data)
    cameras = hub_cameras("streamvln", ())
    walks, poses = [], []
    for number, scene_id in enumerate(sorted(source.scene_ids())):
        rows = walked(scene_id, open_world(source, scene_id).pathfinder, 1, LONG)
        name = rows[0]["trajectory"]
        actions = [row["action"] for row in rows]
        walk: Row = {
            "scene_id": scene_id,
            "trajectory": name,
            "episode_id": number,
            "kind": "gold",
            "source": "procthor",
        }
        walk |= {"instruction_text": "", "frames_of": name, "n_frames": LONG, "actions": actions, "executed": actions}
        walk |= {"repeats": [1] * LONG, "goals": [], "success_distance": 1.0, "max_steps": LONG, "navmesh": ""}
        start = {"start_position": rows[0]["position"], "start_rotation": rows[0]["rotation"], "navmesh_sha256": ""}
        walks.append(walk | start)
        shown = {key: getattr(cameras["rgb"], key) for key in ("width", "height", "hfov", "eye_height", "look_down")}
        shown |= {"camera": "rgb", "intrinsics": None, "goal": None, "goal_frame": None, "bytes": 0, "sha256": ""}
        poses += [
            row | shown | {"episode_id": number, "source": "procthor", "image": image_path(name, "rgb", row["frame"])}
            for row in rows
        ]
    folder.mkdir()
    family = pa.field("source", pa.string(), nullable=False)
    for table, schema, found in (
        ("trajectories", TRAJECTORIES, walks),
        ("poses", POSES, poses),
        ("left_out", LEFT_OUT, []),
    ):
        pq.write_table(pa.Table.from_pylist(found, schema=schema.append(family)), folder / f"{table}.parquet")
    record = {"split": "train", "layouts": ["streamvln"], "config": TrajectoryConfig().model_dump(mode="json")}
    record["cameras"] = {name: camera.model_dump(mode="json") for name, camera in cameras.items()}
    (folder / "trajectories.json").write_bytes(orjson.dumps(record))


def two_workers(folder: Path) -> None:
    """Print the second table."""
    make_samples(folder / "houses", family="procthor", scenes=SCENES, seed=2)
    write_recipe(folder / "recipe", folder / "houses")
    taken: dict[int, list[float]] = {1: [], 2: []}
    for number in range(ROUNDS):
        for workers, times in taken.items():
            request = Request(
                target="",
                out=folder / f"out-{number}-{workers}",
                recipe=folder / "recipe",
                scenes=(f"procthor={folder / 'houses'}",),
                workers=workers,
            )
            report = make_trajectories(request, Console(quiet=True))
            times.append(report.document["seconds"])
            shutil.rmtree(request.out)
    one, two = (statistics.median(times) for times in taken.values())
    ratios = sorted(a / b for a, b in zip(*taken.values(), strict=True))
    print("\n| frames | one worker, s | two workers, s | faster | rounds |\n|---|---|---|---|---|")
    shown = ", ".join(f"{ratio:.2f}" for ratio in ratios)
    print(f"| {SCENES * LONG:,} | {one:.1f} | {two:.1f} | {ratios[len(ratios) // 2]:.2f} × | {shown} |")


def main() -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as folder:
        written_and_rendered(Path(folder))
        two_workers(Path(folder))


if __name__ == "__main__":
    main()
