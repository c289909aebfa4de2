"""Navmeshes built from made scenes as each family's reader draws them: one island a connected floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.samples import FAMILIES, Layout, make_layouts, make_samples
from condvln.samples.floor_mesh import free_floor
from condvln.samples.hm3d import SPLITS
from condvln.samples.layout import WALL_THICKNESS, Room
from condvln.samples.thor_metadata import FLOOR_PLANS, ROBOTHOR_SCENES
from condvln.sources.registry import open_source

RADIUS, CELL = 0.1, 0.05
# Voxels and simplified outlines move the floor's border by so much, in metres.
BORDER = 0.15
# Everything else that can be stood on lies higher: beds, tables and counters, all of them small.
FURNITURE, FURNITURE_AREA = 0.3, 4.0
# Two voxels of height: what an agent that climbs 0.2 m may step on.
STEP = 0.4


def connected_floors(family: str, layouts: dict[str, Layout]) -> dict[str, tuple[Layout, shapely.Polygon]]:
    """The part of its layout that each scene of a family holds, by scene id.

    Apartments are one connected floor. iTHOR's plans are rooms with nothing behind their doors.
    """
    if family == "ithor":
        return {
            f"FloorPlan{FLOOR_PLANS[label] + number}": (layout, inside(room))
            for label in FLOOR_PLANS
            for number, (layout, room) in enumerate(
                ((layout, room) for layout in layouts.values() for room in layout.rooms if room.label == label), start=1
            )
        }
    names = {
        "gibson": [f"verified/{name}" for name in layouts],
        "hm3d": [
            f"{split}/{first + k:05d}-{name}" for k, name in enumerate(layouts) for split, first in [SPLITS[k % 3]]
        ],
        "procthor": [f"houses-{number}" for number in range(len(layouts))],
        "robothor": list(ROBOTHOR_SCENES[: len(layouts)]),
    }
    whole = [(layout, shapely.box(*layout.bounds[0], *layout.bounds[1])) for layout in layouts.values()]
    return dict(zip(names.get(family, layouts), whole, strict=True))


def inside(room: Room) -> shapely.Polygon:
    return room.shape.buffer(-WALL_THICKNESS / 2, join_style="mitre")


def ground_islands(family: str, folder: Path, scenes: int, seed: int) -> dict[str, int]:
    """Number of islands on the floor of each scene, every one of them checked."""
    make_samples(folder, family, scenes, seed)
    source = open_source(family, folder)
    floors = connected_floors(family, make_layouts(scenes, seed))
    assert {handle.scene_id for handle in source.handles()} == set(floors)
    found = {}
    for scene_id, (layout, part) in floors.items():
        scene = source.read(scene_id)
        surfaces = source.geometry(scene)
        assert surfaces is not None, scene_id
        settings = NavMeshSettings(agent_radius=RADIUS, include_static_objects=True)
        built = Pathfinder(build_navmesh(surfaces.vertices, surfaces.faces, settings))
        # ProcTHOR's houses begin at (0, 0).
        shift = np.array([min(item.center[k] for item in scene.objects) for k in (0, 2)])
        shift -= [min(float(item.center[k]) for item in layout.furniture) for k in (0, 2)]
        found[scene_id] = check_ground(built, layout, part, shift if family == "procthor" else np.zeros(2))
    return found


def check_ground(built: Pathfinder, layout: Layout, part: shapely.Polygon, shift: np.ndarray) -> int:
    """Every connected floor lies on one island; what is no floor is the top of some furniture."""
    ground = built.navmesh.tile.verts[:, 1].min()
    heights = [built.get_random_navigable_points(20, 0, island=k)[:, 1] for k in range(built.num_islands)]
    low = [k for k, height in enumerate(heights) if height.min() < ground + FURNITURE]
    areas = [built.island_area(k) for k in range(built.num_islands)]
    assert all(areas[k] < FURNITURE_AREA for k in range(built.num_islands) if k not in low)
    # Within a wall's distance of the part's border nobody stands.
    free = shapely.intersection(free_floor(layout, RADIUS), part.buffer(-RADIUS, join_style="mitre"))
    # Metadata knows the box of a floor only: what an L-shaped room leaves of it is floor too.
    spare = part.envelope.area - part.area
    spare += sum(step.area for step in steps(layout) if part.covers(step.centroid))
    assert 0.94 * free.area < sum(areas[k] for k in low) < 1.03 * free.area + spare
    passable = shapely.intersection(free_floor(layout, RADIUS + CELL), part.buffer(-RADIUS - CELL, join_style="mitre"))
    reached = set()
    for floor in shapely.get_parts(passable):
        points = grid_on(floor.buffer(CELL - BORDER), shift)
        assert all(built.is_navigable(point, FURNITURE) for point in points)
        islands = set(built.get_islands(built.snap_points(points)).tolist())
        assert len(islands) <= 1
        reached |= islands
    assert reached == set(low)
    return len(low)


def steps(layout: Layout) -> list[shapely.Polygon]:
    """Footprints of furniture low enough to step on, which the free floor leaves out with all around it."""
    low = [piece for piece in layout.furniture if piece.aabb[1, 1] < STEP]
    return [piece.footprint.buffer(RADIUS, join_style="mitre") for piece in low]


def grid_on(floor: shapely.Geometry, shift: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a grid on a floor, just above it."""
    if floor.is_empty:
        return np.zeros((0, 3))
    x0, z0, x1, z1 = floor.bounds
    grid = np.stack(np.meshgrid(np.arange(x0, x1, 0.2), np.arange(z0, z1, 0.2)), axis=-1).reshape(-1, 2)
    free = grid[shapely.contains_xy(floor, *grid.T)] + shift
    return np.column_stack([free[:, 0], np.full(len(free), 0.1), free[:, 1]])


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_every_connected_floor_is_one_island(family: str, tmp_path: Path) -> None:
    islands = ground_islands(family, tmp_path, 2, seed=5)
    assert set(islands.values()) == {1}, islands


@pytest.mark.soak
@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_the_same_of_six_apartments_with_narrow_passages(family: str, tmp_path: Path) -> None:
    """A gap of less than radius and a voxel on both sides may part a floor, and only such a gap."""
    assert max(ground_islands(family, tmp_path, 6, seed=11).values()) <= 2
