"""Find the navmesh that an episode is checked against.

Our exports name navmeshes in the manifest, by path and hash. Other files name only a scene, whose navmesh is beside the
mesh, as in Habitat's own datasets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final

from condvln.manifest import manifest_lines, manifest_paths
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.navigation.pathfinder import Pathfinder
from schemas.errors import CondVLNError, InputError, MissingFileError

__all__ = ["EpisodeNavmeshes"]

_SCENES: Final = ("data", "scene_datasets")
_LEVELS: Final = 3
"""Number of folders from a split's file up to its export: variant, split, content."""


class EpisodeNavmeshes:
    """Finds the navmeshes of episodes below some folders.

    Parameters
    ----------
    path : the checked file; if it belongs to an export, the export is searched first
    roots : folders of datasets, or the folder of scene datasets

    Attributes
    ----------
    checked : scenes whose navmesh was found
    lacking : why no navmesh was found, by scene_id
    """

    def __init__(self, path: Path, roots: Sequence[Path]) -> None:
        export = next((p for p in (path, *path.parents[: _LEVELS + 1]) if manifest_paths(p)), None)
        self._roots = tuple(roots)
        self._recorded = {} if export is None else _recorded(export)
        self._proven = NavmeshFolder((*([export] if export is not None else []), *roots))
        self._found: dict[tuple[str, str], Pathfinder | None] = {}
        self.checked: set[str] = set()
        self.lacking: dict[str, str] = {}

    def __call__(self, episode: Mapping[str, Any]) -> Pathfinder | None:
        """Return the pathfinder of an episode's scene; None if no navmesh of the scene exists."""
        info, scene = episode.get("info"), str(episode.get("scene_id"))
        digest = str(info.get("navmesh_sha256")) if isinstance(info, dict) else ""
        key = scene, digest
        if key not in self._found:
            self._found[key] = self._load(scene, digest)
        return self._found[key]

    def _load(self, scene: str, digest: str) -> Pathfinder | None:
        try:
            if digest in self._recorded:
                found = self._proven.load(self._recorded[digest], digest, scene)
            else:
                found = Pathfinder.load(self._beside(scene))
        except CondVLNError as error:
            self.lacking[scene] = error.what
            return None
        self.checked.add(scene)
        return found

    def _beside(self, scene: str) -> Path:
        parts = PurePosixPath(scene).parts
        if parts[:2] == _SCENES:
            parts = parts[2:]
        if not parts or ".." in parts or PurePosixPath(scene).is_absolute():
            raise MissingFileError(f"no navmesh of {scene!r}")
        name = PurePosixPath(*parts).with_suffix(".navmesh")
        for root in self._roots:
            # A root is either the folder of all scene datasets, or of one of them.
            for relative in (name, PurePosixPath(*name.parts[1:])):
                if relative.name and (root / relative).is_file():
                    return root / relative
        raise MissingFileError(f"no {name} below {', '.join(map(str, self._roots)) or 'any folder'}")


def _recorded(export: Path) -> dict[str, str]:
    """Return the path of each navmesh by its hash, from the manifests; damaged lines are skipped."""
    found: dict[str, str] = {}
    for path in manifest_paths(export):
        for line in manifest_lines(path):
            with suppress(InputError, KeyError):
                row = line.fields()
                found.setdefault(str(row["navmesh_sha256"]), str(row["navmesh"]))
    return found
