"""``condvln compose --all``: every scene that an export names, each at the path that its episodes name."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import orjson
from rich.console import Console

from condvln.export.compose import compose_scene, is_composed
from condvln.export.contents import INDEX
from condvln.export.vlnce import scene_file
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.streams import read_unpacked
from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.scene_navmesh import built_path, with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.family import FAMILIES
from condvln.sources.source import Source, hash_file
from jobs.compose import NAVMESH, refuse_export, shipped_navmesh, write_changed
from jobs.pipeline import open_configured
from jobs.progress import RunProgress
from jobs.report import Report
from schemas.config import AgentConfig, Config
from schemas.errors import FormatError, InputError, MissingFileError

__all__ = ["compose_all"]

SECONDS: Final = 0.1
"""Expected CPU seconds of composing one scene, for the first estimate of the total; a drawn house takes half of it."""
_START: Final = 4096
"""Length in bytes of the part of a file that shows which program wrote it."""

Name = tuple[str, str]
"""Family and scene id."""


def compose_all(config: Config, folder: Path, *, own_navmesh: bool = False, console: Console | None = None) -> Report:
    """For every scene of the export, or of the sources if there is no export, write ``<folder>/<scene_id>`` and the
    scene's navmesh.

    Families of single-file scans are left alone: loaders take their own files. A scene whose files are there already,
    byte for byte, is left as it is. A scene that can't be composed is reported and passed over, and the report's exit
    code is then InputError's. One scene at a time is in memory.

    Parameters
    ----------
    folder : the loader's folder of scene datasets, ``scenes_dir``
    own_navmesh : write the navmesh on which the scene's episodes were placed, the dataset's or the one that the export
        keeps, where there is one

    Raises
    ------
    UsageError : `folder`, or a path in it, leads into the export
    FormatError : the export's own record is damaged
    StoreError : the disk refused
    """
    refuse_export(config.export, folder)
    export = _Export.read(config.export) if config.export is not None else None
    known = _known(config)
    wanted = export.scenes if export is not None else sorted(known)
    families = {family for family, _ in wanted} if export is not None else {source.family for source in config.sources}
    done = _Done(single_files=sorted(family for family in families if not _composed(family)))
    paths = DatasetRoot(folder)
    targets = {
        name: paths.join("", scene_file(*name), where=str(folder), place="/".join(name))
        for name in wanted
        if _composed(name[0])
    }
    for parent in dict.fromkeys((folder / target).parent for target in targets.values()):
        refuse_export(config.export, parent)
    writer = _Writer(folder, known, config.agent, export, own_navmesh)
    with RunProgress(console or Console(stderr=True, quiet=True)) as progress:
        progress.phase("compose", len(targets), SECONDS * len(targets))
        for name, target in targets.items():
            try:
                done.entries.append(writer.write(name, target))
            except InputError as error:
                # Not the error itself: it holds on to the frames that it came through, and they to the scene.
                done.failures["/".join(name)] = str(error)
            progress.step()
    return _report(done, folder, "of the sources" if export is None else f"of the export in {export.folder}")


def _composed(family: str) -> bool:
    return family in FAMILIES and FAMILIES[family].composed


def _single_file(family: str) -> str:
    """Return the form of the paths at which episodes expect the scenes of a family, below the folder of datasets."""
    return scene_file(family, FAMILIES[family].scene_form if family in FAMILIES else "<scene>")


def _known(config: Config) -> dict[Name, Source | InputError]:
    """Return, for the name of each scene that can be composed, the source to read it from, or the error that listing
    the scene raised.
    """
    known: dict[Name, Source | InputError] = {}
    hashed = cache(hash_file)  # scenes share most of their files
    for one in config.sources:
        if _composed(one.family):
            source = open_configured(config, one, hashed)
            for handle in source.handles():
                fault = None if handle.fault is None else handle.fault.with_traceback(None)
                known.setdefault((handle.family, handle.scene_id), fault or source)
    return known


@dataclass(frozen=True)
class _Export:
    """The scenes of an export, from its ``export.json``.

    scenes : of all splits, sorted
    hashes : SHA-256 of its files by path
    """

    folder: Path
    scenes: list[Name]
    hashes: dict[str, str]

    @classmethod
    def read(cls, folder: Path) -> _Export | None:
        """Read the record of an export; None if nothing is exported yet."""
        where = folder / INDEX
        if not where.exists():
            return None
        try:
            index = orjson.loads(read_unpacked(where))
            names = {str(scene) for found in index["scenes"].values() for scene in found}
            hashes = {str(path): str(entry["sha256"]) for path, entry in index["files"].items()}
        except (orjson.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"not the record of an export ({error})", where=where, remedy="Export again") from None
        return cls(folder, sorted((family, scene) for family, _, scene in (n.partition("/") for n in names)), hashes)

    def navmesh(self, scene: Scene) -> bytes | None:
        """Return the navmesh that was built for a scene's episodes; None if the export holds none.

        Raises
        ------
        InputError : it is no longer the one of the episodes
        """
        path = built_path(scene.family, scene.scene_id)
        if path not in self.hashes:
            return None
        data = (self.folder / path).read_bytes() if (self.folder / path).is_file() else b""
        if hashlib.sha256(data).hexdigest() != self.hashes[path]:
            raise InputError(
                "the navmesh of the scene's episodes is missing or changed",
                where=self.folder / path,
                remedy="Export again, or leave --own-navmesh out",
            )
        return data


@dataclass
class _Writer:
    """Writes scenes one by one, and holds only one in memory."""

    folder: Path
    known: dict[Name, Source | InputError]
    agent: AgentConfig
    export: _Export | None
    own_navmesh: bool

    def write(self, name: Name, target: str) -> dict[str, Any]:
        """Write one scene; return what was written, and the warnings."""
        out = self.folder / target
        _refuse_strangers(out)
        source = self.known.get(name)
        if source is None:
            raise MissingFileError(
                "no source has this scene", remedy="Correct the configuration's 'sources', or generate and export again"
            )
        if isinstance(source, InputError):
            raise source
        scene = with_shipped_navmesh(source.read(name[1]), self.agent)
        composed = compose_scene(scene, source.geometry(scene), self.agent)
        navmesh, origin = self._navmesh(scene, composed.navmesh)
        # The navmesh first: a loader that finds a scene finds its navmesh too.
        changed = [write_changed(out.with_suffix(NAVMESH), navmesh), write_changed(out, composed.glb)]
        return {
            "scene": "/".join(name),
            "scene_id": target,
            "bytes": len(composed.glb),
            "navmesh": origin,
            "written": any(changed),
            "left_out": len(composed.left_out),
            "textures_left_out": composed.textures_left_out,
        }

    def _navmesh(self, scene: Scene, built: NavMeshFile) -> tuple[bytes, str]:
        """Return the bytes of the navmesh that goes beside the scene, and where it comes from."""
        if self.own_navmesh:
            shipped = shipped_navmesh(scene)
            if shipped is not None:
                return shipped.to_bytes(), "dataset"
            kept = self.export.navmesh(scene) if self.export is not None else None
            if kept is not None:
                return kept, "export"
        return built.to_bytes(), "built"


def _refuse_strangers(out: Path) -> None:
    """Refuse to overwrite a file that this command did not write: it may be the only copy."""
    ours = not out.exists()
    if out.is_file():
        with out.open("rb") as stream:
            ours = is_composed(stream.read(_START))
    if not ours:
        raise InputError(
            "the file exists and was not written by condvln compose: it is kept",
            where=out,
            remedy="Remove it, or choose another folder",
        )


@dataclass
class _Done:
    """The results of all scenes, and the families whose scenes are single files already."""

    single_files: list[str]
    entries: list[dict[str, Any]] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)


def _report(done: _Done, folder: Path, origin: str) -> Report:
    written = sum(entry["written"] for entry in done.entries)
    total = len(done.entries) + len(done.failures)
    document: dict[str, Any] = {
        "folder": str(folder),
        "scenes": total,
        "written": written,
        "unchanged": len(done.entries) - written,
        "failed": [{"scene": scene, "message": message} for scene, message in done.failures.items()],
        "single_files": done.single_files,
        "composed": done.entries,
    }
    lines = [
        f"{folder}: {total} scenes {origin}: {written} written, {document['unchanged']} unchanged, "
        f"{len(done.failures)} that can't be composed"
    ]
    lines += [f"{scene}: {message.removeprefix(f'{scene}: ')}" for scene, message in done.failures.items()]
    lines += [
        f"Scenes of {FAMILIES[family].name if family in FAMILIES else family} are one file each: put the dataset's own "
        f"at {folder / _single_file(family)}"
        for family in done.single_files
    ]
    for key, what in (("left_out", "objects whose surfaces are not known"), ("textures_left_out", "textures")):
        some = [entry[key] for entry in done.entries if entry[key]]
        if some:
            lines.append(f"left out: {sum(some)} {what}, of {len(some)} scenes")
    if done.entries:
        lines.append(f"Episodes name these files: set the loader's scenes_dir (SCENES_DIR) to {folder}/")
    return Report(document, lines, exit_code=InputError.exit_code if done.failures else 0)
