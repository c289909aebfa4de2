"""How well drawn surfaces agree with a simulator: the positions that AI2-THOR's agent reached, and those of ours.

The reachable positions that go with the metadata are those of the ALFRED benchmark (AI2-THOR 2.1.0). Its agent is a
capsule of radius 0.175 m and height 0.9 m (allenai/ai2thor#732), and each position was kept only if the agent could
turn around there, looking up, ahead and down, with a small object in its hand (askforalfred/alfred,
``gen/layouts/precompute_layout_locations.py``). So both are asked for: floor for the body, and room for the hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.settings import NavMeshSettings
from condvln.scene.geometry import SceneGeometry
from schemas.errors import InputError

__all__ = ["GRID", "Reachability", "reachability"]

F64 = NDArray[np.float64]

GRID: Final = 0.25
"""Metres between reachable positions."""

BODY_RADIUS: Final = 0.175
BODY_HEIGHT: Final = 0.9
"""Metres, of the agent's capsule."""

HAND_REACH: Final = 0.45
"""Metres from the agent's axis to the far side of what it holds. Nobody documents it. Positions of seven floor plans
keep 0.34 m or more from the box of all that stands at the hand's height (but for a lamp, which is a pole there), and
only 0.03 to 0.2 m from lower boxes; of these plans 0.40 to 0.475 m tell nearly the same."""

HAND_HEIGHTS: Final = 1.2, 1.5
"""Metres between which the hand moves as the agent looks down and up."""

CELL: Final = 0.025
CELL_HEIGHT: Final = 0.1
"""Metres of a voxel: `BODY_RADIUS`, `BODY_HEIGHT` and `HAND_REACH` are whole numbers of them."""

ON_FLOOR: Final = 0.3
"""Metres above the floor below which the navmesh is the floor's and no furniture's."""


@dataclass(frozen=True, slots=True)
class Reachability:
    """Positions of the grid: found reachable by the simulator, by us, and by both."""

    reachable: int
    navigable: int
    both: int

    @property
    def precision(self) -> float:
        """Share of our positions that are the simulator's too; 1 where we have none."""
        return self.both / self.navigable if self.navigable else 1.0

    @property
    def recall(self) -> float:
        """Share of the simulator's positions that are ours too; 1 where it has none."""
        return self.both / self.reachable if self.reachable else 1.0


def reachability(geometry: SceneGeometry, positions: F64, hand: bool = True) -> Reachability:
    """Compares the navmesh built of surfaces with positions (n, 2) of (x, z) in Habitat's frame, on a grid of `GRID`.

    Parameters
    ----------
    hand : ask for room for the hand too

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
    """(n, 2) whole numbers of grid steps that cover the scene and all known positions, and the points (n, 3)."""
    ground = np.concatenate([geometry.vertices[:, [0, 2]] / GRID, np.array(sorted(theirs)).reshape(-1, 2)])
    low, high = np.floor(ground.min(axis=0)).astype(int), np.ceil(ground.max(axis=0)).astype(int)
    steps = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij")
    cells = np.stack(steps, axis=-1).reshape(-1, 2)
    return cells, np.column_stack([cells[:, 0] * GRID, np.zeros(len(cells)), cells[:, 1] * GRID])


def _at_hand(geometry: SceneGeometry) -> NDArray[np.int64]:
    """Faces of the floor, and of what reaches into the heights of the hand."""
    heights = geometry.vertices[geometry.faces][:, :, 1]
    low, high = heights.min(axis=1), heights.max(axis=1)
    at_hand = (low <= HAND_HEIGHTS[1]) & (high >= HAND_HEIGHTS[0])
    faces: NDArray[np.int64] = geometry.faces[at_hand | ((low == 0) & (high == 0))]
    return faces


def _on_floor(
    geometry: SceneGeometry, faces: NDArray[np.int64], radius: float, height: float, points: F64, main_only: bool
) -> NDArray[np.bool_]:
    """Which points lie on the floor's navmesh for an agent of this size, or on that island of it which holds most."""
    # Regions are in cells, and 1 m² of them or less is dropped by default.
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
        return np.zeros(len(points), np.bool_)  # no floor is left to stand on
    on = nav.are_navigable(points) & (nav.snap_points(points)[:, 1] < ON_FLOOR)
    if main_only and on.any():
        islands = nav.get_islands(points)
        on &= islands == np.bincount(islands[on]).argmax()
    return np.asarray(on, dtype=np.bool_)
