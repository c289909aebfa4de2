"""Instruction texts of an export, or of a file of another benchmark.

R2R's JSON has a list of items with ``instructions``; VLN-CE and NavSpace have ``episodes`` whose ``instruction`` holds
``instruction_text``; RxR has one item a line with ``instruction``. So an item is an object with one of those keys, and
items stand in a list, in a list under ``episodes``, or one a line. What says the same twice, as RxR's items of many
annotators do not, is kept twice.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from condvln.formats.json_document import JsonNode, parse_json
from condvln.formats.streams import read_unpacked
from condvln.manifest import manifest_lines, manifest_paths
from schemas.errors import FormatError, MissingFileError
from schemas.program import Program

__all__ = ["InstructionText", "read_texts"]

LARGEST_FILE: Final = 1 << 30
"""Bytes after unpacking; R2R_VLNCE's training split has 40 MB."""

_REMEDY: Final = "Name an export, or a file of R2R, VLN-CE, RxR or NavSpace (.json, .jsonl, each also .gz)"


@dataclass(frozen=True, slots=True)
class InstructionText:
    """A text; one of ours also has a category, a program and the heading that it may open with."""

    text: str
    category: str | None = None
    program: Program | None = None


def read_texts(path: str | os.PathLike[str]) -> Iterator[InstructionText]:
    """The texts of an export's manifests, or of one file, in their order.

    Raises
    ------
    InputError : there is nothing to read, or it holds no instructions
    """
    path = Path(path)
    if path.is_dir():
        yield from _of_export(path)
        return
    found = False
    for item in _items(path):
        for text in _texts(item):
            found = True
            yield InstructionText(text)
    if not found:
        raise FormatError("holds no instructions", where=path, remedy=_REMEDY)


def _of_export(folder: Path) -> Iterator[InstructionText]:
    paths = manifest_paths(folder)
    if not paths:
        raise MissingFileError("no manifest/<split>.jsonl", where=folder, remedy=_REMEDY)
    for path in paths:
        for line in manifest_lines(path):
            row = line.row()
            yield InstructionText(row.instruction_text, row.category, row.program)


def _items(path: Path) -> Iterator[JsonNode]:
    data, where = read_unpacked(path, LARGEST_FILE), str(path)
    if path.name.removesuffix(".gz").endswith(".jsonl"):
        for number, line in enumerate(data.splitlines(), start=1):
            if line.strip():
                yield parse_json(line, f"{where}, line {number}")
        return
    document = parse_json(data, where)
    yield from (document["episodes"] if isinstance(document.value, dict) else document).entries()


def _texts(item: JsonNode) -> list[str]:
    if "instructions" in item:
        return [node.text() for node in item.array("instructions")]
    said = item["instruction"] if "instruction" in item else item["instruction_text"]
    if isinstance(said.value, dict):
        said = said["instruction_text"]
    return [said.text()]
