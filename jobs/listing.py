"""A cache of the list of all scenes, valid until a file of the sources changes.

Listing reads every record of a source that keeps its scenes in one file, which takes longer than planning them. The
memory is a file in the machine's local state; names, sizes and times decide whether it still holds (``jobs.watch``).
"""

from __future__ import annotations

import glob
import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import orjson

from factory.unit import InputFile, Unit
from factory.unit_list import UnitList
from jobs.pipeline import units_of
from jobs.watch import code_digest, look
from jobs.workspace import file_hashes, hasher, local_state, source_paths
from schemas.canonical import digest
from schemas.config import Config

__all__ = ["listed_units"]

FILES: Final = 1 << 14
"""Number of input files that are written once for all scenes; further ones are repeated in each scene."""


def listed_units(config: Config) -> UnitList:
    """List units as ``units_of`` does, from the cache if no file below the sources' folders changed."""
    path = local_state(config.store) / f".listing-{config.name}.json"
    files, settled = look(source_paths(config))
    document = config.model_dump(mode="json", exclude={"store", "export", "splits", "ray", "keep"})
    inputs = digest([document, code_digest(), files])
    if settled:
        known = _read(path, inputs)
        if known is not None:
            return known
    hashes = file_hashes(config)
    units = units_of(config, hasher(hashes))
    hashes.save()
    if settled and not units.faulty:
        _write(path, inputs, units)
    return units


def _read(path: Path, inputs: str) -> UnitList | None:
    try:
        with path.open("rb") as lines:
            head = orjson.loads(next(lines, b""))
            if head["inputs"] != inputs:
                return None
            units = UnitList(map(_Files().read, lines))
        return units if len(units) == head["units"] else None
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return None  # it is only a memory


def _write(path: Path, inputs: str, units: UnitList) -> None:
    # Each process has a file of its own, so that no two mix; what one that was killed left is removed by the next.
    temporary = path.with_suffix(f".{secrets.token_hex(8)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for left in path.parent.glob(f"{glob.escape(path.stem)}.*.tmp"):
            left.unlink(missing_ok=True)
        with temporary.open("wb") as lines:
            lines.write(orjson.dumps({"inputs": inputs, "units": len(units)}) + b"\n")
            lines.writelines(map(_Files().line, units))
        os.replace(temporary, path)
    except (OSError, TypeError):
        with suppress(OSError):  # in a store that is read-only, too
            temporary.unlink(missing_ok=True)


class _Files:
    """The input files of the lines so far, up to ``FILES``. A line holds the number of a file that was there before,
    and else the file itself: scenes share most of theirs.
    """

    def __init__(self) -> None:
        self._known: list[InputFile] = []
        self._numbers: dict[InputFile, int] = {}

    def line(self, unit: Unit) -> bytes:
        """Return a unit as a line of JSON."""
        files = [*map(self._written, unit.inputs)]
        return orjson.dumps([unit.unit_id, unit.partition, files, unit.payload, unit.costs, unit.memory]) + b"\n"

    def _written(self, file: InputFile) -> int | tuple[str, int, str]:
        number = self._numbers.get(file)
        if number is not None:
            return number
        if len(self._numbers) < FILES:
            self._numbers[file] = len(self._numbers)
        return file.path, file.size, file.sha256

    def read(self, line: bytes) -> Unit:
        """Return the unit of a line. Raises some error where it is none."""
        unit_id, partition, files, payload, costs, memory = orjson.loads(line)
        return Unit(unit_id, partition, tuple(map(self._read, files)), payload, costs, memory)

    def _read(self, written: int | list[Any]) -> InputFile:
        if isinstance(written, int):
            return self._known[written]
        file = InputFile(*written)
        if len(self._known) < FILES:
            self._known.append(file)
        return file
