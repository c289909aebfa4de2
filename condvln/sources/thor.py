"""iTHOR and RoboTHOR: AI2-THOR scenes of one room each, from files of controller metadata.

iTHOR has 120 hand-made rooms, whose type follows from the number of the floor plan. RoboTHOR has apartments with
movable walls and without annotated rooms.
"""

from __future__ import annotations

import posixpath
import re
from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Final, Literal

from condvln.formats.json_document import JsonNode, parse_json
from condvln.scene import Scene, SceneWarning
from condvln.scene.scene import SceneGeometry
from condvln.sources.regions import in_rooms, made_room
from condvln.sources.scene_source import FileSource, SourceOptions
from condvln.sources.source import UNKNOWN_LABEL, InputLedger
from condvln.sources.thor_metadata import MAX_METADATA_BYTES, floor_outline, read_objects, scene_name, thor_geometry
from schemas.errors import InputError

__all__ = [
    "IthorSource",
    "RobothorSource",
    "ThorSceneSource",
    "room_type",
]

WHOLE_SCENE: Final = "room"
_KEYS: Final = (b'"sceneName"', b'"axisAlignedBoundingBox"')
"""Keys that distinguish controller metadata from other JSON in the same folder."""
_NAME: Final = re.compile(r"FloorPlan(\d+|_[A-Za-z]+\d+_\d+)(_physics)?\.json")
"""Names of AI2-THOR's own scenes: such a file always counts as a scene, so that a truncated or empty one is
reported.
"""


class ThorSceneSource(FileSource):
    """Files ``<scene>.json`` of a folder and its direct subfolders, each with the controller metadata of one scene.

    The floor is at height 0 (the simulator's agent stands there). Rooms come from a side file if given; otherwise the
    scene is one room.
    """

    bytes_per_object: ClassVar[float] = 2000.0
    annotation: ClassVar[Literal["dataset", "scene"]]
    """Whether the dataset treats the scene as a room, or only as a whole scene."""

    nothing: ClassVar[tuple[str, str]] = (
        "controller metadata (<scene>.json)",
        "Save controller.last_event.metadata of each scene there, or correct the source's 'root'",
    )

    def __init__(self, root: Path, options: SourceOptions) -> None:
        self._known: dict[str, tuple[tuple[int, int], bool]] = {}
        super().__init__(root, options)

    @abstractmethod
    def room_label(self, document: JsonNode) -> str:
        """Return the raw label of the scene's one room, from the scene's name."""

    def scene(self, scene_id: str) -> Scene:
        """Return one scene; see `Source.read`."""
        ledger = InputLedger()
        document = self._document(scene_id)
        label = self.room_label(document)
        items = read_objects(document, self.family)
        rooms = self.drawn_rooms([posixpath.basename(scene_id)], ledger)
        tops = [float(o.aabb[1, 1]) for o in items if o.aabb is not None]
        heights, outline = (0.0, max(tops, default=0.0)), floor_outline(document)
        whole = made_room(self.family, WHOLE_SCENE, label, heights, outline, annotation=self.annotation)
        placed, lost = in_rooms(items, rooms) if rooms else ([replace(o, room_id=WHOLE_SCENE) for o in items], [])
        lost += [
            SceneWarning("no_box", o.object_id, "its size is negative: extent unknown") for o in items if o.aabb is None
        ]
        navmeshes = self.shipped_navmeshes(posixpath.basename(scene_id), ledger)
        return self.made(scene_id, rooms or (whole,), placed, lost, navmeshes)

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Return floor, walls and objects as boxes; see `Source.geometry`. None if the metadata has no floor."""
        document = self._document(scene.scene_id)
        number = {item.object_id: n for n, item in enumerate(scene.objects)}
        return thor_geometry(document, read_objects(document, self.family), number, self.annotation == "dataset")

    def _document(self, scene_id: str) -> JsonNode:
        path = self.path_of(scene_id, self.scans())
        return parse_json(self.files.read(path, MAX_METADATA_BYTES), str(self.root / path)).object()

    def scans(self) -> dict[str, str]:
        """Return the path of each scene's metadata by scene id, sorted; the subfolder is part of the id."""
        found: dict[str, str] = {}
        for path in self.matching("*.json", "*/*.json"):
            if _NAME.fullmatch(posixpath.basename(path)) or self._is_metadata(path):
                found[path.removesuffix(".json")] = path
            else:
                self.pass_over(path, "JSON that is not a controller's metadata")
        return dict(sorted(found.items()))

    def _is_metadata(self, path: str) -> bool:
        """Return whether a file holds controller metadata; cached until the file changes.

        A file that can't be read counts as a scene, so that the error is reported for it.
        """
        try:
            signature = self.files.signature(path)
            if self._known.get(path, ((-1, -1), False))[0] != signature:
                data = self.files.read(path, MAX_METADATA_BYTES)
                self._known[path] = signature, all(key in data for key in _KEYS)
        except InputError:
            return True
        return self._known[path][1]


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


class RobothorSource(ThorSceneSource):
    """Apartments of RoboTHOR; each is one zone."""

    family: ClassVar[str] = "robothor"
    annotation: ClassVar[Literal["dataset", "scene"]] = "scene"

    def room_label(self, document: JsonNode) -> str:
        """See `ThorSceneSource.room_label`."""
        return "apartment"
