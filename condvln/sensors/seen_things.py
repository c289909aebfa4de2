"""Things that are seen, and what a detector makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from condvln.seeding import generator
from schemas.config import CameraConfig, NoiseConfig

__all__ = ["SeenThing", "noisy_sightings"]


@dataclass(frozen=True, slots=True)
class SeenThing:
    """A thing in view.

    label : canonical
    room : canonical label of the room that it is in, None where that is not known
    bearing : degrees from straight ahead, positive to the right, of the middle of what is seen of it
    distance : metres along the ground to the nearest point that is seen of it
    """

    label: str
    room: str | None
    bearing: float
    distance: float

    def __str__(self) -> str:
        side = "straight ahead" if abs(self.bearing) < 1 else f"{abs(self.bearing):.0f}° to the {_side(self.bearing)}"
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
    """Detections of the objects in view: some are missed, some have a wrong label, some are false.

    Each thing is missed or confused by draws of its own, so that with a greater share of errors the same errors occur,
    and more.

    Parameters
    ----------
    labels : those of the scene, sorted; a wrong label is one of them
    seed, names : of the draws, such as the episode and the step
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


def _side(bearing: float) -> str:
    return "right" if bearing > 0 else "left"
