"""What the readers of all families share: choosing scenes, noting inputs, faults that stay with their scene."""

from __future__ import annotations

import math
import posixpath
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Final, Literal

from condvln.formats.dataset_root import DatasetRoot
from condvln.scene import Scene
from condvln.scene.containment import with_containment
from condvln.scene.geometry import SceneGeometry
from condvln.scene.limits import check_limits
from condvln.sources.file_listing import FileListing, list_files
from condvln.sources.input_ledger import InputLedger
from condvln.sources.scene_choice import SceneChoice
from condvln.sources.source import HashFile, SceneCounts, SceneHandle, SceneInput
from schemas.config import LimitsConfig
from schemas.errors import ConfigError, InputError, MissingFileError

__all__ = ["Absence", "Note", "SceneSource", "SourceOptions"]

Absence = Literal["complete", "never"]
"""Where instructions may say that something is not there: see `schemas.config.SourceConfig`."""

Note = Callable[[InputLedger], object]
"""Notes all inputs of one scene; raises InputError where that already fails."""

MESHES: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")
NAVMESHES: Final = (".navmesh",)


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """How a dataset is to be read; see `open_source`."""

    choice: SceneChoice
    navmesh: str | None
    regions: Path | None
    hash_file: HashFile
    limits: LimitsConfig
    absence: Absence = "complete"
    connectivity: Path | None = None


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
        self._passed_over: dict[str, str] = {}
        self._lost: dict[str, InputError] = {}
        if options.regions is not None and not options.regions.exists():
            raise ConfigError(
                "the side file of room zones is not there",
                where=options.regions,
                remedy="Correct the source's 'regions'",
            )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.root)!r})"

    def scene_ids(self) -> list[str]:
        """Ids of the scenes that can be listed, sorted."""
        return [handle.scene_id for handle in self.handles() if handle.fault is None]

    @abstractmethod
    def listing(self) -> Iterator[tuple[str, Note]]:
        """Every scene of the dataset by id, with a function that notes its inputs; called before the next is asked."""

    @abstractmethod
    def scene(self, scene_id: str) -> Scene:
        """One scene as its files have it: before its limits are looked at, and what follows from its boxes."""

    def read(self, scene_id: str) -> Scene:
        """One scene; see `Source.read`. With ``absence: never`` every room is asked, and none is complete."""
        scene = self.scene(scene_id)
        # What follows costs more than the objects' number: a scene that is too large ends here.
        check_limits(scene, self.options.limits)
        scene = replace(scene, objects=with_containment(scene.objects, self.family))
        if self.options.absence == "complete":
            return scene
        return replace(scene, rooms=tuple(replace(room, complete=False, asked=True) for room in scene.rooms))

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Surfaces of a scene; see `Source.geometry`. A family whose files hold none keeps this answer."""
        return None

    def connectivity(self, scene_id: str) -> Path | None:
        """The file of the viewpoint graph that a scene is walked on for want of a mesh; None where there is none."""
        return None

    def handles(self) -> list[SceneHandle]:
        """The scenes asked for; see `Source.handles`."""
        choice = self.options.choice
        self._passed_over = {}
        known: list[str] = []
        found: list[SceneHandle] = []
        for scene_id, note in self.listing():
            known.append(scene_id)
            if choice.wanted(scene_id):
                found.append(self._handle(scene_id, note))
        missing = choice.missing(known)
        lost = {place: fault for place, fault in self._lost.items() if not choice.excluded(place)}
        if choice.only_names() and not missing:
            lost = {}  # every scene asked for is there
        if not found and not missing and not lost:
            others = next((f"; {path} was passed over: {why}" for path, why in self.passed_over()), "")
            patterns = ", ".join(choice.scenes) or "an empty list of patterns"
            raise ConfigError(
                f"none of the {len(known)} scenes fits {patterns}{others}",
                where=self.root,
                remedy="Correct the source's 'scenes' and 'exclude', or put the scenes there",
            )
        self._passed_over |= {place: str(fault.what) for place, fault in self._lost.items() if place not in lost}
        self._passed_over |= {
            f"exclude: {p}": "no scene fits it" for p in choice.idle_exclusions([*known, *self._lost])
        }
        faults = {s: self.not_there(s) for s in missing} | {p: self._fits_none(p) for p in choice.idle(known)} | lost
        found += [SceneHandle(self.family, name, (), SceneCounts(), fault) for name, fault in faults.items()]
        return sorted(found, key=lambda h: h.scene_id)

    def passed_over(self) -> list[tuple[str, str]]:
        """What the last listing left out; see `Source.passed_over`."""
        return sorted(self._passed_over.items())

    def matching(self, *patterns: str) -> list[str]:
        """Files of the dataset that fit one of some patterns, each real file once; see `list_files`."""
        return self.noted(list_files(self.files, patterns))

    def noted(self, listing: FileListing) -> list[str]:
        """The paths of a listing, whose findings are kept for `handles`."""
        self._lost = listing.faults
        self._passed_over |= listing.passed_over
        return listing.paths

    def pass_over(self, path: str, why: str) -> None:
        """Note a file that holds no scene."""
        self._passed_over[path] = why

    def shipped_navmeshes(
        self, scene_name: str, ledger: InputLedger, configured: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Files that may hold a scene's navmesh, the preferred ones first; those that exist are noted as inputs.

        In the folder that was asked for, where the dataset's configuration says, in every ``navmesh*`` folder of the
        root; under the names that the configuration uses, then under the scene's own.

        Raises
        ------
        PathEscapeError : the folder asked for is outside of the root
        """
        asked = self.options.navmesh
        folders = [] if asked is None else [self.files.join("", asked)]
        beside = ["navmeshes", *sorted(p.name for p in self.root.glob("navmesh*") if p.is_dir())]
        candidates: list[str] = []
        for name in dict.fromkeys([*map(posixpath.basename, configured), f"{scene_name}.navmesh"]):
            own = [path for path in configured if posixpath.basename(path) == name]
            candidates += [*(f"{f}/{name}" for f in folders), *own, *(f"{f}/{name}" for f in beside)]
        for path in candidates:
            if self.files.has(path):
                ledger.file(path)
        return tuple(candidates)

    def _fits_none(self, pattern: str) -> MissingFileError:
        return MissingFileError(
            f"no scene of the dataset fits the pattern {pattern!r}",
            where=self.root,
            remedy="Correct the source's 'scenes', or download the scenes",
        )

    def not_there(self, scene_id: str) -> MissingFileError:
        """The error of a scene that the dataset does not have."""
        return MissingFileError(
            f"the dataset has no scene {scene_id!r}",
            where=self.root,
            remedy="Correct the source's 'scenes', or download the scene",
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
