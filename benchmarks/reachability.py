"""AI2-THOR rooms drawn from metadata: precision and recall of the 0.25 m grid against the simulator's reachable
positions.

Run as ``python benchmarks/reachability.py [FOLDER]``; a line per floor plan, with room for the hand and without, for
the real floor plans of the folder (else of ``CONDVLN_REAL_DATA``), or for made ones where there are none.

The reachable positions that go with the metadata are those of the ALFRED benchmark (AI2-THOR 2.1.0). Its agent is a
capsule of radius 0.175 m and height 0.9 m (allenai/ai2thor#732), and each position was kept only if the agent could
turn around there, looking up, ahead and down, with a small object in its hand (askforalfred/alfred,
``gen/layouts/precompute_layout_locations.py``). So both are tested: floor for the body, and space for the hand.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.maker import make_samples
from condvln.scene.scene import SceneGeometry
from condvln.sources.registry import open_source
from schemas.errors import InputError

F64 = NDArray[np.float64]

GRID: Final = 0.25
"""Grid spacing of reachable positions in metres."""

BODY_RADIUS: Final = 0.175
BODY_HEIGHT: Final = 0.9
"""Radius and height in metres of the agent's capsule."""

HAND_REACH: Final = 0.45
"""Distance in metres from the agent's axis to the far side of the held object. It is undocumented. Positions of seven
floor plans keep at least 0.34 m from the boxes of everything at hand height (except a thin lamp), and only 0.03 to 0.2
m from lower boxes; on these plans all values from 0.40 to 0.475 m give nearly the same result.
"""

HAND_HEIGHTS: Final = 1.2, 1.5
"""Range of heights in metres through which the hand moves as the agent looks down and up."""

CELL: Final = 0.025
CELL_HEIGHT: Final = 0.1
"""Voxel size in metres: `BODY_RADIUS`, `BODY_HEIGHT` and `HAND_REACH` are multiples of it."""

ON_FLOOR: Final = 0.3
"""Height in metres above the floor up to which the navmesh is floor and not furniture."""


@dataclass(frozen=True, slots=True)
class Reachability:
    """Numbers of grid positions that are reachable in the simulator, on the navmesh of our surfaces, and in both."""

    reachable: int
    navigable: int
    both: int

    @property
    def precision(self) -> float:
        """Share of our reachable positions that are also reachable in the simulator; 1 if we have none."""
        return self.both / self.navigable if self.navigable else 1.0

    @property
    def recall(self) -> float:
        """Share of the simulator's reachable positions that our agent also reaches; 1 if the simulator has none."""
        return self.both / self.reachable if self.reachable else 1.0


def reachability(geometry: SceneGeometry, positions: F64, hand: bool = True) -> Reachability:
    """Count the grid positions that are reachable in the simulator, those that are reachable on our navmesh of
    `geometry`, and those that are reachable in both. `positions` (n, 2) are those reachable in the simulator, as (x, z)
    in Habitat's frame; the grid's spacing is `GRID`.

    Parameters
    ----------
    hand : also require space for the hand

    Raises
    ------
    FormatError : the geometry is malformed
    """
    theirs = {(int(x), int(z)) for x, z in np.round(positions / GRID)}
    cells, points = _grid(geometry, theirs)
    ours = _on_floor(geometry, geometry.faces, BODY_RADIUS, BODY_HEIGHT, points, main_only=True)
    if hand:
        ours &= _on_floor(geometry, _at_hand(geometry), HAND_REACH, HAND_HEIGHTS[1], points, main_only=False)
    found = {(int(x), int(z)) for x, z in cells[ours]}
    return Reachability(len(theirs), len(found), len(found & theirs))


def _grid(geometry: SceneGeometry, theirs: set[tuple[int, int]]) -> tuple[NDArray[np.int64], F64]:
    """Return the n points of a grid that covers the scene and the simulator's positions: their integer grid coordinates
    (n, 2), and their positions (n, 3) in metres.
    """
    ground = np.concatenate([geometry.vertices[:, [0, 2]] / GRID, np.array(sorted(theirs)).reshape(-1, 2)])
    low, high = np.floor(ground.min(axis=0)).astype(int), np.ceil(ground.max(axis=0)).astype(int)
    steps = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
    cells = np.stack(steps, axis=-1).reshape(-1, 2)
    return cells, np.column_stack([cells[:, 0] * GRID, np.zeros(len(cells)), cells[:, 1] * GRID])


def _at_hand(geometry: SceneGeometry) -> NDArray[np.int64]:
    """Return one array of faces (m, 3): those of the floor, and those that extend into the heights at which an agent
    holds its hand.
    """
    heights = geometry.vertices[geometry.faces][:, :, 1]
    low, high = heights.min(axis=1), heights.max(axis=1)
    at_hand = (low <= HAND_HEIGHTS[1]) & (high >= HAND_HEIGHTS[0])
    faces: NDArray[np.int64] = geometry.faces[at_hand | ((low == 0) & (high == 0))]
    return faces


def _on_floor(
    geometry: SceneGeometry, faces: NDArray[np.int64], radius: float, height: float, points: F64, main_only: bool
) -> NDArray[np.bool_]:
    """Return whether each of the points is on the floor's navmesh for an agent of this size. With `main_only`, only the
    island that holds most of the points counts.
    """
    # Recast measures regions in cells and by default drops regions of 1 m² or less.
    settings = NavMeshSettings(
        cell_size=CELL,
        cell_height=CELL_HEIGHT,
        agent_radius=radius,
        agent_height=height,
        region_min_size=1 / CELL,
        region_merge_size=1 / CELL,
    )
    try:
        nav = Pathfinder.build(geometry.vertices, faces, settings)
    except InputError:
        return np.zeros(len(points), np.bool_)  # no walkable floor is left
    on = nav.are_navigable(points) & (nav.snap_points(points)[:, 1] < ON_FLOOR)
    if main_only and on.any():
        islands = nav.get_islands(points)
        on &= islands == np.bincount(islands[on]).argmax()
    return np.asarray(on, dtype=np.bool_)


def main() -> None:
    """Print the table."""
    named = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("CONDVLN_REAL_DATA", "")
    folder = Path(named) / "ithor" if named and (Path(named) / "ithor").is_dir() else Path(named)
    if named and any(folder.glob("*-reachable.npy")):
        compare(folder)
        return
    print("no real floor plans (set CONDVLN_REAL_DATA): made ones, whose agent has no hand")
    with tempfile.TemporaryDirectory() as made:
        make_samples(Path(made), "ithor", 6)
        compare(Path(made))


def compare(folder: Path) -> None:
    """Print one line per floor plan of a folder that also holds its reachable positions."""
    source = open_source("ithor", folder)
    print(f"{'plan':14s} {'reachable':>9s}   body only: P     R      with hand: P     R      seconds")
    for handle in source.handles():
        file = folder / f"{handle.scene_id}-reachable.npy"
        if not file.is_file():
            continue
        positions = np.load(file, allow_pickle=False) * np.array([1.0, -1.0])
        geometry = source.geometry(source.read(handle.scene_id))
        if geometry is None:
            print(f"{handle.scene_id:14s} no floor")
            continue
        begun = time.perf_counter()
        body, both = reachability(geometry, positions, hand=False), reachability(geometry, positions)
        spent = time.perf_counter() - begun
        print(
            f"{handle.scene_id:14s} {both.reachable:9d}        {body.precision:.3f} {body.recall:.3f}"
            f"           {both.precision:.3f} {both.recall:.3f}      {spent:.2f}"
        )


if __name__ == "__main__":
    main()
