"""A cache of the list of all scenes, valid until a file of the sources changes.

Listing reads every record of a source that keeps its scenes in one file, which takes longer than planning them. The
memory is a file in the machine's local state; names, sizes and times decide whether it still holds (``jobs.watch``).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import orjson

from factory.unit import InputFile, Unit
from jobs.pipeline import list_units
from jobs.watch import code_digest, look
from jobs.workspace import file_hashes, hasher, local_state, source_paths
from schemas.canonical import digest
from schemas.config import Config

__all__ = ["listed_units"]


def listed_units(config: Config) -> list[Unit]:
    """List units as ``list_units`` does, from the cache if no file below the sources' folders changed."""
    path = local_state(config.store) / f".listing-{config.name}.json"
    files, settled = look(source_paths(config))
    document = config.model_dump(mode="json", exclude={"store", "export", "splits", "ray", "keep"})
    inputs = digest([document, code_digest(), files])
    if settled:
        known = _read(path, inputs)
        if known is not None:
            return known
    hashes = file_hashes(config)
    units = list_units(config, hasher(hashes))
    hashes.save()
    if settled and all(unit.fault is None for unit in units):
        _write(path, inputs, units)
    return units


def _read(path: Path, inputs: str) -> list[Unit] | None:
    try:
        document: dict[str, Any] = orjson.loads(path.read_bytes())
        if document["inputs"] != inputs:
            return None
        files = [InputFile(*file) for file in document["files"]]
        return [
            Unit(unit_id, partition, tuple(files[at] for at in inputs), payload, costs, memory)
            for unit_id, partition, inputs, payload, costs, memory in document["units"]
        ]
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return None  # it is only a memory


def _write(path: Path, inputs: str, units: list[Unit]) -> None:
    numbers: dict[InputFile, int] = {}
    rows = [
        (
            unit.unit_id,
            unit.partition,
            [numbers.setdefault(file, len(numbers)) for file in unit.inputs],
            unit.payload,
            unit.costs,
            unit.memory,
        )
        for unit in units
    ]
    files = [(file.path, file.size, file.sha256) for file in numbers]
    temporary = path.with_suffix(".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(orjson.dumps({"inputs": inputs, "files": files, "units": rows}))
        os.replace(temporary, path)
    except (OSError, TypeError):
        temporary.unlink(missing_ok=True)
