"""RoboTHOR: apartments with movable walls and without annotated rooms."""

from __future__ import annotations

from typing import ClassVar, Final, Literal

from condvln.formats.json_document import JsonNode
from condvln.sources.thor_scene import ThorSceneSource

__all__ = ["RobothorSource"]

WHOLE_SCENE: Final = "apartment"


class RobothorSource(ThorSceneSource):
    """Apartments of RoboTHOR; each is one zone."""

    family: ClassVar[str] = "robothor"
    annotation: ClassVar[Literal["dataset", "scene"]] = "scene"

    def room_label(self, document: JsonNode) -> str:
        """See `ThorSceneSource.room_label`."""
        return WHOLE_SCENE
