"""Speed of ``condvln trajectories``: images written against images rendered, and two workers against one.

``python -m benchmarks trajectories`` prints three tables. The first two compare the CPU time of writing walks
(rendering, encoding, hashing, files, rows) with that of observing the same poses through the same cameras as an agent
does, with arrays and no files: first walks without a repeated pose, then direct and recovery walks of made episodes,
which share many poses. The third makes the same recipe with one and with two Ray workers, by the clock: it needs a
quiet machine with two cores. Before it, two processes without Ray write images at the same time, and then one alone:
two cores that share caches, memory or a clock do less than twice as much, and no scheduler can do more. Targets: at
least 0.85 of the frames of the sensors alone, and 1.9 times as fast with two workers.

No files are removed before the end: ext4 does not reuse an inode for some seconds after its file was removed, and looks
for another one in every new file's time. That would be measured as the cost of writing.
"""

from __future__ import annotations

import multiprocessing
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

from condvln.manifest import manifest_paths
from condvln.samples import make_samples
from condvln.sensors.renderer import Renderer
from condvln.sources.registry import open_source
from condvln.sources.source import hash_file
from condvln.trajectories.cameras import hub_cameras
from condvln.trajectories.images import ImageWriter, image_path
from condvln.trajectories.walks import point_of, vector
from condvln.world import open_world
from jobs.export import run_export
from jobs.generate import run_generate
from jobs.stages.trajectories import WalkStage
from jobs.trajectories import Request, make_trajectories
from jobs.trajectory_units import find_split, list_units
from schemas.config import (
    CameraConfig,
    Config,
    Family,
    InstructionsConfig,
    SourceConfig,
    TrajectoryConfig,
)
from schemas.program import CATEGORIES
from schemas.tables import LEFT_OUT, POSES, STEPS, TRAJECTORIES

ROUNDS: Final = 3
WALKS: Final = 4
FRAMES: Final = 60
"""Frames of a walk in the first table."""
PER_CATEGORY: Final = 6
"""Episodes of each category in the second table."""
SCENES: Final = 32
LONG: Final = 1800
"""Frames of each scene in the third table: enough work for Ray's start, and two workers' uneven ends, to be small."""
LONG_ROUNDS: Final = 1

Row = dict[str, Any]


def walked(scene_id: str, pathfinder: Any, walks: int, frames: int) -> list[Row]:
    """Return rows of ``steps``: walks that turn once around at random places, a step of 15° each."""
    pathfinder.seed(1)
    rows = []
    for number in range(walks):
        base: Row = {"scene_id": scene_id, "trajectory": f"{scene_id.replace('/', '-')}_{number}", "kind": "direct"}
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


def compared(
    renderer: Renderer, cameras: Mapping[str, CameraConfig], parts: list[pa.Table], out: Path, rounds: int
) -> list[str]:
    """Return a row of the first two tables: frames per CPU second rendered and written, medians, and their ratio.

    parts : rows of ``steps``; rendering and writing take turns after each part
    out : a new folder for all that is written
    """
    names = {name.replace(".", "_"): camera for name, camera in cameras.items()}
    frames = sum(len(part) for part in parts)

    def render(part: pa.Table) -> None:
        for row in part.select(["position", "heading"]).to_pylist():
            renderer.observe(names, point_of(row["position"]), row["heading"])

    def both(number: int) -> tuple[float, float]:
        """Return the CPU seconds of rendering and of writing."""
        writer = ImageWriter(out / str(number), renderer, cameras, TrajectoryConfig())
        times = [(cpu_seconds(partial(render, part)), cpu_seconds(partial(writer.write, part))) for part in parts]
        return sum(one for one, _ in times), sum(other for _, other in times)

    both(0)
    taken = [both(number) for number in range(1, rounds + 1)]
    alone, written = (frames / statistics.median(times) for times in zip(*taken, strict=True))
    ratios = sorted(one / other for one, other in taken)
    return [f"{alone:.1f}", f"{written:.1f}", f"{ratios[len(ratios) // 2]:.3f}", f"{ratios[0]:.3f} to {ratios[-1]:.3f}"]


def made_walks(folder: Path, family: Family) -> list[pa.Table]:
    """Return ``steps`` of the direct and recovery walks of episodes in a made scene, in a list of its own."""
    instructions = InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY))
    config = Config(
        name="walks",
        store=folder / f"{family}-store",
        export=folder / f"{family}-export",
        sources=(SourceConfig(family=family, root=folder / family),),
        instructions=instructions,
    )
    run_generate(config, inline=True)
    run_export(config)
    walks = TrajectoryConfig(walks=("direct", "recovery"))
    found = []
    for manifest in manifest_paths(folder / f"{family}-export"):
        target = find_split(str(folder / f"{family}-export"), manifest.stem, scenes=(f"{family}={folder / family}",))
        for unit in list_units(target, hub_cameras("streamvln", ()), walks, hash_file):
            found.append(WalkStage(walks).run(unit, {}, {}).tables["steps"])
    return [pa.concat_tables(found)] if found else []


