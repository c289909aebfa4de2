"""Choose the navmesh for a scene's episodes: one that the dataset ships or, if there is none, one built from the
scene's surfaces.
"""

from __future__ import annotations

import hashlib
import posixpath
from dataclasses import replace
from urllib.parse import quote

from condvln.formats.dataset_root import DatasetRoot
from condvln.navigation.navmesh_file import MAX_FILE_BYTES, parse_navmesh
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import NavmeshFile, Scene, SceneWarning
from condvln.scene.geometry import SceneGeometry
from schemas.config import AgentConfig
from schemas.errors import InputError

__all__ = ["built_path", "with_built_navmesh", "with_shipped_navmesh"]


def with_shipped_navmesh(scene: Scene, agent: AgentConfig) -> Scene:
    """Return the scene with one of the navmeshes that its dataset ships, preferably one built for the agent.

    Of ``scene.shipped_navmeshes`` the first file whose settings fit the agent is taken, else the first one that
    exists, with the warning ``navmesh_does_not_fit``. If none exists, the scene has no navmesh and the warning
    ``no_navmesh``.

    Raises
    ------
    FormatError : a file that had to be read is not a valid navmesh
    """
    root = DatasetRoot(scene.root)
    candidates = list(dict.fromkeys(scene.shipped_navmeshes))
    first: NavmeshFile | None = None
    for path in candidates:
        if not root.has(path):
            continue
        data = root.read(path, MAX_FILE_BYTES)
        own = parse_navmesh(data, str(scene.root / path)).known_settings
        fits = own.fits(agent.radius, agent.height, agent.max_climb, agent.max_slope)
        file = _record(posixpath.normpath(path), data, own, built=False, fits=fits)
        if fits:
            return replace(scene, navmesh=file)
        first = first or file
    if first is None:
        message = f"none of {', '.join(scene.shipped_navmeshes) or 'the usual places'} is there"
        return _with_warning(scene, SceneWarning("no_navmesh", "navmesh", message))
    message = (
        f"{first.path} was built for radius {first.agent_radius}, height {first.agent_height}, "
        f"climb {first.agent_max_climb}, slope {first.agent_max_slope}, "
        f"not for {agent.radius}, {agent.height}, {agent.max_climb}, {agent.max_slope}"
    )
    return _with_warning(replace(scene, navmesh=first), SceneWarning("navmesh_does_not_fit", "navmesh", message))


def built_path(family: str, scene_id: str) -> str:
    """Return the path of a scene's built navmesh in an export, '/'-separated."""
    return f"navmeshes/{family}/{quote(scene_id, safe='')}.navmesh"


def with_built_navmesh(scene: Scene, geometry: SceneGeometry, agent: AgentConfig) -> tuple[Scene, bytes | None]:
    """Return the scene with a navmesh built as Habitat would build it, and the bytes of the navmesh (None if it can't
    be built).

    Objects are obstacles. A scene without walkable floor stays without a navmesh and gets the warning
    ``navmesh_not_built``.

    Parameters
    ----------
    scene : without a navmesh
    geometry : the scene's surfaces
    agent : the agent that the navmesh is for
    """
    scene = replace(scene, warnings=tuple(warning for warning in scene.warnings if warning.code != "no_navmesh"))
    settings = NavMeshSettings.furnished(agent)
    try:
        built = build_navmesh(geometry.vertices, geometry.faces, settings)
    except InputError as error:
        return _with_warning(scene, SceneWarning("navmesh_not_built", "navmesh", error.what)), None
    data = built.to_bytes()
    file = _record(built_path(scene.family, scene.scene_id), data, settings, built=True, fits=True)
    surfaces = "its walls and the boxes of its objects" if geometry.approximate else "the scene's surfaces"
    note = SceneWarning("navmesh_built", "navmesh", f"the dataset ships none: built from {surfaces}")
    return _with_warning(replace(scene, navmesh=file), note), data


def _record(path: str, data: bytes, settings: NavMeshSettings, *, built: bool, fits: bool) -> NavmeshFile:
    return NavmeshFile(
        path=path,
        sha256=hashlib.sha256(data).hexdigest(),
        built=built,
        fits=fits,
        agent_radius=settings.agent_radius,
        agent_height=settings.agent_height,
        agent_max_climb=settings.agent_max_climb,
        agent_max_slope=settings.agent_max_slope,
    )


def _with_warning(scene: Scene, warning: SceneWarning) -> Scene:
    warnings = sorted({*scene.warnings, warning}, key=lambda w: (w.code, w.where, w.message))
    return replace(scene, warnings=tuple(warnings))
