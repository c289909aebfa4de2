"""Read instruction texts from an export or from a file of another benchmark. A text that occurs in several items counts
each time.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from condvln.language.instruction_files import REMEDY, instruction_items
from condvln.manifest import manifest_lines, manifest_paths
from schemas.errors import MissingFileError
from schemas.program import Program

__all__ = ["InstructionText", "read_texts"]


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
    paths = manifest_paths(folder)
    if not paths:
        raise MissingFileError("no manifest/<split>.jsonl in this folder", where=folder, remedy=REMEDY)
    for path in paths:
        for line in manifest_lines(path):
            row = line.row()
            yield InstructionText(row.instruction_text, row.category, row.program)
