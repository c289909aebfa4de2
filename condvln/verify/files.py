"""Read an export's files in parallel, one scene at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from condvln.formats.json_entries import entries, json_lines, opened, parsed
from condvln.formats.json_scan import new_state, scan
from schemas.errors import FormatError, MissingFileError
from schemas.evaluation import ManifestEpisode
from schemas.file_name import shown_path

__all__ = ["ExportFiles", "Row", "SceneRun", "Unread", "split_names"]

_BLOCK: Final = 1 << 20
_EPISODES: Final = re.compile(rb'\s*\{\s*"episodes"\s*:\s*(?=\[)')
_REMEDY: Final = "Export again"


@dataclass(frozen=True, slots=True)
class Row:
    """One manifest row with its record and its ground truth; either is None if its file has no entry for the row."""

    split: str
    manifest: ManifestEpisode
    record: Mapping[str, Any] | None
    truth: Mapping[str, Any] | None


@dataclass(frozen=True, slots=True)
class Unread:
    """An entry of one file that has no counterpart in another, or that can't be read."""

    split: str
    episode_id: str
    fact: str
    claimed: str
    found: str


@dataclass(slots=True)
class SceneRun:
    """All consecutive rows of one scene."""

    source: str
    scene_id: str
    rows: list[Row] = field(default_factory=list)


class ExportFiles:
    """The splits of an export folder.

    Raises
    ------
    MissingFileError : the folder has no manifests
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.unread: list[Unread] = []
        """Lines that are not a valid row with its record; complete when `runs` has ended."""
        self.splits = split_names(folder)
        if not self.splits:
            raise MissingFileError(
                "no manifest/<split>.jsonl in this folder",
                where=folder,
                remedy="Name the folder of an export, or export first",
            )

    def runs(self) -> Iterator[SceneRun]:
        """Yield the rows, scene by scene. Each scene occurs only once if all files have the same order, as they have in
        an export.
        """
        cursors = [_SplitCursor(self.folder, split, self.unread) for split in self.splits]
        while waiting := [cursor.scene for cursor in cursors if cursor.scene is not None]:
            # No reference is kept here, so that a scene is freed when the caller is done with it.
            yield _taken(cursors, *min(waiting))
        for cursor in cursors:
            cursor.close()


def _taken(cursors: Sequence[_SplitCursor], source: str, scene_id: str) -> SceneRun:
    """Take the rows of one scene from all splits."""
    run = SceneRun(source, scene_id)
    for cursor in cursors:
        while cursor.scene == (source, scene_id):
            run.rows.append(cursor.take())
    return run


def split_names(folder: Path) -> list[str]:
    """Return the sorted names of an export's splits: those of its manifests. One that is not UTF-8 is no split's."""
    names = sorted(path.stem for path in (folder / "manifest").glob("*.jsonl"))
    return [name for name in names if shown_path(name) == name]


class _SplitCursor:
    """The manifest of one split, with the record and ground truth of each row."""

    def __init__(self, folder: Path, split: str, unread: list[Unread]) -> None:
        self.split = split
        self._unread = unread
        self._path = folder / "manifest" / f"{split}.jsonl"
        self._rows = self._parsed_rows()
        base = folder / "vlnce" / split
        shards = sorted(base.glob("content/*.json.gz"))
        self._records = _Lookup(entry for path in (base / f"{split}.json.gz", *shards) for entry in _records(path))
        self._truths = _Lookup(_truths(base / f"{split}_gt.json.gz"))
        self._next = next(self._rows, None)

    @property
    def scene(self) -> tuple[str, str] | None:
        """Source and scene of the next row; None at the end."""
        return None if self._next is None else (self._next.source, self._next.scene_id)

    def take(self) -> Row:
        """Return the next row."""
        assert self._next is not None
        row = self._next
        self._next = next(self._rows, None)
        return Row(self.split, row, self._records.pop(str(row.episode_id)), self._truths.pop(str(row.episode_id)))

    def close(self) -> None:
        """Record the entries of the VLN-CE and ground-truth files for which the manifest has no row."""
        for kind, lookup in (("record", self._records), ("ground_truth", self._truths)):
            for name in lookup.rest():
                self._unread.append(Unread(self.split, name, kind, "no such episode in the manifest", name))

    def _parsed_rows(self) -> Iterator[ManifestEpisode]:
        for number, line in json_lines(self._path):
            try:
                row = ManifestEpisode.model_validate_json(line)
            except ValidationError as error:
                first = error.errors()[0]
                fault = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
                self._unread.append(Unread(self.split, f"line {number}", "readable", "a manifest row", fault))
                continue
            if len(row.leaves) != len(row.program.leaves):
                fault = f"{len(row.leaves)} leaves for the program's {len(row.program.leaves)}"
                self._unread.append(Unread(self.split, str(row.episode_id), "readable", "an entry a leaf", fault))
                continue
            yield row


class _Lookup:
    """Looks up entries by name in a stream whose order is roughly that of the requests."""

    def __init__(self, stream: Iterator[tuple[str, Mapping[str, Any]]]) -> None:
        self._stream = stream
        self._passed: dict[str, list[Mapping[str, Any]]] = {}

    def pop(self, name: str) -> Mapping[str, Any] | None:
        """Return the next entry with this name that was not returned before; None if no such entry is left."""
        if name not in self._passed:
            for other, entry in self._stream:
                if other == name:
                    return entry
                self._passed.setdefault(other, []).append(entry)
            if name not in self._passed:
                return None
        waiting = self._passed[name]
        entry = waiting.pop(0)
        if not waiting:
            del self._passed[name]
        return entry

    def rest(self) -> Iterator[str]:
        """Yield the names of the entries that were not requested."""
        for name, waiting in self._passed.items():
            yield from [name] * len(waiting)
        yield from (name for name, _ in self._stream)


def _records(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the episodes of a VLN-CE document by id.

    Raises
    ------
    FormatError, MissingFileError : the file does not exist or has another format
    """
    for number, text in enumerate(_elements(path)):
        record = parsed(text, path, f"episodes.{number}")
        if not isinstance(record, dict):
            raise FormatError("an episode is not an object", where=path, place=f"episodes.{number}", remedy=_REMEDY)
        yield str(record.get("episode_id")), record


def _elements(path: Path) -> Iterator[bytes]:
    """Yield the bytes of each entry of the array ``episodes``, which must be the first item of the file."""
    state, pending, opened_array = new_state(), bytearray(), False
    with opened(path) as file:
        while block := file.read(_BLOCK):
            if not opened_array:
                head = _EPISODES.match(block)
                if head is None:
                    raise FormatError(
                        "the file does not begin with the key 'episodes' and a list", where=path, remedy=_REMEDY
                    )
                block, opened_array = block[head.end() :], True
            begin = 0
            for end in scan(np.frombuffer(block, np.uint8), state).tolist():
                pending += block[begin:end]
                begin = end
                element = bytes(pending).lstrip(b"[, \t\r\n")
                pending.clear()
                if element.strip() == b"]":
                    while file.read(_BLOCK):  # a damaged end is noticed only on reading it
                        pass
                    return
                yield element
            pending += block[begin:]
    raise FormatError("is empty or truncated", where=path, remedy=_REMEDY)


def _truths(path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for name, text in entries(path):
        entry = parsed(text, path, f"episode {name}")
        yield str(name), entry if isinstance(entry, dict) else {}