def written_and_rendered(folder: Path) -> None:
    """Print the first two tables."""
    heading = "| family | cameras | poses | distinct | rendered, frames/CPU s | written | ratio | rounds |"
    print(f"{heading}\n|---|---|---|---|---|---|---|---|")
    families: tuple[Family, ...] = ("replicacad", "procthor", "gibson")
    for real in (False, True):
        for family in families:
            if not real:
                make_samples(folder / family, family=family, scenes=1, seed=1)
            source = open_source(family, folder / family)
            world = open_world(source, source.scene_ids()[0])
            if real:
                parts = made_walks(folder, family)
            else:
                rows = walked(world.scene.scene_id, world.pathfinder, WALKS, FRAMES)
                steps = pa.Table.from_pylist(rows, schema=STEPS)
                parts = [steps.slice(at, FRAMES) for at in range(0, len(steps), FRAMES)]
            if not parts:
                print(f"no episode could be placed in the made scene of {family}", flush=True)
                continue
            poses = [(*row["position"].values(), row["heading"]) for part in parts for row in part.to_pylist()]
            for layouts in ((), ("internvla-n1",)):
                cameras = hub_cameras("streamvln", layouts)
                out = folder / f"written-{real}-{family}-{len(cameras)}"
                row = compared(world.renderer, cameras, parts, out, 1 if real else ROUNDS)
                shown = [family, ", ".join(cameras), f"{len(poses):,}", f"{len(set(poses)):,}", *row]
                print("| " + " | ".join(shown) + " |", flush=True)


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
            "kind": "direct",
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
        # A row group of a scene's poses, as in a published recipe: otherwise each scene reads those of all scenes.
        rows = pa.Table.from_pylist(found, schema=schema.append(family))
        pq.write_table(rows, folder / f"{table}.parquet", row_group_size=LONG)
    record = {"split": "train", "layouts": ["streamvln"], "config": TrajectoryConfig().model_dump(mode="json")}
    record["cameras"] = {name: camera.model_dump(mode="json") for name, camera in cameras.items()}
    (folder / "trajectories.json").write_bytes(orjson.dumps(record))


def _write_alone(data: Path, out: Path, number: int, start: Any, times: Any) -> None:
    """Write a long walk of the first scene after all processes are ready; put the seconds that it took into `times`."""
    source = open_source("procthor", data)
    world = open_world(source, min(source.scene_ids()))
    rows = walked(world.scene.scene_id, world.pathfinder, 1, LONG)
    writer = ImageWriter(out / str(number), world.renderer, hub_cameras("streamvln", ()), TrajectoryConfig())
    steps = pa.Table.from_pylist(rows, schema=STEPS)
    writer.write(steps.slice(0, FRAMES))
    start.wait()
    begun = time.perf_counter()
    writer.write(steps)
    times.put(time.perf_counter() - begun)


def bound(folder: Path, data: Path) -> float:
    """Return how many times as much two processes do that have nothing to do with each other, by the clock."""
    context = multiprocessing.get_context("spawn")
    means: dict[int, list[float]] = {2: [], 1: []}
    for number in range(ROUNDS):
        for processes, found in means.items():
            start, times = context.Barrier(processes), context.Queue()
            out = folder / f"bound-{number}-{processes}"
            running = [
                context.Process(target=_write_alone, args=(data, out, k, start, times)) for k in range(processes)
            ]
            for process in running:
                process.start()
            found.append(statistics.mean(times.get() for _ in running))
            for process in running:
                process.join()
    return 2 * statistics.median(means[1]) / statistics.median(means[2])


def two_workers(folder: Path) -> None:
    """Print the third table."""
    make_samples(folder / "houses", family="procthor", scenes=SCENES, seed=2)
    most = bound(folder, folder / "houses")
    print(f"\nTwo processes without Ray do {most:.2f} × as much as one", flush=True)
    write_recipe(folder / "recipe", folder / "houses")
    taken: dict[int, list[float]] = {1: [], 2: []}
    worked: dict[int, list[float]] = {1: [], 2: []}
    for number in range(LONG_ROUNDS):
        for workers, times in taken.items():
            request = Request(
                target="",
                out=folder / f"out-{number}-{workers}",
                recipe=folder / "recipe",
                scenes=(f"procthor={folder / 'houses'}",),
                workers=workers,
            )
            begun = time.perf_counter()
            report = make_trajectories(request, Console(quiet=True))
            times.append(time.perf_counter() - begun)
            worked[workers].append(sum(report.document["stage_seconds"].values()))
    print("\n| workers | whole command, s | all stages, s | else (start, tables), s | faster | rounds |")
    print("|---|---|---|---|---|---|")
    ratios = [a / b for a, b in zip(*taken.values(), strict=True)]
    for workers, times in taken.items():
        whole, stages = statistics.median(times), statistics.median(worked[workers])
        row = [f"{workers}", f"{whole:.1f}", f"{stages:.1f}", f"{whole - stages / workers:.1f}"]
        row += (
            ["", ""] if workers == 1 else [f"{statistics.median(ratios):.2f} ×", ", ".join(f"{r:.2f}" for r in ratios)]
        )
        print("| " + " | ".join(row) + " |")
    print(f"\n{SCENES * LONG:,} frames in {SCENES} scenes")


def main() -> None:
    """Print the tables."""
    with tempfile.TemporaryDirectory() as folder:
        written_and_rendered(Path(folder))
        two_workers(Path(folder))


if __name__ == "__main__":
    main()
