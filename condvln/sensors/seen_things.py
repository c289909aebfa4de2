"""Objects in view, and simulated detector errors on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from condvln.seeding import generator
from schemas.config import CameraConfig, NoiseConfig

__all__ = ["SeenThing", "noisy_sightings"]


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


def _side(bearing: float) -> str:
    return "right" if bearing > 0 else "left"
