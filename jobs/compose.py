"""``condvln compose``: one scene of a configured source as one GLB file, with its navmesh beside it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Final

from condvln.export.compose import ComposedScene, compose_scene
from condvln.export.vlnce import scene_file
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.streams import atomic_stream
from condvln.navigation.navmesh_file import MAX_FILE_BYTES, NavMeshFile, parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.scene import Scene
from condvln.sources.source import Source, hash_file
from jobs.pipeline import open_configured
from jobs.report import Report
from schemas.config import Config
from schemas.errors import ConfigError, UsageError

__all__ = ["NAVMESH", "compose", "found_scene", "refuse_export", "shipped_navmesh", "write_changed"]

SUFFIX: Final = ".glb"
NAVMESH: Final = ".navmesh"
SHOWN: Final = 5
"""Number of omitted objects that are named; ``--json`` has all of them."""


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
    with atomic_stream(path) as stream:
        stream.write(data)
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
