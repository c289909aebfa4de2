"""Rows of ``manifest/<split>.jsonl``: the full ground truth of each episode, for evaluators and never for agents."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from condvln.episodes.placing import heading_degrees
from condvln.formats.json_entries import json_lines, parsed
from condvln.scene.rotations import heading_of
from schemas.base import SCHEMA_VERSION
from schemas.errors import FormatError, MissingFileError, shown_path
from schemas.evaluation import ManifestEpisode

__all__ = [
    "ManifestLine",
    "manifest_lines",
    "manifest_path",
    "manifest_paths",
    "manifest_row",
    "published_row",
    "read_manifest",
]

FOLDER = "manifest"
_REMEDY = "Export the split again"


class ManifestLine(NamedTuple):
    """One line of a manifest file; ``number`` counts from 1."""

    path: Path
    number: int
    text: bytes

    def fields(self) -> dict[str, Any]:
        """Return the line's JSON object without validation, for callers that need few fields of many rows.

        Raises
        ------
        FormatError : not a JSON object
        """
        fields = parsed(self.text, self.path, f"line {self.number}")
        if not isinstance(fields, dict):
            raise self._damaged("", "not a JSON object")
        return fields

    def ids(self) -> tuple[int, str]:
        """Return the episode's id and hash, without validating the rest of the row.

        Raises
        ------
        FormatError : the id is not an integer, or there is no hash, as in exports of older releases
        """
        fields = self.fields()
        number, hashed = fields.get("episode_id"), fields.get("episode_hash")
        if not isinstance(number, int):
            raise self._damaged("episode_id", "not an integer")
        if not isinstance(hashed, str):
            raise self._damaged("episode_hash", "missing")
        return number, hashed

    def row(self) -> ManifestEpisode:
        """Return the line as a validated manifest row.

        Raises
        ------
        FormatError : a field is missing or has a wrong type; the leaves do not match the program
        """
        try:
            row = ManifestEpisode.model_validate_json(self.text)
        except ValidationError as error:
            first = error.errors()[0]
            raise self._damaged(".".join(str(part) for part in first["loc"]), str(first["msg"])) from error
        if sorted(leaf.leaf for leaf in row.leaves) != [*range(len(row.program.leaves))]:
            raise self._damaged("leaves", "the number of entries differs from the number of leaves of the program")
        if not 0 <= row.gold_leaf < len(row.leaves):
            raise self._damaged("gold_leaf", f"there is no leaf {row.gold_leaf}")
        return row

    def _damaged(self, field: str, what: str) -> FormatError:
        place = f"line {self.number}: {field}" if field else f"line {self.number}"
        return FormatError(what, where=self.path, place=place, remedy=_REMEDY)


def manifest_path(export: Path, split: str) -> Path:
    """Return the path of a split's manifest."""
    return export / FOLDER / f"{split}.jsonl"


def manifest_paths(export: Path) -> list[Path]:
    """Return the sorted paths of all manifests of an export. A name that is not UTF-8 is that of no split."""
    return sorted(path for path in (export / FOLDER).glob("*.jsonl") if shown_path(path.name) == path.name)


def export_manifests(export: Path) -> list[Path]:
    """Return the sorted paths of all manifests of an export.

    Raises
    ------
    MissingFileError : there is none
    """
    found = manifest_paths(export)
    if not found:
        raise MissingFileError(
            "no manifest/<split>.jsonl in this folder", where=export, remedy="Name the folder that condvln export wrote"
        )
    return found


def manifest_lines(path: Path) -> Iterator[ManifestLine]:
    """Yield the non-blank lines of a manifest.

    Raises
    ------
    MissingFileError : the file does not exist
    FormatError : a line is longer than the limit
    """
    for number, text in json_lines(path):
        yield ManifestLine(path, number, text)


def read_manifest(path: str | os.PathLike[str]) -> Iterator[ManifestEpisode]:
    """Yield the validated rows of a manifest in file order.

    Raises
    ------
    MissingFileError, FormatError : as :func:`manifest_lines` and :meth:`ManifestLine.row`; an episode id occurs twice
    """
    path, seen = Path(path), set[int]()
    for line in manifest_lines(path):
        row = line.row()
        if row.episode_id in seen:
            place = f"line {line.number}: episode_id"
            raise FormatError(f"the id {row.episode_id} occurs twice", where=path, place=place, remedy=_REMEDY)
        seen.add(row.episode_id)
        yield row


def manifest_row(
    episode: Mapping[str, Any], instruction: Mapping[str, Any], *, source: str, split: str, navmesh: str, snapshot: str
) -> dict[str, Any]:
    """Return a :class:`schemas.evaluation.ManifestEpisode` as a plain dictionary, built from the rows of the tables."""
    own = {
        "schema_version": SCHEMA_VERSION,
        "source": source,
        "split": split,
        "depth": instruction["depth"],
        "chain": instruction["chain"],
        "program": {key: instruction[key] for key in ("category", "conditions", "branches", "leaves")},
        "navmesh": navmesh,
        "snapshot": snapshot,
    }
    return {name: own[name] if name in own else episode[name] for name in ManifestEpisode.model_fields}


def published_row(episode: ManifestEpisode) -> dict[str, Any]:
    """Return a manifest row in the form of the episodes table: each point as a mapping with x, y and z, the start
    heading in degrees.
    """
    row = episode.model_dump(mode="json")
    leaves = [
        {
            **leaf,
            "goals": [_point(p) for p in leaf["goals"]],
            "reference_path": [_point(p) for p in leaf["reference_path"]],
            "subgoals": [
                {**stop, "position": _point(stop["position"]), "outline": _corners(stop["outline"])}
                for stop in leaf["subgoals"]
            ],
        }
        for leaf in row["leaves"]
    ]
    looking = row["looking_path"]
    return {
        **row,
        "leaves": leaves,
        "start_position": _point(row["start_position"]),
        "start_heading_degrees": heading_degrees(heading_of(row["start_rotation"])),
        "looking_path": None if looking is None else [_point(p) for p in looking],
    }


def _corners(outline: Sequence[Sequence[float]] | None) -> list[dict[str, float]] | None:
    return None if outline is None else [dict(zip("xz", corner, strict=True)) for corner in outline]


def _point(position: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", position, strict=True))
