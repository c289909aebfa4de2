"""iTHOR: 120 hand-made rooms, whose type follows from the number of the floor plan."""

from __future__ import annotations

import re
from typing import ClassVar, Final, Literal

from condvln.formats.json_document import JsonNode
from condvln.sources.source import UNKNOWN_LABEL
from condvln.sources.thor_metadata import scene_name
from condvln.sources.thor_scene import ThorSceneSource

__all__ = ["IthorSource", "room_type"]

_PLAN: Final = re.compile(r"^FloorPlan([1-9][0-9]{0,2})$")
ROOM_TYPES: Final = (
    (range(1, 31), "Kitchen"),
    (range(201, 231), "LivingRoom"),
    (range(301, 331), "Bedroom"),
    (range(401, 431), "Bathroom"),
)


def room_type(name: str) -> str:
    """Return the room type of the floor plan with this name (``FloorPlan207``); `UNKNOWN_LABEL` if it is none of the
    120 plans.
    """
    named = _PLAN.match(name)
    number = int(named[1]) if named is not None else -1
    return next((label for numbers, label in ROOM_TYPES if number in numbers), UNKNOWN_LABEL)


class IthorSource(ThorSceneSource):
    """Floor plans of iTHOR."""

    family: ClassVar[str] = "ithor"
    annotation: ClassVar[Literal["dataset", "scene"]] = "dataset"

    def room_label(self, document: JsonNode) -> str:
        """See `ThorSceneSource.room_label`."""
        return room_type(scene_name(document))
