"""Find the scenes of a benchmark in a user's copies of the datasets by the content of files, whatever their names.

Where a copy is laid out as the one that the benchmark was made from, it is taken as it is. Otherwise a folder is made
that holds the files under the paths that the scenes know them by, as links where the disk allows.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from condvln.formats.streams import atomic_stream
from condvln.sources.procthor import ProcthorSource
from condvln.sources.registry import open_source
from condvln.sources.source import hash_file
from schemas.benchmark import PackedInput, PackedSource
from schemas.errors import CondVLNError, InputError, StoreError

__all__ = ["FoundScenes", "find_scenes"]

_DIGITS: Final = 6
"""Most digits of the number of a house in a file of houses."""
_SHOWN: Final = 3


@dataclass
class FoundScenes:
    """What a user's folders hold of one family.

    root : the folder to read the scenes from
    lacking : for each scene that can't be read as it was, what of it is missing or differs
    notes : why a folder could not be listed
    """

    root: Path
    lacking: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def find_scenes(family: str, wanted: PackedSource, roots: Sequence[Path], out: Path) -> FoundScenes:
    """Find the inputs of all scenes of a family below the given folders.

    out : folder to make where the copies are laid out otherwise; a former one is replaced

    Raises
    ------
    StoreError : it can't be written
    """
    known = _by_content(roots, [*wanted.inputs, *wanted.shared])

    def choose(path: str, sha256: str) -> Path | None:
        same = known.get(sha256, [])
        return next((root / path for root in roots if root / path in same), same[0] if same else None)

    placed: dict[str, Path] = {}
    entries: dict[str, dict[str, PackedInput]] = defaultdict(dict)
    for one in wanted.inputs:
        if one.entry is not None:
            entries[one.path][one.entry] = one
        elif (whole := choose(one.path, one.sha256)) is not None:
            placed[one.path] = whole
    sound = {(path, "") for path in placed}
    shared = {one.path: choose(one.path, one.sha256) for one in wanted.shared}
    found = FoundScenes(roots[0])
    listed, records = _list(family, () if all(shared.values()) else roots, found.notes)
    composed: dict[str, dict[int, Callable[[], bytes]]] = {}
    for path, its in entries.items():
        file, good = shared.get(path), {*its}
        if file is None:
            equal = {file: {e for e, one in its.items() if here.get(e) == one.sha256} for file, here in listed.items()}
            file = max(sorted(equal), key=lambda f: (len(equal[f]), f in [r / path for r in roots]), default=None)
            good = equal[file] if file is not None else set()
        if len(good) < len(its) and all(map(_is_line, its.values())):
            read = records | {sha: same[0].read_bytes for sha, same in known.items()}
            composed[path] = {int(entry): read[one.sha256] for entry, one in its.items() if one.sha256 in read}
            good = {str(number) for number in composed[path]}
        elif file is not None and good:
            placed[path] = file
        sound |= {(path, entry) for entry in good}
    for scene, places in sorted(wanted.scenes.items()):
        bad = [one for one in map(wanted.inputs.__getitem__, places) if (one.path, one.entry or "") not in sound]
        if bad:
            found.lacking[scene] = _told(bad, len(places), roots)
    as_it_is = (root for root in roots if not composed and all(root / path == file for path, file in placed.items()))
    found.root = next(as_it_is, None) or _laid_out(out, placed, composed)
    return found


def _is_line(one: PackedInput) -> bool:
    return one.entry is not None and one.entry.isdecimal() and len(one.entry) <= _DIGITS


def _told(bad: Sequence[PackedInput], count: int, roots: Sequence[Path]) -> str:
    names = [one.path if one.entry is None else f"{one.path}#{one.entry}" for one in bad[:_SHOWN]]
    there = any((root / one.path).exists() for one in bad for root in roots)
    kind = "differs" if there else "missing"
    return f"{kind}, {len(bad)} of {count} files: {', '.join(names)}{' …' * (len(bad) > _SHOWN)}"


def _by_content(roots: Iterable[Path], wanted: Iterable[PackedInput]) -> dict[str, list[Path]]:
    """Return the files with a wanted content, by its hash. Only files of a wanted size are read."""
    sizes = {one.bytes for one in wanted}
    found: dict[str, list[Path]] = defaultdict(list)
    for root in roots:
        for folder, folders, names in os.walk(root):
            folders.sort()
            for path in (Path(folder, name) for name in sorted(names)):
                with suppress(OSError, InputError):  # a broken link, a pipe, a pointer to what was not downloaded
                    status = path.stat()
                    if stat.S_ISREG(status.st_mode) and status.st_size in sizes:
                        found[hash_file(path)[1]].append(path)
    return found


def _list(
    family: str, roots: Iterable[Path], notes: list[str]
) -> tuple[dict[Path, dict[str, str]], dict[str, Callable[[], bytes]]]:
    """Return, as the family's reader lists them, the hashes of the entries of shared files; and by the hash of a house
    what hands out its bytes.
    """
    entries: dict[Path, dict[str, str]] = defaultdict(dict)
    records: dict[str, Callable[[], bytes]] = {}
    for root in roots:
        try:
            source = open_source(family, root, hash_file=lambda _: (0, ""))
            for handle in source.each_handle():
                for one in handle.inputs:
                    path, mark, entry = one.path.partition("#")
                    if mark:
                        entries[root / path][entry] = one.sha256
                    if isinstance(source, ProcthorSource) and entry.isdecimal():
                        records[one.sha256] = partial(_record, source, handle.scene_id)
        except CondVLNError as error:
            notes.append(f"{root} can't be listed: {error.what}")
    return entries, records


def _record(source: ProcthorSource, scene_id: str) -> bytes:
    return source.record(scene_id)[1]


def _laid_out(out: Path, placed: Mapping[str, Path], composed: Mapping[str, Mapping[int, Callable[[], bytes]]]) -> Path:
    """Make the folder that holds each file under its path; where it was one line of many, the others are empty."""
    new = out.with_name(f".{out.name}.new")  # what is read may lie in the former folder
    try:
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir(parents=True)
        for path, file in placed.items():
            target, real = new / path, os.path.realpath(file)
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(real, target)
            except OSError:  # another disk
                shutil.copyfile(real, target)
        for path, records in composed.items():
            opening, between, closing = (b"[", b",", b"]") if path.endswith(".json") else (b"", b"\n", b"\n")
            with atomic_stream(new / path, closing=closing) as stream:
                stream.write(opening)
                for number in range(max(records, default=-1) + 1):
                    stream.write(between * bool(number) + (records[number]() if number in records else b"{}"))
        if out.exists():
            shutil.rmtree(out)
        new.rename(out)
    except OSError as error:
        what = f"the found scenes can't be laid out: {error.strerror or error}"
        raise StoreError(what, where=error.filename or out, remedy="Check the folder's rights and room.") from error
    return out
