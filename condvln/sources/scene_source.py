"""Shared base of all readers: it chooses scenes, records inputs, and keeps a fault in one scene from stopping the
others.
"""

from __future__ import annotations

import math
import posixpath
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import ClassVar, Final, Literal

from condvln.formats.dataset_root import DatasetRoot, FileListing, list_files
from condvln.scene import MeshPart, Room, Scene, SceneObject, SceneWarning
from condvln.scene.boxes import placement
from condvln.scene.containment import with_containment
from condvln.scene.rotations import Z_UP_TO_HABITAT
from condvln.scene.scene import SceneGeometry, check_limits
from condvln.sources.regions import side_regions
from condvln.sources.solids import scan_geometry
from condvln.sources.source import HashFile, InputLedger, SceneCounts, SceneHandle, SceneInput
from schemas.config import LimitsConfig
from schemas.errors import ConfigError, InputError, MissingFileError, PointerError

__all__ = [
    "Absence",
    "FileSource",
    "Note",
    "ScanSource",
    "SceneChoice",
    "Source",
    "SourceOptions",
]


@dataclass(frozen=True, slots=True)
class SceneChoice:
    """Scene ids or patterns with ``*`` and ``?`` to include, and to exclude."""

    scenes: Sequence[str] = ("*",)
    exclude: Sequence[str] = ()

    def wanted(self, scene_id: str) -> bool:
        """Return whether a scene is included."""
        return _fits(scene_id, self.scenes) and not self.excluded(scene_id)

    def excluded(self, scene_id: str) -> bool:
        """Return whether an exclusion matches `scene_id`, which is a scene's id or a path at which no scene could be
        listed.
        """
        return _fits(scene_id, self.exclude)

    def only_names(self) -> bool:
        """Return whether all scenes are selected by id and none by a pattern."""
        return not any(_is_pattern(scene) for scene in self.scenes)

    def idle(self, known: Sequence[str]) -> list[str]:
        """Return the inclusion patterns that match no scene in `known`. A pattern that matches only excluded scenes is
        not returned.
        """
        return sorted({p for p in self.scenes if _is_pattern(p) and not any(fnmatchcase(s, p) for s in known)})

    def idle_exclusions(self, known: Sequence[str]) -> list[str]:
        """Return the exclusions, ids or patterns, that match no scene in `known`."""
        return sorted({p for p in self.exclude if not any(fnmatchcase(s, p) for s in known)})

    def missing(self, known: Iterable[str]) -> list[str]:
        """Return the selected ids that the dataset does not have, sorted."""
        there = set(known)
        named = {s for s in self.scenes if not _is_pattern(s)}
        return sorted(s for s in named - there if not _fits(s, self.exclude))


def _is_pattern(scene: str) -> bool:
    return any(character in scene for character in "*?[")


def _fits(scene_id: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(scene_id, p) for p in patterns)


Absence = Literal["complete", "never"]
"""Where absence may be claimed: see `schemas.config.SourceConfig`."""

Note = Callable[[InputLedger], object]
"""Records all inputs of one scene; raises InputError if this fails."""

