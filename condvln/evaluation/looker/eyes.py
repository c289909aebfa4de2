"""The perception of the looker agent: depth, instance masks of objects, and their rooms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray
from scipy import ndimage
from shapely import Polygon, contains_xy

from condvln.arrays import F64
from condvln.labels import Vocabulary, vocabulary
from condvln.scene import Scene
from condvln.seeding import generator
from condvln.sensors import Renderer
from condvln.sensors.camera import pixel_rays
from schemas.config import CameraConfig, LookerConfig, NoiseConfig

__all__ = ["GHOST", "Eyes", "Look", "RoomLookup", "SeenView"]


GHOST: Final = 1_000_000
"""First instance number of false detections."""
LOOKUP_CELL: Final = 0.1
"""Cell size of the room table in metres."""


@dataclass(frozen=True, eq=False, slots=True)
class SeenView:
    """The view of one of the cameras around the agent.

    depth (h, w) : metres along the optical axis, 0 where nothing is seen
    regions (h, w) : room number of each pixel's point, -1 if unknown
    turn : radians to the left of the agent's heading; eye : metres above its feet
    """

    depth: NDArray[np.float32]
    regions: NDArray[np.int16]
    columns: F64
    rows: F64
    turn: float
    eye: float


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """The view in all directions from one pose.

    points (n, 3) : points on objects, in metres to the right of the agent, above its feet, and ahead of it
    owner (n,) : number of each point's object
    things : label and room number of each object in view, by its number
    rooms : room labels by number; here : number of the agent's room, -1 if unknown
    """

    views: tuple[SeenView, ...]
    points: F64
    owner: NDArray[np.int64]
    things: Mapping[int, tuple[str, int]]
    rooms: Mapping[int, str]
    here: int


class RoomLookup:
    """Room numbers by position, from tables; -1 outside all room polygons."""

    def __init__(self, scene: Scene) -> None:
        self.labels = {k: room.label for k, room in enumerate(scene.rooms)}
        drawn = [(k, room) for k, room in enumerate(scene.rooms) if room.polygon is not None]
        self._single = len(scene.rooms) == 1
        self._tables: list[tuple[float, NDArray[np.int16], NDArray[np.int16]]] = []
        self._low = np.zeros(2)
        if not drawn or self._single:
            return
        corners = np.concatenate([room.polygon for _, room in drawn])
        self._low = corners.min(axis=0) - 0.5
        size = np.ceil((corners.max(axis=0) + 0.5 - self._low) / LOOKUP_CELL).astype(int)
        x, z = np.meshgrid(*((np.arange(n) + 0.5) * LOOKUP_CELL + low for n, low in zip(size, self._low, strict=True)),
                           indexing="ij")  # fmt: skip
        for floor in sorted({round(room.floor_y, 1) for _, room in drawn}):
            table = np.full(x.shape, -1, np.int16)
            for k, room in drawn:
                if round(room.floor_y, 1) == floor:
                    table[contains_xy(Polygon(room.polygon), x.ravel(), z.ravel()).reshape(x.shape)] = k
            self._tables.append((floor, table, _inner(table)))

    def __call__(self, points: F64, feet: float, *, inner: bool = False) -> NDArray[np.int16]:
        """Return the room numbers (n,) of points (n, 3) on the agent's storey; `feet` is the height of the agent's feet
        in metres.

        inner : -1 also beside the border of another room, where a point may be on the other side of a wall
        """
        if self._single:
            return np.zeros(len(points), np.int16)
        if not self._tables:
            return np.full(len(points), -1, np.int16)
        _, whole, narrowed = min(self._tables, key=lambda one: abs(one[0] - feet))
        table = narrowed if inner else whole
        a = np.floor((points[:, 0] - self._low[0]) / LOOKUP_CELL).astype(np.intp)
        b = np.floor((points[:, 2] - self._low[1]) / LOOKUP_CELL).astype(np.intp)
        inside: NDArray[np.bool_] = (a >= 0) & (a < table.shape[0]) & (b >= 0) & (b < table.shape[1])
        return np.where(inside, table[np.where(inside, a, 0), np.where(inside, b, 0)], -1).astype(np.int16)


class Eyes:
    """Cameras in all directions for an agent in one scene, with simulated detector errors.

    Errors belong to objects, not to views: an object that is missed is missed in the whole episode. Each object has its
    own random draws, so that a higher error rate keeps all errors of a lower one.
    """

    def __init__(self, scene: Scene, renderer: Renderer, config: LookerConfig, words: Vocabulary = vocabulary) -> None:
        self._renderer, self._config = renderer, config
        self.rooms = RoomLookup(scene)
        number = {room.room_id: k for k, room in enumerate(scene.rooms)}
        known = words.labels
        self._label = [item.label for item in scene.objects]
        self._room = [number.get(item.room_id, -1) for item in scene.objects]
        self._named: NDArray[np.bool_] = np.array(
            [False, *(name in known and words.entry(name).kind != "structure" for name in self._label)]
        )
        self._labels = sorted({name for name, named in zip(self._label, self._named[1:], strict=True) if named})
        self._cameras = [
            CameraConfig(
                width=config.pixels, height=config.pixels, hfov=90.0, turn=turn, max_depth=None, normalized=False
            )
            for turn in (0.0, 90.0, 180.0, -90.0)
        ]
        self._seed, self._names = 0, ("",)
        self._errors = cache(self._error)

    def begin(self, seed: int, episode: str) -> None:
        """Draw the detector errors of a new episode."""
        self._seed, self._names = seed, (episode,)
        self._errors = cache(self._error)

    def __call__(self, position: npt.ArrayLike, heading: float) -> Look:
        """Return the view from the feet's position (3,) in metres, with a heading in radians counter-clockwise from
        −Z.
        """
        feet = np.asarray(position, np.float64)
        views, points, owners = [], [], []
        for camera in self._cameras:
            frame = self._renderer.look(camera, feet, heading, rgb=False)
            columns, rows = pixel_rays(camera)
            turn = math.radians(camera.turn)
            depth = frame.depth.astype(np.float64)
            right = columns[None] * depth
            slant = np.hypot(columns, 1.0)[None]  # metres on the ground for one along the optical axis
            whole = _turned(right, rows[:, None] * depth, depth, turn + heading).reshape(-1, 3)
            world = whole * [1.0, 1.0, -1.0] + feet
            regions = self.rooms(world, float(feet[1]), inner=True).reshape(depth.shape)
            views.append(SeenView(frame.depth, regions, columns, rows, turn, camera.eye_height))
            shown = self._named[frame.instance] & (slant * depth <= self._config.reach)
            up = (rows[:, None] * depth + camera.eye_height)[shown]
            points.append(_turned(right[shown], up, depth[shown], turn))
            owners.append(frame.instance[shown].astype(np.int64) - 1)
        owner, cloud = np.concatenate(owners), np.concatenate(points)
        here = int(self.rooms(feet[None], float(feet[1]))[0])
        return self._detected(tuple(views), cloud, owner, here)

    def _detected(self, views: tuple[SeenView, ...], points: F64, owner: NDArray[np.int64], here: int) -> Look:
        pixels = np.bincount(owner)
        numbers = np.flatnonzero(pixels)
        counts = pixels[numbers]
        rank = np.zeros(len(pixels), np.intp)
        rank[numbers] = np.arange(len(numbers))
        inverse = rank[owner]
        things: dict[int, tuple[str, int]] = {}
        kept = np.zeros(len(numbers), bool)
        ghosts, ghost_owner = [points], [owner]
        for k, (number, count) in enumerate(zip(numbers.tolist(), counts.tolist(), strict=True)):
            if count < self._config.least_pixels:
                continue
            label, ghost = self._errors(number)
            if label is not None:
                things[number] = label, self._room[number]
                kept[k] = True
            if ghost is not None:
                things[GHOST + number] = ghost, self._room[number]
                ghosts.append(points[inverse == k])
                ghost_owner.append(np.full(count, GHOST + number))
        ghosts[0], ghost_owner[0] = points[kept[inverse]], owner[kept[inverse]]
        seen_rooms = {room for _, room in things.values()} | {here}
        for view in views:
            seen_rooms |= set((np.flatnonzero(np.bincount(view.regions.ravel() + 1)) - 1).tolist())
        rooms = {room: self.rooms.labels[room] for room in sorted(seen_rooms) if room >= 0}
        return Look(views, np.concatenate(ghosts), np.concatenate(ghost_owner), things, rooms, here)

    def _error(self, number: int) -> tuple[str | None, str | None]:
        """Return the label that the detector gives to an object (None if it misses the object), and the label of a
        false detection at the object's place (None if there is none).
        """
        noise, label = self._config.noise, self._label[number]
        if noise == NoiseConfig():
            return label, None
        missed, confused, other, false, which = generator(self._seed, "detector", *self._names, number).uniform(size=5)
        rest = [name for name in self._labels if name != label]
        ghost = rest[int(which * len(rest))] if false < noise.false and rest else None
        if missed < noise.missed:
            return None, ghost
        if confused < noise.confused and rest:
            return rest[int(other * len(rest))], ghost
        return label, ghost


def _inner(table: NDArray[np.int16]) -> NDArray[np.int16]:
    """Return a table of room numbers with -1 for cells next to those of another room."""
    most = ndimage.maximum_filter(table, 3)
    least = ndimage.minimum_filter(np.where(table < 0, np.iinfo(np.int16).max, table), 3)
    return np.where((table >= 0) & (least == most), table, -1).astype(np.int16)


def _turned(right: F64, up: F64, ahead: F64, turn: float) -> F64:
    """Return points (..., 3) right, up and ahead of an agent, given by their coordinates (...) in a frame that is
    turned left of the agent's by `turn` radians.
    """
    c, s = math.cos(turn), math.sin(turn)
    return np.stack([c * right - s * ahead, up, s * right + c * ahead], axis=-1)
