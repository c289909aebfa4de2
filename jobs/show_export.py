"""``condvln show EXPORT``: episodes of an export's manifests, as published ones are shown.

An export holds no furniture: its pictures have the floor, the start, and the way to every leaf.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from condvln.episodes.picture import draw_episode
from condvln.episodes.placing import heading_degrees
from condvln.evaluation.json_entries import json_lines, parsed
from condvln.evaluation.navmeshes import NavmeshFolder
from condvln.evaluation.walker import heading_of
from condvln.export.splits import SPLITS
from condvln.navigation.navmesh_file import read_navmesh
from condvln.scene import Scene
from jobs.report import Report
from jobs.show import episode_lines, spread
from jobs.tree import program_tree
from schemas.errors import FormatError, UsageError
from schemas.evaluation import ManifestEpisode

__all__ = ["show_export"]

Row = dict[str, Any]


def show_export(
    export: Path,
    *,
    episode: str | None = None,
    sample: int | None = None,
    picture: Path | None = None,
    roots: Sequence[Path] = (),
) -> Report:
    """One episode of an export by id (or the beginning of it), or a sample spread over categories and sources.

    Parameters
    ----------
    picture : folder for a PNG of each
    roots : folders of the datasets whose navmeshes the export does not ship; only pictures need them

    Raises
    ------
    UsageError : no manifest, or no such episode
    FormatError : a damaged manifest
    """
    found = [_row(path, number, line) for path, number, line in _chosen(export, episode, sample or 1)]
    if not found:
        raise UsageError(
            "the manifests hold no episodes" if episode is None else f"no episode {episode!r}",
            place=str(export),
            remedy="condvln show EXPORT --sample 5 lists some.",
        )
    report = Report({"episodes": []})
    for row in found:
        tree = program_tree(row.program)
        document = row.model_dump(mode="json")
        report.document["episodes"].append({**document, "tree": tree})
        shown = _as_published(document)
        report.extend(episode_lines(shown, tree))
        if picture is not None:
            navmesh = NavmeshFolder((export, *roots)).path(row.navmesh, row.navmesh_sha256, f"episode {row.episode_id}")
            tile = read_navmesh(navmesh).tile
            floor = [tile.verts[poly["verts"][: poly["vert_count"]]] for poly in tile.polys]
            picture.mkdir(parents=True, exist_ok=True)
            path = picture / f"{row.episode_id}.png"
            draw_episode(path, Scene(row.source, row.scene_id, export, (), ()), floor, shown, tree)
            report.lines.append(f"  picture: {path}")
        report.lines.append("")
    return report


def _chosen(export: Path, episode: str | None, sample: int) -> list[tuple[Path, int, bytes]]:
    """Lines of the manifests; those of a sample have the first ids of each category and source."""
    found: list[tuple[Path, int, bytes]] = []
    first: dict[tuple[str, str], list[tuple[str, Path, int, bytes]]] = {}
    for path, number, line in _lines(export):
        entry = parsed(line, path, f"line {number}")
        names = [entry.get(key) for key in ("category", "source", "episode_id")] if isinstance(entry, dict) else [None]
        if not all(isinstance(name, str) for name in names):
            raise FormatError("not a manifest row", where=path, place=f"line {number}", remedy="Export again.")
        category, source, name = map(str, names)
        if episode is not None:
            if name.startswith(episode):
                found.append((path, number, line))
            continue
        kept = first.setdefault((category, source), [])
        insort(kept, (name, path, number, line))
        del kept[sample:]
    if episode is not None:
        return found
    return [(path, number, line) for _, path, number, line in spread(first, sample)]


def _lines(export: Path) -> Iterator[tuple[Path, int, bytes]]:
    paths = [export / "manifest" / f"{split}.jsonl" for split in SPLITS]
    there = [path for path in paths if path.is_file()]
    if not there:
        raise UsageError(
            "neither a configuration nor an export", place=str(export), remedy="Name a YAML file or an export's folder."
        )
    for path in there:
        for number, line in json_lines(path):
            yield path, number, line


def _row(path: Path, number: int, line: bytes) -> ManifestEpisode:
    try:
        return ManifestEpisode.model_validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        place = f"line {number}: {'.'.join(map(str, first['loc']))}"
        raise FormatError(str(first["msg"]), where=path, place=place, remedy="Export the split again.") from error


def _as_published(row: Row) -> Row:
    """The row as the episodes table has it: points by their axes, the heading of the start."""
    leaves = [
        {
            **leaf,
            "goals": [_point(p) for p in leaf["goals"]],
            "reference_path": [_point(p) for p in leaf["reference_path"]],
            "subgoals": [{**stop, "position": _point(stop["position"])} for stop in leaf["subgoals"]],
        }
        for leaf in row["leaves"]
    ]
    heading = heading_degrees(heading_of(row["start_rotation"]))
    return {**row, "leaves": leaves, "start_position": _point(row["start_position"]), "start_heading_degrees": heading}


def _point(position: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", position, strict=True))
