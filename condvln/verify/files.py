"""Read an export's files in parallel, one scene at a time, and check that the export is complete: its files and numbers
of episodes are those that its index, ``export.json``, lists. Proofs of single episodes say nothing about missing ones.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from condvln.export.contents import INDEX, ORIGIN, document_digest, read_document, read_index
from condvln.formats.json_entries import entries, json_lines, parsed
from condvln.formats.regular_file import open_regular
from schemas.base import first_fault
from schemas.episode import Evidence
from schemas.errors import FormatError, MissingFileError, shown_path
from schemas.evaluation import ManifestEpisode
from schemas.program import Category, Program

__all__ = [
    "UNPROVEN",
    "ExportFiles",
    "Fault",
    "Row",
    "SceneRun",
    "UnplacedText",
    "find_faults",
    "row_counts",
    "split_names",
]

_REMEDY: Final = "Export again"


@dataclass(frozen=True, slots=True)
class Row:
    """One manifest row with its records and ground truths, along the direct and along the looking path; each is None if
    its file has no entry for the row.
    """

    split: str
    manifest: ManifestEpisode
    record: Mapping[str, Any] | None
    truth: Mapping[str, Any] | None
    looking_record: Mapping[str, Any] | None = None
    looking_truth: Mapping[str, Any] | None = None


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
    """The manifest of one split, with the records and ground truths of each row."""

    def __init__(self, folder: Path, split: str, unread: list[Unread]) -> None:
        self.split = split
        self._unread = unread
        self._path = folder / "manifest" / f"{split}.jsonl"
        self._rows = self._parsed_rows()
        self._told = {
            "record": _Lookup(_records(folder / "vlnce" / split)),
            "ground_truth": _Lookup(_truths(folder / "vlnce" / split)),
            "looking_record": _Lookup(_records(folder / "vlnce_looking" / split)),
            "looking_truth": _Lookup(_truths(folder / "vlnce_looking" / split)),
        }
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
        return Row(self.split, row, *[lookup.pop(str(row.episode_id)) for lookup in self._told.values()])

    def close(self) -> None:
        """Record the entries of the VLN-CE and ground-truth files for which the manifest has no row."""
        for kind, lookup in self._told.items():
            for name in lookup.rest():
                self._unread.append(Unread(self.split, name, kind, "no such episode in the manifest", name))

    def _parsed_rows(self) -> Iterator[ManifestEpisode]:
        for number, line in json_lines(self._path):
            try:
                row = ManifestEpisode.model_validate_json(line)
            except ValidationError as error:
                fault = first_fault(error)
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


def _records(folder: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the episodes of a split's VLN-CE documents by id.

    Raises
    ------
    FormatError, MissingFileError : a file does not exist or has another format
    """
    for path in (folder / f"{folder.name}.json.gz", *sorted(folder.glob("content/*.json.gz"))):
        for number, (_, text) in enumerate(entries(path, inside="episodes")):
            record = parsed(text, path, f"episodes.{number}")
            if not isinstance(record, dict):
                raise FormatError("an episode is not an object", where=path, place=f"episodes.{number}", remedy=_REMEDY)
            yield str(record.get("episode_id")), record


def _truths(folder: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    path = folder / f"{folder.name}_gt.json.gz"
    for name, text in entries(path):
        entry = parsed(text, path, f"episode {name}")
        yield str(name), entry if isinstance(entry, dict) else {}


UNPROVEN: Final = {
    "seeable": "the scene has no navmesh, so it is unknown where an agent can stand",
    "goal_reach": "the scene has no navmesh, so it is unknown whether an agent can walk to the stops",
    "observability": "the text has no start, so it is unknown from where the evidence is visible",
}
"""Facts of a text that need a navmesh or a start, with the reason."""


@dataclass(frozen=True, slots=True)
class UnplacedText:
    """A row of the instructions table that has a text and no episode; the fields are those of a row of the manifest."""

    instruction_id: str
    group_id: str | None
    source: str
    scene_id: str
    category: Category
    depth: int
    chain: int
    composition: str
    moves: int
    leads: int
    words: int
    gold_leaf: int
    instruction_text: str
    program: Program
    observability: None = None
    evidence_in_view: None = None
    evidence: tuple[Evidence, ...] | None = None

    @classmethod
    def of(cls, source: str, row: Mapping[str, Any]) -> UnplacedText:
        """Return a row of the table as a text. Raises ValidationError if its program is none."""
        program = {name: row[name] for name in ("category", "conditions", "branches", "leaves")}
        names = ("instruction_id", "group_id", "scene_id")
        axes = ("category", "depth", "chain", "composition", "moves", "leads")
        return cls(
            source=source,
            words=row["words"],
            gold_leaf=row["gold_leaf"],
            instruction_text=row["text"],
            program=Program.model_validate(program),
            **{name: row[name] for name in (*names, *axes)},
        )


_READ: Final = ("manifest/*.jsonl", "vlnce*/*/*.json.gz", "vlnce*/*/content/*.json.gz")
"""Folders whose files count as episodes, whether listed or not."""
_OF_A_SPLIT: Final = (
    "manifest/{0}.jsonl",
    *(f"{folder}/{{0}}/{{0}}{end}.json.gz" for folder in ("vlnce", "vlnce_looking") for end in ("", "_gt")),
)
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
    if index.get("digest") != document_digest(index):
        yield Fault(INDEX, "was changed or truncated after the export: its digest differs")
    listed, episodes = index.get("files"), index.get("episodes")
    if not isinstance(listed, dict) or not isinstance(episodes, dict):
        yield Fault(INDEX, "does not list the export's files and episodes")
        return
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
