"""The navmesh of a scene's episodes: one that the dataset ships, or one built from the scene's surfaces; and the same
navmesh found again later by the path and the hash in the manifest.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Final, Protocol
from urllib.parse import quote

from condvln.formats.dataset_root import DatasetRoot
from condvln.navigation.navmesh_file import MAX_FILE_BYTES, parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.recast import build_navmesh
from condvln.navigation.settings import NavMeshSettings
from condvln.scene import NavmeshFile, Scene, SceneWarning
from condvln.scene.scene import SceneGeometry
from schemas.config import AgentConfig
from schemas.errors import FormatError, InputError, MissingFileError, PathEscapeError

__all__ = ["NavmeshFolder", "built_path", "with_built_navmesh", "with_shipped_navmesh"]


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


_KEPT: Final = 64
"""Number of pathfinders kept in memory: predictions name scenes in any order."""


class OnNavmesh(Protocol):
    """Anything that names its navmesh: a task or a manifest row."""

    @property
    def episode_id(self) -> int | str:
        """Id of the episode, for messages."""
        ...

    @property
    def navmesh(self) -> str:
        """Path of the navmesh below a root, '/'-separated."""
        ...

    @property
    def navmesh_sha256(self) -> str:
        """SHA-256 of the navmesh file, hex."""
        ...


class NavmeshFolder:
    """Loads pathfinders by the path and hash of their navmesh, and keeps the most recent ones in memory.

    Parameters
    ----------
    roots : folders to search, in order: the export itself, then the datasets' own
    """

    def __init__(self, roots: Sequence[Path]) -> None:
        self._roots = tuple(roots)
        self._pathfinders: OrderedDict[str, Pathfinder] = OrderedDict()

    def __call__(self, episode: OnNavmesh) -> Pathfinder:
        """Return the pathfinder of an episode's scene.

        Raises
        ------
        MissingFileError : the navmesh is in none of the folders
        FormatError : the file differs from the navmesh with which the episodes were generated
        """
        return self.load(episode.navmesh, episode.navmesh_sha256, f"episode {episode.episode_id}")

    def check(self, episodes: Iterable[OnNavmesh]) -> None:
        """Look for the navmeshes of all episodes, so that none is missed in the middle of the work. Raises what a call
        raises.
        """
        seen: set[tuple[str, str]] = set()
        for episode in episodes:
            key = (episode.navmesh, episode.navmesh_sha256)
            if key not in seen:
                seen.add(key)
                self.path(*key, f"episode {episode.episode_id}")

    def load(self, navmesh: str, sha256: str, place: str) -> Pathfinder:
        """Return the pathfinder of the navmesh with the path ``navmesh`` below a root and the hash ``sha256``.
        ``place`` names the caller in error messages.

        Raises
        ------
        PathEscapeError : the path is outside every root
        MissingFileError, FormatError : as for an episode
        """
        found = self._pathfinders.get(sha256)
        if found is None:
            found = self._pathfinders[sha256] = Pathfinder.load(self.path(navmesh, sha256, place))
            if len(self._pathfinders) > _KEPT:
                self._pathfinders.popitem(last=False)
        self._pathfinders.move_to_end(sha256)
        return found

    def path(self, navmesh: str, sha256: str, place: str) -> Path:
        """Return the file of a navmesh; arguments and errors are those of :meth:`load`."""
        relative = PurePosixPath(navmesh)
        if relative.is_absolute() or ".." in relative.parts:
            raise PathEscapeError(
                f"the path of the navmesh, {navmesh!r}, leads out of the folders of navmeshes",
                place=place,
                remedy="Export the split again",
            )
        others = []
        for root in self._roots:
            path = root / relative
            if path.is_file():
                if hashlib.sha256(path.read_bytes()).hexdigest() == sha256:
                    return path
                others.append(path)
        if others:
            raise FormatError(
                "not the navmesh with which the episodes were generated: its hash differs",
                where=others[0],
                place=place,
                remedy="Use the file of the dataset's version that the manifest names, or export again",
            )
        raise MissingFileError(
            f"no navmesh {navmesh} below {', '.join(map(str, self._roots)) or 'any folder'}",
            place=place,
            remedy="Name the dataset's folder with --data DIR",
        )
