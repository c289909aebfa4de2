"""Check that an export is complete: its files and numbers of episodes are those that the export's index lists.

Proofs of single episodes say nothing about missing ones. This compares the folder with ``export.json``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from condvln.export.contents import INDEX, ORIGIN, document_digest, read_document, read_index
from condvln.formats.regular_file import open_regular
from condvln.verify.files import split_names
from schemas.file_name import shown_path

__all__ = ["Fault", "find_faults", "row_counts"]

_READ: Final = ("manifest/*.jsonl", "vlnce/*/*.json.gz", "vlnce/*/content/*.json.gz")
"""Folders whose files count as episodes, whether listed or not."""
_OF_A_SPLIT: Final = ("manifest/{0}.jsonl", "vlnce/{0}/{0}.json.gz", "vlnce/{0}/{0}_gt.json.gz")
_BLOCK: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Fault:
    """A file of the export, and what is wrong with it."""

    file: str
    what: str

    def __str__(self) -> str:
        return f"{self.file}: {self.what}"

    def document(self) -> dict[str, str]:
        """Return the fault as plain JSON values."""
        return asdict(self)


def find_faults(folder: Path) -> Iterator[Fault]:
    """Yield each difference between an export folder and the export's index, ``export.json``. A complete folder yields
    nothing.
    """
    index = read_index(folder)
    if index is None:
        yield Fault(INDEX, "is missing or truncated, so the expected content is unknown")
        return
    signed = "digest" in index  # exports of earlier versions have no digest and no origin
    if signed and index["digest"] != document_digest(index):
        yield Fault(INDEX, "was changed or truncated after the export: its digest differs")
    listed, episodes = index.get("files"), index.get("episodes")
    if not isinstance(listed, dict) or not isinstance(episodes, dict):
        yield Fault(INDEX, "does not list the export's files and episodes")
        return
    if signed:
        yield from _faults_of_origin(folder, index)
    for name, entry in sorted(listed.items()):
        yield from _faults_of_file(folder / name, name, entry)
    for split, count in episodes.items():
        for name in (pattern.format(split) for pattern in _OF_A_SPLIT):
            if name not in listed:
                yield Fault(name, f"is not listed in {INDEX}, which has {count} episodes of {split}")
    for path in sorted(path for pattern in _READ for path in folder.glob(pattern)):
        name = shown_path(path.relative_to(folder).as_posix())
        if name not in listed:
            yield Fault(name, f"is not listed in {INDEX}")
    for split, rows in row_counts(folder).items():
        if split in episodes and rows != episodes[split]:
            yield Fault(f"manifest/{split}.jsonl", f"holds {rows} episodes, {INDEX} says {episodes[split]}")


def row_counts(folder: Path) -> dict[str, int]:
    """Return the number of rows of each manifest, by split; 0 for one that can't be read."""
    counts = {}
    for split in split_names(folder):
        counts[split] = 0
        with suppress(OSError), open_regular(folder / "manifest" / f"{split}.jsonl") as lines:
            counts[split] = sum(1 for line in lines if line.strip())
    return counts


def _faults_of_origin(folder: Path, index: Mapping[str, Any]) -> Iterator[Fault]:
    origin = read_document(folder / ORIGIN)
    if origin is None:
        yield Fault(ORIGIN, "is missing or truncated")
    elif origin.get("digest") != document_digest(origin):
        yield Fault(ORIGIN, "was changed or truncated after the export: its digest differs")
    elif origin.get("snapshot") != index.get("snapshot"):
        yield Fault(ORIGIN, f"is of snapshot {origin.get('snapshot')}, {INDEX} of {index.get('snapshot')}")


def _faults_of_file(path: Path, name: str, entry: Any) -> Iterator[Fault]:
    try:
        size, digest = int(entry["bytes"]), str(entry["sha256"])
    except (TypeError, KeyError, ValueError):
        yield Fault(name, f"is listed in {INDEX} without its size and hash")
        return
    try:
        found = path.stat().st_size
        if found != size:
            yield Fault(name, f"has {found} bytes, {INDEX} says {size}")
            return
        if _sha256(path) != digest:
            yield Fault(name, f"has another hash than {INDEX} lists")
    except OSError as error:
        yield Fault(name, f"can't be read: {error.strerror or error}; {INDEX} lists it with {size} bytes")


def _sha256(path: Path) -> str:
    state = hashlib.sha256()
    with open_regular(path) as file:
        while block := file.read(_BLOCK):
            state.update(block)
    return state.hexdigest()
