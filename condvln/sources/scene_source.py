"""What the readers of all families share: choosing scenes, noting inputs, faults that stay with their scene."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from condvln.scene import Scene
from condvln.scene.geometry import SceneGeometry
from condvln.sources.dataset_root import DatasetRoot
from condvln.sources.input_ledger import InputLedger
from condvln.sources.scene_choice import SceneChoice
from condvln.sources.source import HashFile, SceneCounts, SceneHandle, SceneInput
from schemas.config import AgentConfig
from schemas.errors import ConfigError, InputError, MissingFileError

__all__ = ["Note", "SceneSource", "SourceOptions"]

Note = Callable[[InputLedger], object]
"""Notes all inputs of one scene; raises InputError where that already fails."""

MESHES: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")
NAVMESHES: Final = (".navmesh",)


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """How a dataset is to be read; see `open_source`."""

    choice: SceneChoice
    agent: AgentConfig
    navmesh: str | None
    regions: Path | None
    hash_file: HashFile


class SceneSource(ABC):
    """A dataset on disk, of one family."""

    family: ClassVar[str]
    bytes_per_object: ClassVar[float] = 1000.0
    """Bytes of annotation for one object, about, where the listing counts no objects. Measured on real scenes."""
    objects_per_room: ClassVar[float] = math.inf
    """Objects of one room, about, where the listing counts no rooms; infinite where scenes are one room."""

    def __init__(self, root: Path, options: SourceOptions) -> None:
        self.root = root
        self.options = options
        self.files = DatasetRoot(root)
        if options.regions is not None and not options.regions.exists():
            raise ConfigError(
                "the side file of room zones is not there", where=options.regions, remedy="Mend the source's 'regions'"
            )

    @abstractmethod
    def listing(self) -> Iterator[tuple[str, Note]]:
        """Every scene of the dataset by id, with a function that notes its inputs; called before the next is asked."""

    @abstractmethod
    def read(self, scene_id: str) -> Scene:
        """One scene; see `Source.read`."""

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Surfaces of a scene; see `Source.geometry`. A family whose files hold none keeps this answer."""
        return None

    def handles(self) -> list[SceneHandle]:
        """The scenes asked for; see `Source.handles`."""
        choice = self.options.choice
        known: list[str] = []
        found: list[SceneHandle] = []
        for scene_id, note in self.listing():
            known.append(scene_id)
            if choice.wanted(scene_id):
                found.append(self._handle(scene_id, note))
        missing = choice.missing(known)
        if not found and not missing:
            raise ConfigError(
                f"none of the {len(known)} scenes fits {', '.join(choice.scenes) or 'an empty list of patterns'}",
                where=self.root,
                remedy="Mend the source's 'scenes' and 'exclude', or put the dataset's scenes there",
            )
        found += [SceneHandle(self.family, s, (), SceneCounts(), self.not_there(s)) for s in missing]
        return sorted(found, key=lambda h: h.scene_id)

    def not_there(self, scene_id: str) -> MissingFileError:
        """The error of a scene that the dataset does not have."""
        return MissingFileError(
            f"the dataset has no scene {scene_id!r}",
            where=self.root,
            remedy="Mend the source's 'scenes', or download the scene",
        )

    def _handle(self, scene_id: str, note: Note) -> SceneHandle:
        ledger = InputLedger()
        fault: InputError | None = None
        try:
            note(ledger)
        except InputError as error:
            fault = error
        try:
            inputs = ledger.inputs(self.files, self.options.hash_file)
        except InputError as error:
            inputs, fault = (), fault or error
        return SceneHandle(self.family, scene_id, inputs, self._counts(ledger, inputs), fault)

    def _counts(self, ledger: InputLedger, inputs: Sequence[SceneInput]) -> SceneCounts:
        navmesh = max((i.size for i in inputs if i.path.endswith(NAVMESHES)), default=0)
        meshes = sum(i.size for i in inputs if i.path.endswith(MESHES))
        annotation = sum(i.size for i in inputs if not i.path.endswith(NAVMESHES + MESHES))
        objects = float(ledger.objects) if ledger.objects is not None else annotation / self.bytes_per_object
        rooms = float(ledger.rooms) if ledger.rooms is not None else objects / self.objects_per_room
        return SceneCounts(round(objects, 1), round(max(rooms, 1.0), 1), navmesh, meshes)
