"""The kinds of files in each family's dataset, named as on the download pages, and the number of files on disk."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Final, Literal

__all__ = ["Download", "Found", "downloads", "look_for"]

_TABLE: Final = "downloads.csv"
HABITAT_PROCTHOR: Final = "ai2thor-hab"
"""The name of Habitat's form of ProcTHOR in the table; it is not a family of its own."""

MAX_COUNTED: Final = 1_000_000
"""Largest number of files counted of one kind, so that a search in a wrong folder ends."""


@dataclass(frozen=True, slots=True)
class Download:
    """One kind of file in a dataset.

    patterns : globs relative to the dataset's folder; one match is enough
    need : without ``required`` files nothing can be read; ``optional`` files add information
    holds : content of the files, and the effect if they are missing
    source : its name on the download page
    licence : the terms to accept before downloading
    """

    family: str
    patterns: tuple[str, ...]
    need: Literal["required", "optional"]
    holds: str
    source: str
    licence: str


@dataclass(frozen=True, slots=True)
class Found:
    """How many files of one kind a folder holds."""

    download: Download
    files: int


@cache
def downloads(family: str) -> tuple[Download, ...]:
    """Return the kinds of files of a family, the required ones first."""
    rows = csv.DictReader((files("condvln.sources") / _TABLE).read_text(encoding="utf-8").splitlines())
    found = [
        Download(
            family=row["family"],
            patterns=tuple(row["patterns"].split(";")),
            need="required" if row["need"] == "required" else "optional",
            holds=row["holds"],
            source=row["from"],
            licence=row["licence"],
        )
        for row in rows
        if row["family"] == family
    ]
    return tuple(sorted(found, key=lambda d: d.need != "required"))


def look_for(family: str, root: Path, houses: Path | None = None) -> list[Found]:
    """Return, for each kind of file of a family's dataset, how many of the files are in a folder; no file is opened.

    houses : the folder of the house JSON, if `root` holds Habitat's ProcTHOR scenes
    """
    if houses is not None:
        return [*look_for(HABITAT_PROCTHOR, root), *_look(downloads("procthor")[:1], houses)]
    return _look(downloads(family), root)


def _look(kinds: tuple[Download, ...], root: Path) -> list[Found]:
    found = []
    for download in kinds:
        paths = {path for pattern in download.patterns for path in islice(root.glob(pattern), MAX_COUNTED)}
        found.append(Found(download, len(paths)))
    return found
