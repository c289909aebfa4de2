"""Navmeshes for scenes that ship none: built from their surfaces, for the agent, as Habitat would build them."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from urllib.parse import quote

from condvln.navigation.navmesh_file import NavMeshFile
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import NavmeshFile, Scene, SceneWarning
from condvln.scene.geometry import SceneGeometry
from schemas.config import AgentConfig
from schemas.errors import InputError

__all__ = ["built_path", "with_built_navmesh"]


def built_path(family: str, scene_id: str) -> str:
    """Path of a scene's built navmesh in an export, '/'-separated."""
    return f"navmeshes/{family}/{quote(scene_id, safe='')}.navmesh"


def with_built_navmesh(scene: Scene, geometry: SceneGeometry, agent: AgentConfig) -> tuple[Scene, bytes | None]:
    """The scene with a navmesh of its own, and that navmesh's bytes.

    Objects count as built in: they stand in the agent's way. A scene on whose surfaces no agent can stand keeps going
    without a navmesh, and a warning says why.

    Parameters
    ----------
    scene : without a navmesh
    geometry : the scene's surfaces
    agent : whom the navmesh must fit
    """
    kept = tuple(warning for warning in scene.warnings if warning.code != "no_navmesh")
    try:
        built: NavMeshFile = build_navmesh(geometry.vertices, geometry.faces, NavMeshSettings.furnished(agent))
    except InputError as error:
        warning = SceneWarning("navmesh_not_built", "navmesh", error.what)
        return replace(scene, warnings=_sorted((*kept, warning))), None
    data = built.to_bytes()
    file = NavmeshFile(
        path=built_path(scene.family, scene.scene_id),
        sha256=hashlib.sha256(data).hexdigest(),
        built=True,
        fits=True,
        agent_radius=agent.radius,
        agent_height=agent.height,
        agent_max_climb=agent.max_climb,
        agent_max_slope=agent.max_slope,
    )
    note = SceneWarning("navmesh_built", "navmesh", "the dataset ships none: built from the scene's surfaces")
    if geometry.approximate:
        note = replace(note, message="the dataset ships none: built from its walls and the boxes of its objects")
    return replace(scene, navmesh=file, warnings=_sorted((*kept, note))), data


def _sorted(warnings: tuple[SceneWarning, ...]) -> tuple[SceneWarning, ...]:
    return tuple(sorted(warnings, key=lambda w: (w.code, w.where, w.message)))
