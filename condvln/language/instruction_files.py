"""Read files of instructions of other projects, item by item.

R2R's JSON is a list of items with ``instructions``; VLN-CE and NavSpace have ``episodes`` whose ``instruction`` holds
``instruction_text``; RxR has one item per line with ``instruction``. In general, an item is an object with one of these
keys, and items come in a list, in a list under ``episodes``, or one per line.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from condvln.formats.json_document import JsonNode, parse_json
from condvln.formats.streams import read_unpacked
from schemas.errors import FormatError

__all__ = ["REMEDY", "instruction_items"]

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
