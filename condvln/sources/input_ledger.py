"""Record the inputs of a scene while it is read."""

from __future__ import annotations

import hashlib
from typing import Any

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import canonical_json
from condvln.sources.source import HashFile, SceneInput
from schemas.errors import MissingFileError

__all__ = ["InputLedger"]


class InputLedger:
    """The files, and entries of shared files, that one scene depends on.

    objects, rooms : numbers of the scene's objects and rooms, if the listing has counted them; otherwise None
    """

    def __init__(self) -> None:
        self._files: set[str] = set()
        self._entries: dict[str, Any] = {}
        self._records: dict[str, bytes] = {}
        self.objects: int | None = None
        self.rooms: int | None = None

    def file(self, path: str) -> None:
        """Record a whole file, by its path relative to the root."""
        self._files.add(path)

    def entry(self, path: str, name: str, value: Any) -> None:
        """Record one entry of a shared file, so that changes of other entries do not affect this scene."""
        self._entries[f"{path}#{name}"] = value

    def record(self, name: str, data: bytes) -> None:
        """Add an input by its bytes: one record of a shared file (named ``file#record``), or a whole file."""
        self._records[name] = data

    def inputs(self, root: DatasetRoot, hash_file: HashFile) -> tuple[SceneInput, ...]:
        """Return all recorded inputs, sorted by path; files that no longer exist are left out.

        Raises
        ------
        MissingFileError : a file exists but can't be read
        """
        entries = {name: canonical_json(value) for name, value in self._entries.items()} | self._records
        found = [SceneInput(p, len(v), hashlib.sha256(v).hexdigest()) for p, v in entries.items()]
        for path in self._files:
            if root.has(path):
                try:
                    size, sha256 = hash_file(root.path(path))
                except OSError as error:
                    what = f"the file can't be read ({error.strerror})"
                    raise MissingFileError(what, where=root.folder / path, remedy="Correct its permissions") from None
                found.append(SceneInput(path, size, sha256))
        return tuple(sorted(found, key=lambda i: i.path))
