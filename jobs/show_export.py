"""``condvln show EXPORT``: print episodes from an export's manifests in the same form as episodes of a snapshot.

An export holds no furniture: its pictures have the floor, the start, and the way to every leaf.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from condvln.episodes.picture import draw_episode
from condvln.instructions.tree import program_tree
from condvln.manifest import ManifestLine, manifest_lines, manifest_paths, published_row
from condvln.navigation.navmesh_file import read_navmesh
from condvln.navigation.navmesh_folder import NavmeshFolder
from condvln.scene import Scene
from jobs.report import Report
from jobs.show import episode_lines, spread
from schemas.errors import FormatError, UsageError

__all__ = ["show_export"]

Row = dict[str, Any]

ID_WIDTH: Final = 16
"""Width to which ids are padded with blanks, so that integers sort by their value."""


def show_export(
    export: Path,
    *,
    episode: str | None = None,
    sample: int | None = None,
    picture: Path | None = None,
    roots: Sequence[Path] = (),
) -> Report:
    """Show the episode of an export whose id is (or begins with) `episode`, or a sample spread over categories and
    sources.

    Parameters
    ----------
    picture : folder for a PNG of each
    roots : folders of the datasets whose navmeshes the export does not ship; only pictures need them

    Raises
    ------
    UsageError : no manifest, or no such episode
    FormatError : a damaged manifest
    """
    found = [line.row() for line in _chosen(export, episode, sample or 1)]
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
        shown = published_row(row)
        report.extend(episode_lines(shown, tree))
        if picture is not None:
            navmesh = NavmeshFolder((export, *roots)).path(row.navmesh, row.navmesh_sha256, f"episode {row.episode_id}")
            tile = read_navmesh(navmesh).tile
            floor = [tile.verts[poly["verts"][: poly["vert_count"]]] for poly in tile.polys]
            picture.mkdir(parents=True, exist_ok=True)
            path = picture / f"{row.episode_id}.png"
            bare = Scene(row.source, row.scene_id, export, (), ())
            draw_episode(path, bare, floor, shown, tree, program=row.program)
            report.lines.append(f"  picture: {path}")
        report.lines.append("")
    return report


def _chosen(export: Path, episode: str | None, sample: int) -> list[ManifestLine]:
    """Return the manifest lines whose id or hash is `episode` or, if there are none, those whose id or hash begins with
    `episode`. If `episode` is None, return `sample` lines, spread evenly over categories and sources; each category and
    source gives the lines with its first ids.
    """
    found: list[ManifestLine] = []
    exact: list[ManifestLine] = []
    first: dict[tuple[str, str], list[tuple[str, ManifestLine]]] = {}
    for line in _lines(export):
        fields = line.fields()
        names = [fields.get(key) for key in ("category", "source")]
        own = fields.get("episode_id")
        if not all(isinstance(name, str) for name in names) or not isinstance(own, str | int):
            raise FormatError(
                "not a manifest row", where=line.path, place=f"line {line.number}", remedy="Export the split again"
            )
        (category, source), name = map(str, names), str(own)
        hashed = str(fields.get("episode_hash") or name)
        if episode is not None:
            if episode in (name, hashed):
                exact.append(line)
            elif name.startswith(episode) or hashed.startswith(episode):
                found.append(line)
            continue
        kept = first.setdefault((category, source), [])
        insort(kept, (name.rjust(ID_WIDTH), line))
        del kept[sample:]
    return exact or found if episode is not None else [line for _, line in spread(first, sample)]


def _lines(export: Path) -> Iterator[ManifestLine]:
    paths = manifest_paths(export)
    if not paths:
        raise UsageError(
            "neither a configuration nor an export", place=str(export), remedy="Name a YAML file or an export's folder."
        )
    for path in paths:
        yield from manifest_lines(path)
