"""Read instruction texts from an export or from a file of another benchmark. A text that occurs in several items counts
each time.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from condvln.formats.json_document import JsonNode, parse_json
from condvln.formats.json_entries import read_unpacked
from condvln.manifest import export_manifests, manifest_lines
from schemas.errors import FormatError
from schemas.program import Program

__all__ = ["REMEDY", "InstructionText", "instruction_items", "read_texts"]

LARGEST_FILE: Final = 1 << 30
"""Largest size of a file in bytes after decompression; R2R_VLNCE's training split has 40 MB."""

REMEDY: Final = "Name an export, or a file of R2R, VLN-CE, RxR or NavSpace (.json, .jsonl, each also .gz)"


def instruction_items(path: Path) -> Iterator[tuple[JsonNode, list[str]]]:
    """Yield the items of a file in its order, each with its texts.

    Raises
    ------
    InputError : the file does not exist, or it holds no instructions
    """
    found = False
    for item in _items(path):
        texts = _texts(item)
        found = found or bool(texts)
        yield item, texts
    if not found:
        raise FormatError("the file holds no instructions", where=path, remedy=REMEDY)


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


@dataclass(frozen=True, slots=True)
class InstructionText:
    """One instruction text. A text of our own also has its category, its program, and the start heading that it may
    state.
    """

    text: str
    category: str | None = None
    program: Program | None = None


def read_texts(path: str | os.PathLike[str]) -> Iterator[InstructionText]:
    """Yield the texts of an export's manifests, or of one file, in file order.

    Raises
    ------
    InputError : the path does not exist, or it holds no instructions
    """
    path = Path(path)
    if path.is_dir():
        yield from _of_export(path)
        return
    for _, texts in instruction_items(path):
        yield from map(InstructionText, texts)


def _of_export(folder: Path) -> Iterator[InstructionText]:
    for path in export_manifests(folder):
        for line in manifest_lines(path):
            row = line.row()
            yield InstructionText(row.instruction_text, row.category, row.program)
