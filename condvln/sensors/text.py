"""Text observations for agents without images: the objects in view, and the map known so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from condvln.arrays import F64
from condvln.labels import vocabulary
from condvln.scene import Room, Scene
from condvln.seeding import generator
from condvln.sensors.camera import pixel_rays
from condvln.sensors.renderer import Renderer
from schemas.config import CameraConfig, NoiseConfig

__all__ = ["TEXT_CAMERA", "KnownMap", "SeenThing", "TextObservation", "TextSensor", "noisy_sightings"]


@dataclass(frozen=True, slots=True)
class SeenThing:
    """An object in view.

    label : canonical label
    room : canonical label of its room; None if unknown
    bearing : degrees from straight ahead, positive to the right, of the middle of its visible part
    distance : horizontal metres to its nearest visible point
    """

    label: str
    room: str | None
    bearing: float
    distance: float

    def __str__(self) -> str:
        way = "right" if self.bearing > 0 else "left"
        side = "straight ahead" if abs(self.bearing) < 1 else f"{abs(self.bearing):.0f}° to the {way}"
        place = "" if self.room is None else f" in the {self.room}"
        return f"{self.label}{place}, {self.distance:.1f} m, {side}"


def noisy_sightings(
    things: Sequence[SeenThing],
    noise: NoiseConfig,
    labels: Sequence[str],
    camera: CameraConfig,
    seed: int,
    names: Sequence[object] = (),
) -> list[SeenThing]:
    """Return simulated detections of the objects in view: some are missed, some mislabelled, some are false positives.

    Each object has its own random draws, so that a higher error rate keeps all errors of a lower one.

    Parameters
    ----------
    labels : the scene's labels, sorted; wrong labels are drawn from them
    seed, names : determine the draws, e.g. the episode and the step
    """
    draws = generator(seed, "sightings", *names)
    kept = []
    for thing in things:
        missed, confused, other = draws.uniform(size=3)
        rest = [label for label in labels if label != thing.label]
        if missed < noise.missed:
            continue
        if confused < noise.confused and rest:
            thing = replace(thing, label=rest[int(other * len(rest))])
        kept.append(thing)
    there, which, side, far = generator(seed, "ghosts", *names).uniform(size=4)
    if there < noise.false and labels:
        reach = 10.0 if camera.max_depth is None else camera.max_depth
        bearing = (side - 0.5) * camera.hfov - camera.turn
        room = things[int(which * len(things))].room if things else None
        kept.append(
            SeenThing(labels[int(which * len(labels))], room, round(bearing, 1), round(0.5 + far * reach / 2, 2))
        )
    return kept


TEXT_CAMERA: Final = CameraConfig(width=128, height=128, normalized=False)
"""The default camera: that of VLN-CE at half the resolution."""
LEAST_PIXELS: Final = 6
"""Least number of pixels of an object that are seen before it is named."""
SAME_PLACE: Final = 1.0
"""Largest distance in metres between two sightings of one label that the memory merges into one object."""


@dataclass(frozen=True, slots=True)
class TextObservation:
    """The room of the agent (None if unknown) and the objects in view, nearest first.

    notes : known deviations from a real view
    """

    room: str | None
    things: tuple[SeenThing, ...]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = [] if self.room is None else [f"You are in the {self.room}."]
        lines.append("You see:" if self.things else "You see nothing that has a name.")
        return "\n".join([*lines, *(f"- {thing}" for thing in self.things)])


class TextSensor:
    """Names what a camera sees. An object without visible pixels is never named, and no ground truth of an episode is
    used.

    Parameters
    ----------
    camera : the camera to use; objects beyond its ``max_depth`` are not named
    noise : simulated detector errors; None for none
    """

    def __init__(
        self,
        scene: Scene,
        renderer: Renderer,
        camera: CameraConfig = TEXT_CAMERA,
        noise: NoiseConfig | None = None,
    ) -> None:
        self._scene, self._renderer, self._camera, self._noise = scene, renderer, camera, noise
        self._rooms = [room.label for room in scene.rooms]
        number = {room.room_id: k for k, room in enumerate(scene.rooms)}
        self._room_of = [number.get(item.room_id) for item in scene.objects]
        known = vocabulary.labels
        named = (o.label in known and not vocabulary.is_structure(o.label) for o in scene.objects)
        self._named = np.array([False, *named])
        self._labels = sorted({o.label for o, named in zip(scene.objects, self._named[1:], strict=True) if named})
        columns, _ = pixel_rays(camera)
        self._columns = np.broadcast_to(columns, (camera.height, camera.width)).reshape(-1)
        self._tilt = math.cos(math.radians(camera.look_down)), math.sin(math.radians(camera.look_down))
        self._rows = np.repeat(pixel_rays(camera)[1], camera.width)

    def observe(
        self, position: npt.ArrayLike, heading: float, *, seed: int = 0, names: Sequence[object] = ()
    ) -> TextObservation:
        """Return what an agent sees from a pose: `position` (3,) of the agent's feet in metres, and `heading` in
        radians counter-clockwise from −Z.

        Parameters
        ----------
        seed, names : determine the noise, e.g. the episode and the step
        """
        place = np.asarray(position, np.float64)
        things = self._seen(place, heading)
        if self._noise is not None:
            things = noisy_sightings(things, self._noise, self._labels, self._camera, seed, names)
        here = _room_at(self._scene.rooms, place)
        ordered = sorted(things, key=lambda thing: (thing.distance, thing.bearing, thing.label))
        return TextObservation(None if here is None else here.label, tuple(ordered), self._renderer.notes)

    def _seen(self, position: F64, heading: float) -> list[SeenThing]:
        frame = self._renderer.look(self._camera, position, heading, rgb=False)
        instance, depth = frame.instance.reshape(-1), frame.depth.reshape(-1)
        limit = self._camera.max_depth
        rows = np.flatnonzero(self._named[instance] if limit is None else self._named[instance] & (depth <= limit))
        own, far = instance[rows], depth[rows].astype(np.float64)
        count = np.bincount(own, minlength=len(self._named))
        # Right and ahead of the agent; the camera may be pitched and turned.
        right = self._columns[rows] * far
        ahead = far * self._tilt[0] + self._rows[rows] * far * self._tilt[1]
        ground = np.hypot(right, ahead)
        nearest = np.full(len(count), np.inf)
        np.minimum.at(nearest, own, ground)
        middle_right = np.bincount(own, right, len(count))
        middle_ahead = np.bincount(own, ahead, len(count))
        found = []
        for number in np.flatnonzero(count >= LEAST_PIXELS).tolist():
            bearing = math.degrees(math.atan2(middle_right[number], middle_ahead[number])) - self._camera.turn
            item = self._scene.objects[number - 1]
            room = self._room_of[number - 1]
            found.append(
                SeenThing(
                    item.label,
                    None if room is None else self._rooms[room],
                    round((bearing + 180) % 360 - 180, 1),
                    round(float(nearest[number]), 2),
                )
            )
        return found


@dataclass(slots=True)
class KnownMap:
    """What an agent knows of the map so far: the rooms that it has been in, and where it saw objects, by label.

    Positions are (x, z) metres in the frame of the agent's own pose estimates. Two sightings of one label within a
    metre count as one object.
    """

    rooms: list[str] = field(default_factory=list)
    things: list[tuple[str, str | None, float, float]] = field(default_factory=list)

    def add(self, seen: TextObservation, position: npt.ArrayLike, heading: float) -> None:
        """Add what was seen from a position (3,) in metres, with a heading in radians counter-clockwise from −Z."""
        if seen.room is not None and seen.room not in self.rooms:
            self.rooms.append(seen.room)
        x, _, z = (float(v) for v in np.asarray(position, np.float64))
        for thing in seen.things:
            angle = heading - math.radians(thing.bearing)
            there = x - math.sin(angle) * thing.distance, z - math.cos(angle) * thing.distance
            if not any(_is_same(thing, known, there) for known in self.things):
                self.things.append((thing.label, thing.room, round(there[0], 2), round(there[1], 2)))

    def __str__(self) -> str:
        lines = ["Rooms so far: " + (", ".join(self.rooms) or "none") + "."]
        for room in dict.fromkeys(room for _, room, _, _ in self.things):
            names = sorted(label for label, place, _, _ in self.things if place == room)
            lines.append(f"Seen in the {room}: {', '.join(names)}." if room else f"Seen elsewhere: {', '.join(names)}.")
        return "\n".join(lines)


def _room_at(rooms: Sequence[Room], position: F64) -> Room | None:
    """Return the room whose floor is under a position; of several, the one with the nearest floor height, then the
    least id.
    """
    held = []
    for room in rooms:
        if room.polygon is None:
            inside = len(rooms) == 1
        else:
            x, z = (room.polygon - position[[0, 2]]).T
            next_x, next_z = np.roll(x, -1), np.roll(z, -1)
            crosses = (z > 0) != (next_z > 0)
            # An edge crosses to the east if it passes the point on that side.
            east = (x * (next_z - z) - z * (next_x - x)) * np.sign(next_z - z) > 0
            inside = bool(np.count_nonzero(crosses & east) % 2)
        if inside:
            held.append((round(abs(float(position[1]) - room.floor_y), 1), room.room_id, room))
    return min(held, key=lambda found: found[:2])[2] if held else None


def _is_same(thing: SeenThing, known: tuple[str, str | None, float, float], there: tuple[float, float]) -> bool:
    label, room, x, z = known
    return (label, room) == (thing.label, thing.room) and math.hypot(x - there[0], z - there[1]) <= SAME_PLACE
