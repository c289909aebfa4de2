"""Find each episode's navmesh: search several folders for the relative path in the manifest, and verify the file's
hash.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import Final, Protocol

from condvln.navigation.pathfinder import Pathfinder
from schemas.errors import FormatError, MissingFileError, PathEscapeError

__all__ = ["NavmeshFolder"]

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
            remedy="Name the dataset's folder with --navmesh-root",
        )