MESHES: Final = (".glb", ".gltf", ".obj", ".ply", ".stl")
NAVMESHES: Final = (".navmesh",)


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Options for reading a dataset; see `open_source`."""

    choice: SceneChoice
    navmesh: str | None
    regions: Path | None
    hash_file: HashFile
    limits: LimitsConfig
    absence: Absence = "complete"
    connectivity: Path | None = None


class Source(ABC):
    """A dataset of one family on disk."""

    family: ClassVar[str]
    """Name of the family, which is also the ``source=`` partition of its tables. Paths in its scenes are relative to
    `root`.
    """
    bytes_per_object: ClassVar[float] = 1000.0
    """Approximate bytes of annotation per object, used if the listing counts no objects. Measured on real scenes."""
    objects_per_room: ClassVar[float] = math.inf
    """Approximate number of objects per room, used if the listing counts no rooms; infinite if scenes are one room."""

    def __init__(self, root: Path, options: SourceOptions) -> None:
        self.root = root
        self.options = options
        self.files = DatasetRoot(root)
        self._passed_over: dict[str, str] = {}
        self._lost: dict[str, InputError] = {}
        if options.regions is not None and not options.regions.exists():
            raise ConfigError(
                "the file or folder of room zones does not exist",
                where=options.regions,
                remedy="Correct the source's 'regions'",
            )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.root)!r})"

    def scene_ids(self) -> list[str]:
        """Return the ids of the scenes that can be listed, sorted."""
        return [handle.scene_id for handle in self.handles() if handle.fault is None]

    @abstractmethod
    def listing(self) -> Iterator[tuple[str, Note]]:
        """Yield each scene's id with a function that records the scene's inputs; call this function before requesting
        the next id.
        """

    @abstractmethod
    def scene(self, scene_id: str) -> Scene:
        """Return one scene as in its files, before limits are checked and containment is derived from boxes."""

    def read(self, scene_id: str) -> Scene:
        """Return one scene in Habitat's frame. A valid scene without objects is returned, too. With ``absence: never``,
        conditions may be about every room, and no room counts as completely annotated.

        Raises
        ------
        InputError : the scene can't be read; the message says which file, where in it, and what to do
        LimitError : the scene exceeds the limits with which the source was opened
        """
        scene = self.scene(scene_id)
        # The following steps cost more than linear time, so the limits are checked first.
        check_limits(scene, self.options.limits)
        scene = replace(scene, objects=with_containment(scene.objects, self.family))
        if self.options.absence == "complete":
            return scene
        return replace(scene, rooms=tuple(replace(room, complete=False, asked=True) for room in scene.rooms))

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Return the surfaces of a scene from `read`; None if the dataset on disk has neither meshes nor walls, as by
        default.

        Raises
        ------
        InputError : as for `read`
        """
        return None

    def connectivity(self, scene_id: str) -> Path | None:
        """Return the file of a scene's viewpoint graph; None if there is no such file, or the scene has a mesh."""
        return None

    def handles(self) -> list[SceneHandle]:
        """Return the selected scenes, sorted by id. No geometry is read. The handle of a scene that can't be listed has
        the reason as its fault.
        """
        return sorted(self.each_handle(), key=lambda h: h.scene_id)

    def each_handle(self) -> Iterator[SceneHandle]:
        """Yield what `handles` returns, one by one and in any order: a list of a million takes gigabytes. That no scene
        can be listed is found, and `passed_over` is known, only at the end.

        Raises
        ------
        ConfigError : no scene is selected; all have the same fault in the same file, such as a missing lexicon; or
            files of all are pointers to files that were not downloaded
        """
        choice = self.options.choice
        self._passed_over = {}
        known: list[str] = []
        found = 0
        alike: list[SceneHandle] = []  # all so far, while all have one fault in common
        pointers: list[SceneHandle] = []
        for scene_id, note in self.listing():
            known.append(scene_id)
            if not choice.wanted(scene_id):
                continue
            found += 1
            handle = self._handle(scene_id, note)
            if isinstance(handle.fault, PointerError):
                pointers.append(handle)
                continue
            same = handle.fault is not None and str(handle.fault) == str((alike or [handle])[0].fault)
            if same and len(alike) == found - len(pointers) - 1:
                alike.append(handle)
                continue
            yield from alike
            alike = []
            yield handle
        if len(alike) > 1 and (cause := alike[0].fault):
            what = f"none of the {found} scenes can be read: {cause.what}"
            raise ConfigError(what, where=cause.where, place=cause.place, remedy=cause.remedy)
        yield from alike
        yield from self._pointing(pointers, found)
        missing = choice.missing(known)
        lost = {place: fault for place, fault in self._lost.items() if not choice.excluded(place)}
        if choice.only_names() and not missing:
            lost = {}  # every selected scene exists
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
        for name, fault in faults.items():
            yield SceneHandle(self.family, name, (), SceneCounts(), fault)

    def _pointing(self, handles: Sequence[SceneHandle], found: int) -> Iterator[SceneHandle]:
        """Yield the scenes with files that are pointers, all with one fault, so that it is said once.

        Raises
        ------
        ConfigError : none of the `found` scenes has other files
        """
        if not handles or (cause := handles[0].fault) is None:
            return
        what = f"files of {len(handles)} of {found} scenes were not downloaded, such as {cause.where}: {cause.what}"
        if len(handles) == found > 1:
            raise ConfigError(what, where=self.root, remedy=cause.remedy)
        fault = cause if len(handles) == 1 else PointerError(what, where=self.root, remedy=cause.remedy)
        yield from (replace(handle, fault=fault) for handle in handles)

    def passed_over(self) -> list[tuple[str, str]]:
        """Return (path, reason) of everything that the last listing (`handles`, `each_handle`) skipped, sorted. No
        scene that should have been listed is among the skipped files.
        """
        return sorted(self._passed_over.items())

    def matching(self, *patterns: str) -> list[str]:
        """Return those files of the dataset that match any of `patterns`, each real file once; see `list_files`."""
        return self.noted(list_files(self.files, patterns))

    def noted(self, listing: FileListing) -> list[str]:
        """Return the paths of a listing, and store the listing's faults and skipped paths, which `handles` reports."""
        self._lost = listing.faults
        self._passed_over |= listing.passed_over
        return listing.paths

    def pass_over(self, path: str, why: str) -> None:
        """Record that a file is skipped because it holds no scene; `why` is the reason."""
        self._passed_over[path] = why

    def scan_files(
        self, name: str, meshes: Iterable[str], navmeshes: Sequence[str], ledger: InputLedger
    ) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
        """Return the mesh of a scan, the first of `meshes` that exists, and the possible paths of its navmesh; those
        that exist are recorded as inputs. Scans are z-up.
        """
        mesh = next((mesh for mesh in meshes if self.files.has(mesh)), None)
        stage: tuple[MeshPart, ...] = ()
        if mesh is not None:
            ledger.file(mesh)
            stage = (MeshPart(mesh, placement(Z_UP_TO_HABITAT)),)
        return stage, self.shipped_navmeshes(name, ledger, navmeshes)

    def drawn_rooms(self, names: Sequence[str], ledger: InputLedger) -> tuple[Room, ...]:
        """Return the rooms that the user drew for a scene, if any; see `side_regions`."""
        side = self.options.regions
        return () if side is None else side_regions(side, names, self.family, ledger)

    def shipped_navmeshes(
        self, scene_name: str, ledger: InputLedger, configured: Sequence[str] = ()
    ) -> tuple[str, ...]:
        """Return the possible files of a scene's navmesh in order of preference; those that exist are recorded as
        inputs.

        Searched are the requested folder, the folder named by the dataset's configuration, and every ``navmesh*``
        folder of the root; first for the names in the configuration, then for the scene's own name.

        Raises
        ------
        PathEscapeError : the requested folder is outside the root
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

    def made(
        self,
        scene_id: str,
        rooms: Iterable[Room],
        objects: Iterable[SceneObject],
        warnings: Iterable[SceneWarning],
        navmeshes: tuple[str, ...],
        stage: tuple[MeshPart, ...] = (),
    ) -> Scene:
        """Return the scene with its rooms and objects sorted by id, and each warning once."""
        return Scene(
            family=self.family,
            scene_id=scene_id,
            root=self.root,
            rooms=tuple(sorted(rooms, key=lambda r: r.room_id)),
            objects=tuple(sorted(objects, key=lambda o: o.object_id)),
            shipped_navmeshes=navmeshes,
            stage=stage,
            warnings=tuple(sorted(set(warnings), key=lambda w: (w.code, w.where, w.message))),
        )

    def _fits_none(self, pattern: str) -> MissingFileError:
        return MissingFileError(
            f"no scene of the dataset fits the pattern {pattern!r}",
            where=self.root,
            remedy="Correct the source's 'scenes', or download the scenes",
        )

    def path_of(self, scene_id: str, paths: Mapping[str, str]) -> str:
        """Return the path of a scene.

        Raises
        ------
        MissingFileError : it is not among them
        """
        if scene_id not in paths:
            raise self.not_there(scene_id)
        return paths[scene_id]

    def not_there(self, scene_id: str) -> MissingFileError:
        """Return the error for a scene that the dataset does not have."""
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


class FileSource(Source):
    """A family whose scenes are one file each; what else a scene is read from lies beside its file."""

    nothing: ClassVar[tuple[str, str]]
    """What is not in a folder without scenes, and what to do."""

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        if not self.scans() and not self._lost:
            what, remedy = self.nothing
            raise ConfigError(f"no {what} are in this folder", where=root, remedy=remedy)

    @abstractmethod
    def scans(self) -> dict[str, str]:
        """Return the path of each scene's file, sorted by scene id."""

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `Source.listing`."""
        for scene_id, path in self.scans().items():
            yield scene_id, partial(self.note, scene_id, path)

    def note(self, scene_id: str, path: str, ledger: InputLedger) -> None:
        """Note what a scene is read from."""
        ledger.file(path)
        self.drawn_rooms(self.names(scene_id, path), ledger)
        self.beside(scene_id, path, ledger)

    def names(self, scene_id: str, path: str) -> list[str]:
        """Return the names that a scene's room zones may have."""
        return [posixpath.basename(scene_id)]

    def beside(self, scene_id: str, path: str, ledger: InputLedger) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
        """Return a scene's mesh, if the family has such files, and the possible paths of its navmesh."""
        return (), self.shipped_navmeshes(posixpath.basename(scene_id), ledger)


class ScanSource(FileSource):
    """A family of scans, each with a mesh and a navmesh beside its file."""

    def beside(self, scene_id: str, path: str, ledger: InputLedger) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
        """See `FileSource.beside`."""
        name = posixpath.basename(scene_id)
        bare = [posixpath.join(folder, name) for folder in dict.fromkeys(self.folders(posixpath.dirname(path)))]
        return self.scan_files(name, [f"{b}.glb" for b in bare], [f"{b}.navmesh" for b in bare], ledger)

    def folders(self, folder: str) -> list[str]:
        """Return the folders in which mesh and navmesh are looked for, by the folder of the scan's file."""
        return [folder]

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Return the scan's mesh; see `Source.geometry`."""
        return scan_geometry(self.files, scene)
