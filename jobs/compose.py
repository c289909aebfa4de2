"""``condvln export --compose``: scenes of configured sources as single GLB files, each with its navmesh beside it:
one scene, or every scene that an export names, each at the path that its episodes name.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import orjson
from rich.console import Console

from condvln.export.compose import ComposedScene, compose_scene, is_composed
from condvln.export.contents import INDEX
from condvln.export.vlnce import scene_file
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_entries import read_unpacked
from condvln.formats.streams import write_file
from condvln.navigation.navmesh_file import MAX_FILE_BYTES, NavMeshFile, parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import built_path, with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.family import FAMILIES
from condvln.sources.scene_source import Source
from condvln.sources.source import hash_file
from jobs.pipeline import open_configured
from jobs.progress import RunProgress
from jobs.report import Report
from schemas.config import AgentConfig, Config
from schemas.errors import ConfigError, FormatError, InputError, MissingFileError, UsageError

__all__ = ["compose", "compose_all", "found_scene", "refuse_export"]

SUFFIX: Final = ".glb"
NAVMESH: Final = ".navmesh"
SHOWN: Final = 5
"""Number of omitted objects that are named; ``--json`` has all of them."""


SECONDS: Final = 0.1
"""Expected CPU seconds of composing one scene, for the first estimate of the total; a drawn house takes half of it."""
_START: Final = 4096
"""Length in bytes of the part of a file that shows which program wrote it."""

Name = tuple[str, str]
"""Family and scene id."""


def compose(config: Config, scene_id: str, out: Path, *, own_navmesh: bool = False) -> Report:
    """Write the scene to the GLB file `out`, and the scene's navmesh for the configured agent to a file beside `out`
    with the suffix ``.navmesh``.

    Parameters
    ----------
    scene_id : as in the tables; with ``<family>/`` before it where several sources have one of that name
    own_navmesh : write the navmesh that the dataset ships for the scene in place of the one built of `out`: episodes
        were placed on it, and their distances hold on it to the last digit

    Raises
    ------
    UsageError : no source, or more than one, has such a scene; `out` is not a .glb file, or lies in the export; the
        dataset ships no navmesh
    InputError : the scene can't be read, or has no surfaces
    """
    if out.suffix != SUFFIX:
        raise UsageError(f"{out} is not a {SUFFIX} file", place="OUT.glb", remedy=f"Name it {out.name}{SUFFIX}.")
    refuse_export(config.export, out.parent)
    source, name = found_scene(config, scene_id)
    scene = with_shipped_navmesh(source.read(name), config.agent)
    shipped = shipped_navmesh(scene) if own_navmesh else None
    if own_navmesh and shipped is None:
        raise UsageError(
            f"the dataset ships no navmesh of {scene.family}/{scene.scene_id}",
            place="--own-navmesh",
            remedy="Leave --own-navmesh out: the navmesh that is then built is the one that the episodes use.",
        )
    composed = compose_scene(scene, source.geometry(scene), config.agent)
    walked = composed.navmesh if shipped is None else shipped
    navmesh = out.with_suffix(NAVMESH)
    # The navmesh first: a loader that finds a scene finds its navmesh too.
    write_changed(navmesh, walked.to_bytes())
    write_changed(out, composed.glb)
    return _report(scene, composed, walked, out, navmesh)


def refuse_export(export: Path | None, folder: Path) -> None:
    """Raise an error if `folder` is the folder of an export or lies in it: composed scenes hold meshes of their
    datasets, which must not be published.

    Raises
    ------
    UsageError : `folder` is the export's, or lies in it
    """
    if export is not None and folder.resolve().is_relative_to(export.resolve()):
        raise UsageError(
            f"{folder} lies in the export {export}, which must not hold meshes or images",
            remedy="Choose a folder outside of it, such as the loader's data/scene_datasets.",
        )


def write_changed(path: Path, data: bytes) -> bool:
    """Write a file atomically; return False if the file has these bytes already.

    Raises
    ------
    StoreError : the disk refused
    """
    if path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data:
        return False
    write_file(path, data)
    return True


def shipped_navmesh(scene: Scene) -> NavMeshFile | None:
    """Read the navmesh file that the dataset ships for a scene. Return None if the dataset ships none for it.

    Raises
    ------
    InputError : it can't be read
    """
    if scene.navmesh is None:
        return None
    files = DatasetRoot(scene.root)
    return parse_navmesh(files.read(scene.navmesh.path, MAX_FILE_BYTES), str(files.folder / scene.navmesh.path))


def found_scene(config: Config, scene_id: str) -> tuple[Source, str]:
    """Return the one source that has the scene, and the scene's id in that source.

    Raises
    ------
    UsageError : no source, or more than one, has it
    """
    found: list[tuple[Source, str]] = []
    for one in config.sources:
        for name in dict.fromkeys((scene_id, scene_id.removeprefix(f"{one.family}/"))):
            asked = one.model_copy(update={"scenes": (name,), "exclude": ()})
            try:
                source = open_configured(config, asked, hash_file)
                handles = [h for h in source.handles() if h.scene_id == name and h.inputs]
            except ConfigError:
                continue  # such a dataset is not there, or no scene of it fits
            found += [(source, h.scene_id) for h in handles]
    if not found:
        raise UsageError(
            f"no source has a scene {scene_id!r}",
            place="SCENE",
            remedy="condvln sources CONFIG lists what is there; the scenes table has all ids.",
        )
    if len(found) > 1:
        families = ", ".join(f"{source.family}/{name}" for source, name in found)
        raise UsageError(f"several sources have this scene: {families}", place="SCENE", remedy="Name one of these.")
    return found[0]


def _report(scene: Scene, composed: ComposedScene, walked: NavMeshFile, out: Path, navmesh: Path) -> Report:
    nav, built = Pathfinder(walked), walked is composed.navmesh
    named = scene_file(scene.family, scene.scene_id)
    document: dict[str, Any] = {
        "scene": f"{scene.family}/{scene.scene_id}",
        "glb": str(out),
        "navmesh": str(navmesh),
        "bytes": len(composed.glb),
        "triangles": composed.triangles,
        "objects": len(composed.bodies),
        "left_out": list(composed.left_out),
        "textures_left_out": composed.textures_left_out,
        "approximate": composed.approximate,
        "navmesh_built": built,
        "navigable_area": nav.navigable_area,
        "islands": nav.num_islands,
        "scene_id": named,
        "warnings": dict(sorted(Counter(w.code for w in scene.warnings).items())),
    }
    lines = [
        f"{out}: {len(composed.glb):,} bytes, {composed.triangles:,} triangles, {len(composed.bodies)} objects"
        + (", drawn as boxes between walls" if composed.approximate else ""),
        f"{navmesh}: {nav.navigable_area:.2f} m² on {nav.num_islands} islands, "
        + ("built of it" if built or scene.navmesh is None else f"the dataset's {scene.navmesh.path}"),
        f"Episodes name this scene {named}: put both files there, below the loader's data/scene_datasets/.",
    ]
    if composed.left_out:
        shown = ", ".join(composed.left_out[:SHOWN]) + (" …" if len(composed.left_out) > SHOWN else "")
        lines.append(f"left out, as their surfaces are not known: {len(composed.left_out)} objects ({shown})")
    if composed.textures_left_out:
        lines.append(f"left out, as their images are not in a GLB file: {composed.textures_left_out} textures")
    return Report(document, lines)


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
    single_files = sorted(family for family in families if not _composed(family))
    entries: list[dict[str, Any]] = []
    failures: dict[str, str] = {}
    paths = DatasetRoot(folder)
    targets = {
        name: paths.join("", scene_file(*name), where=str(folder), place="/".join(name))
        for name in wanted
        if _composed(name[0])
    }
    for parent in dict.fromkeys((folder / target).parent for target in targets.values()):
        refuse_export(config.export, parent)
    with RunProgress(console or Console(stderr=True, quiet=True)) as progress:
        progress.phase("compose", len(targets), SECONDS * len(targets))
        for name, target in targets.items():
            try:
                found = known.get(name)
                entries.append(_write(name, folder, target, found, config.agent, export, own_navmesh))
            except InputError as error:
                # Not the error itself: it holds on to the frames that it came through, and they to the scene.
                failures["/".join(name)] = str(error)
            progress.step()
    origin = "of the sources" if export is None else f"of the export in {export.folder}"
    return _report_of_all(entries, failures, single_files, folder, origin)


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


def _write(
    name: Name,
    folder: Path,
    target: str,
    source: Source | InputError | None,
    agent: AgentConfig,
    export: _Export | None,
    own: bool,
) -> dict[str, Any]:
    """Write one scene and its navmesh below `folder`; return what was written, and what was left out.

    export, own : the export whose navmeshes are taken, if the episodes' own navmesh is wanted
    """
    out = folder / target
    _refuse_strangers(out)
    if source is None:
        raise MissingFileError(
            "no source has this scene", remedy="Correct the configuration's 'sources', or generate and export again"
        )
    if isinstance(source, InputError):
        raise source
    scene = with_shipped_navmesh(source.read(name[1]), agent)
    composed = compose_scene(scene, source.geometry(scene), agent)
    navmesh, origin = composed.navmesh.to_bytes(), "built"
    if own and (shipped := shipped_navmesh(scene)) is not None:
        navmesh, origin = shipped.to_bytes(), "dataset"
    elif own and export is not None and (kept := export.navmesh(scene)) is not None:
        navmesh, origin = kept, "export"
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


def _refuse_strangers(out: Path) -> None:
    """Refuse to overwrite a file that this command did not write: it may be the only copy."""
    ours = not out.exists()
    if out.is_file():
        with out.open("rb") as stream:
            ours = is_composed(stream.read(_START))
    if not ours:
        raise InputError(
            "the file exists and was not written by condvln export --compose: it is kept",
            where=out,
            remedy="Remove it, or choose another folder",
        )


def _report_of_all(
    entries: list[dict[str, Any]], failures: dict[str, str], single_files: list[str], folder: Path, origin: str
) -> Report:
    """Report the scenes written, those that failed, and the families whose scenes are single files already."""
    written = sum(entry["written"] for entry in entries)
    total = len(entries) + len(failures)
    document: dict[str, Any] = {
        "folder": str(folder),
        "scenes": total,
        "written": written,
        "unchanged": len(entries) - written,
        "failed": [{"scene": scene, "message": message} for scene, message in failures.items()],
        "single_files": single_files,
        "composed": entries,
    }
    lines = [
        f"{folder}: {total} scenes {origin}: {written} written, {document['unchanged']} unchanged, "
        f"{len(failures)} that can't be composed"
    ]
    lines += [f"{scene}: {message.removeprefix(f'{scene}: ')}" for scene, message in failures.items()]
    lines += [
        f"Scenes of {FAMILIES[family].name if family in FAMILIES else family} are one file each: put the dataset's own "
        f"at {folder / _single_file(family)}"
        for family in single_files
    ]
    for key, what in (("left_out", "objects whose surfaces are not known"), ("textures_left_out", "textures")):
        some = [entry[key] for entry in entries if entry[key]]
        if some:
            lines.append(f"left out: {sum(some)} {what}, of {len(some)} scenes")
    if entries:
        lines.append(f"Episodes name these files: set the loader's scenes_dir (SCENES_DIR) to {folder}/")
    return Report(document, lines, exit_code=InputError.exit_code if failures else 0)
