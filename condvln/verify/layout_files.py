"""What the proofs of layouts share: poses by scene, links to the images of the hub, and files of JSON lines."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, TypeAlias

import orjson
import pyarrow.parquet as pq

from condvln.formats.regular_file import read_regular

__all__ = ["Counts", "Faults", "Row", "jsonl", "linked", "scenes_with_poses"]

Row: TypeAlias = Mapping[str, Any]
Faults: TypeAlias = Iterator[tuple[str, str]]
"""Differences, each as (walk, what differs); the walk is empty if the layout as a whole is meant."""
Counts: TypeAlias = dict[str, int]
"""Number of compared rows, by layout."""


def scenes_with_poses(
    folder: Path, walks: Sequence[Row]
) -> Iterator[tuple[tuple[str, str], list[Row], list[dict[str, Any]]]]:
    """Yield each scene as (source, id), its walks and its poses. One scene's poses are in memory at a time.

    Raises
    ------
    ValueError : the two tables have the scenes in different orders
    """
    poses = pq.ParquetFile(folder / "poses.parquet")
    groups = iter(range(poses.num_row_groups))
    for key, own in groupby(walks, lambda walk: (walk["source"], walk["scene_id"])):
        group = next(groups, None)
        rows = [] if group is None else poses.read_row_group(group).to_pylist()
        if not rows or (rows[0]["source"], rows[0]["scene_id"]) != key:
            raise ValueError("poses.parquet has the scenes in another order")
        yield key, [*own], rows


def linked(folder: Path, place: Path, wanted: Mapping[str, str], walk: str) -> Faults:
    """Yield what is wrong with the files of the folder `place`. `wanted` gives for the name of each file the path of
    the hub's image that the file must be or equal.
    """
    found = {entry.name for entry in place.iterdir()}
    if found != wanted.keys():
        yield walk, f"{place.relative_to(folder)}: the files are not the walk's frames"
    for name in sorted(found & wanted.keys()):
        here, there = place / name, folder / wanted[name]
        if not os.path.samefile(here, there) and read_regular(here) != read_regular(there):
            yield walk, f"{here.relative_to(folder)} is not {wanted[name]}"


def jsonl(path: Path) -> list[Any]:
    """Return the documents of a file of JSON lines."""
    return [orjson.loads(line) for line in read_regular(path).splitlines()]
