"""Cost of an image compared with casting its rays through Embree: colour, depth and instances, one thread.

``python -m benchmarks cameras`` prints a Markdown table: milliseconds of processor time (medians of `RUNS` poses) of a
cast of prebuilt float32 rays, of a whole frame, and their ratio, over made scenes of several sizes with textures.
Target: a frame takes at most 1.4 times its bare cast.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from condvln.samples import make_samples
from condvln.sensors.camera import camera_pose, pixel_rays
from condvln.sensors.renderer import Renderer
from condvln.sensors.surfaces import Material, SurfaceBuilder
from condvln.sensors.text import TextSensor
from condvln.sources.registry import open_source
from condvln.world import open_world
from schemas.config import CameraConfig

RUNS: Final = 50
SIZES: Final = ((224, 224), (640, 480))
BALLS: Final = 60
TEXTURE: Final = 1024

F64 = NDArray[np.float64]


def textured_room(triangles: int) -> Renderer:
    """Build a room of 8 × 8 m with `BALLS` textured balls of about so many triangles in total; walls have tiles of that
    size."""
    rng = np.random.default_rng(0)
    builder = SurfaceBuilder()
    side = max(2, round((triangles / (BALLS + 6) / 2) ** 0.5))
    grid = np.linspace(0, 1, side + 1)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    square = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = square[:-1, :-1], square[1:, :-1], square[:-1, 1:], square[1:, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([c, b, d], -1).reshape(-1, 3)])
    places = np.stack([u, v], -1).reshape(-1, 2)[faces].astype(np.float32)

    def paint() -> int:
        picture = rng.integers(0, 256, (TEXTURE, TEXTURE, 3), dtype=np.uint8)
        levels = [picture]
        while levels[-1].shape[0] > 1:
            last = levels[-1].astype(np.uint16)
            levels.append(
                ((last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]) // 4).astype(np.uint8)
            )
        return builder.material(Material(texture=builder.texture(levels)))

    around, up = 2 * np.pi * u.reshape(-1), np.pi * (v.reshape(-1) - 0.5)
    ball = np.stack([np.cos(up) * np.cos(around), np.sin(up), -np.cos(up) * np.sin(around)], -1)
    for number in range(BALLS):
        centre = rng.uniform([-3.8, 0.1, -3.8], [3.8, 2.4, 3.8])
        builder.add((ball * rng.uniform(0.1, 0.4) + centre)[faces], number, paint(), places)
    flat = np.stack([u.reshape(-1), v.reshape(-1)], -1)
    for axis in range(3):
        for end in (0.0, 1.0):
            points = np.insert(flat, axis, end, axis=1) * [8, 2.5, 8] - [4, 0, 4]
            turned = faces if (axis == 1) == (end == 1.0) else faces[:, ::-1]
            builder.add(points[turned], -1, paint(), places if turned is faces else places[:, ::-1])
    return Renderer(builder.surfaces(), tuple(f"ball {k}" for k in range(BALLS)))


def median_ms(run: Callable[[int], object]) -> float:
    """Return the processor time of a call in milliseconds, the median over `RUNS`."""
    run(0)
    times = []
    for number in range(RUNS):
        begun = time.process_time_ns()
        run(number)
        times.append((time.process_time_ns() - begun) / 1e6)
    return float(np.median(times))


def measured(renderer: Renderer, camera: CameraConfig, places: F64) -> tuple[float, float, float]:
    """Return milliseconds of a bare cast, of depth and instance alone, and of a whole frame."""
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, renderer.surfaces.corners)
    columns, rows = pixel_rays(camera)
    grid = np.stack(np.broadcast_arrays(columns[None, :], rows[:, None], -1.0), axis=-1).reshape(-1, 3)
    headings = np.random.default_rng(1).uniform(0, 2 * np.pi, RUNS)
    poses = [camera_pose(camera, place, heading) for place, heading in zip(places, headings, strict=True)]
    built = [
        (
            np.tile((eye - renderer.surfaces.origin).astype(np.float32), (len(grid), 1)),
            (grid @ turn.T).astype(np.float32),
        )
        for eye, turn in poses
    ]
    return (
        median_ms(lambda k: scene.run(*built[k], output=1)),
        median_ms(lambda k: renderer.frame(camera, *poses[k], rgb=False)),
        median_ms(lambda k: renderer.frame(camera, *poses[k])),
    )


def main() -> None:
    """Print the table."""
    print("| scene | image | bare cast, ms | depth and instance, ms | with colour, ms | frame / cast |")
    print("|---|---|---|---|---|---|")
    for triangles in (2_000, 60_000, 900_000):
        renderer = textured_room(triangles)
        places = np.random.default_rng(2).uniform([-3.5, 0, -3.5], [3.5, 0, 3.5], (RUNS, 3))
        for width, height in SIZES:
            camera = CameraConfig(width=width, height=height, hfov=90.0 if width == height else 79.0)
            cast, depth, frame = measured(renderer, camera, places)
            count = len(renderer.surfaces.corners)
            print(
                f"| {count:,} triangles, {BALLS + 6} textures | {width} × {height} | {cast:.1f} | {depth:.1f} "
                f"| {frame:.1f} | {frame / cast:.2f} |",
                flush=True,
            )
    _texts()


def _texts() -> None:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        make_samples(Path(folder) / "made", family="procthor", scenes=1, seed=1)
        source = open_source("procthor", Path(folder) / "made")
        world = open_world(source, source.scene_ids()[0])
        sensor = TextSensor(world.scene, world.renderer)
        world.pathfinder.seed(1)
        place = world.pathfinder.get_random_navigable_point()
        taken = median_ms(lambda k: [sensor.observe(place, 0.1 * k + 0.01 * j) for j in range(20)]) / 20
    print(
        f"\nText observations of a drawn house: {1000 / taken:,.0f} a second of processor time ({taken:.2f} ms each)."
    )


if __name__ == "__main__":
    main()
