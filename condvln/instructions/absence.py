"""From how far an agent sees that nothing with some label is there, and of which labels it can see that at all.

That there is no lamp in a room is known when the room's floor has been seen, each part from so near that a usual lamp
would be recognised there (:class:`condvln.navigation.sight.Recognition`). So nothing is asked about the presence of
labels whose things are so small that even the floor at the agent's feet is too far away: that there is none could not
be known, and what is true could be told from what is asked.
"""

from __future__ import annotations

import math

from condvln.labels.lists import LEAST_WORTH, usual_size, worth
from schemas.config import PlacesConfig
from schemas.config.constants import ABSENCE_METRES, FLOOR_LIFT, LEVEL_CAMERA, TABLE_HEIGHT

__all__ = ["absence_range", "can_be_missed", "presence_asked"]


def absence_range(label: str, places: PlacesConfig) -> float:
    """Return the greatest distance in metres of ABSENCE_METRES at which a usual object with a label is recognised; 0 if
    there is none.

    A side s at distance r, facing the eye, appears under the angle 2 atan(s / 2r). If it lies on a plane h below the
    eye and points away from the eye, its ends are seen atan(h / (d - s/2)) and atan(h / (d + s/2)) below the horizon, d
    metres away along the ground. The tangent of the difference is h s / (h² + d² - s²/4), and r² = h² + d².
    """
    size, least = usual_size(label), places.seen_degrees
    short, long = math.radians(least.short), math.radians(least.long)
    far = min(places.sight_range, size.short / 2 / math.tan(short / 2), size.long / 2 / math.tan(long / 2))
    if size.flat:
        height = places.eye_height - (FLOOR_LIFT if size.flat == "floor" else TABLE_HEIGHT)
        # Nothing is seen of it from below, and no eye is nearer than straight above it.
        lying = math.sqrt(height * size.short / math.tan(short) + size.short**2 / 4) if height > 0.0 else 0.0
        far = min(far, lying) if lying >= height else 0.0
    return max((metres for metres in ABSENCE_METRES if metres <= far), default=0.0)


def can_be_missed(label: str, places: PlacesConfig) -> bool:
    """Return whether an agent can see that nothing with a label is in a room: the ring of floor that a level camera
    shows within the label's range as it turns round is at least as large as the disc at the agent's feet, below the
    camera's view, that it does not show.
    """
    height = places.eye_height - FLOOR_LIFT
    nearest = height / math.tan(math.radians(LEVEL_CAMERA[1] / 2))
    return absence_range(label, places) >= math.hypot(height, math.sqrt(2.0) * nearest)


def presence_asked(room_type: str, label: str, places: PlacesConfig) -> bool:
    """Return whether people would ask if there is a thing with a label in a type of room, and an agent can see that
    there is none.
    """
    return worth(label, room_type).presence >= LEAST_WORTH and can_be_missed(label, places)
