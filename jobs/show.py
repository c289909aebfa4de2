"""``condvln show``: print episodes of a snapshot or an export with text, tree, truths and paths; draw each from above.

Scenes without navmesh publish instructions that no episode was placed for: text, tree and truths are shown of them. An
export holds no furniture: its pictures have the floor, the start, and the way to every leaf.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator, Mapping, Sequence
from functools import partial, reduce
from pathlib import Path
from typing import Any, Final, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.picture import draw_episode
from condvln.export.splits import OBSERVED, observability_class
from condvln.instructions.programs import program_tree, programs_from_table
from condvln.manifest import ManifestLine, manifest_lines, manifest_paths, published_row
from condvln.navigation.navmesh_file import read_navmesh
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.scene import Scene
from condvln.sources.source import hash_file
from condvln.world import World, open_world
from factory.snapshot import Snapshot
from jobs.pipeline import open_configured
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import CondVLNError, FormatError, UsageError
from schemas.program import CATEGORIES, Program

__all__ = ["episode_lines", "named_rows", "show_episodes", "show_export", "spread", "world_of"]

Item = TypeVar("Item")

_INSTRUCTION_COLUMNS: Final = (
    "scene_id", "instruction_id", "group_id", "category", "composition", "gold_leaf", "n_leaves", "moves", "leads",
    "words", "text",
)  # fmt: skip
# Ids are hashes, or made of hashes: taking them in their order is a sample that is the same every time.
_SAMPLED: Final = (("episodes", "episode_id", None), ("instructions", "instruction_id", list(_INSTRUCTION_COLUMNS)))


def show_episodes(
    config: Config, *, episode: str | None = None, sample: int | None = None, picture: Path | None = None
) -> Report:
    """Show the episode whose id is (or begins with) `episode`, or a sample spread evenly over categories, then sources.

    An id may be that of an instruction, and of a source without episodes of a category a sample has instructions.

    picture : folder for a PNG of each episode; needs the sources' files
    """
    snapshot = published(config)
    rows = _chosen(snapshot, episode, sample or (0 if episode else 1))
    programs = _programs(snapshot, rows)
    report = Report({"episodes": []})
    for row in rows:
        program = programs[row["source"], row["instruction_id"]]
        tree = program_tree(program)
        report.document["episodes"].append({**row, "program": program.model_dump(mode="json"), "tree": tree})
        placed = row["episode_id"] is not None
        report.lines.extend(episode_lines(row, tree) if placed else _instruction_lines(row, tree))
        if picture is not None and placed:
            world = world_of(config, row)
            report.lines.append(f"  picture: {world.draw_row(row, program, _picture(picture, row))}")
        report.lines.append("")
    return report


def _chosen(snapshot: Snapshot, name: str | None, sample: int) -> list[dict[str, Any]]:
    if name is not None:
        rows = named_rows(snapshot, name)
        if not rows:
            raise UsageError(
                f"no episode and no instruction {name!r}", remedy="condvln show CONFIG --sample 5 lists some."
            )
        return rows
    first: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for source in snapshot.manifest.tables["instructions"].partitions:
        for table, by, columns in _SAMPLED:
            if source not in snapshot.manifest.tables[table].partitions:
                continue
            rows = snapshot.table(table, columns, source, partial(_first, sample=sample, by=by)).sort_by(by)
            for category in CATEGORIES:
                found = rows.filter(pc.equal(rows["category"], category)).slice(0, sample)
                if found.num_rows and (category, source) not in first:
                    first[category, source] = found.to_pylist() if table == "episodes" else _unplaced(found)
    if not first:
        raise UsageError("the snapshot holds no episodes and no instructions", remedy="Its rejections table says why.")
    return spread(first, sample)


def _first(rows: pa.Table, sample: int, by: str) -> pa.Table:
    """Return the rows of a file with the smallest ids in the column `by`, so many of each category."""
    found = [rows.schema.empty_table()]  # an empty slice would hold all rows in memory
    for category in CATEGORIES:
        of_category = rows.filter(pc.equal(rows["category"], category))
        least = pc.select_k_unstable(of_category, min(sample, of_category.num_rows), [(by, "ascending")])
        found.append(of_category.take(least))
    return pa.concat_tables(found)


def _beginning(rows: pa.Table, name: str) -> pa.Table:
    """Return the rows of a file with an id, of the episode or its instruction, that begins with `name`."""
    columns = [name for name in ("episode_id", "episode_hash", "instruction_id") if name in rows.column_names]
    masks = [pc.starts_with(pc.cast(rows[column], pa.string()), name) for column in columns]
    return rows.filter(reduce(pc.or_, masks))


def named_rows(snapshot: Snapshot, name: str) -> list[dict[str, Any]]:
    """Return the rows of the episodes whose id begins with `name`. If there are none, return the rows of all episodes
    of the instructions whose id begins with `name`; an instruction without episodes is returned itself.
    """
    episodes = snapshot.table("episodes", narrowed=partial(_beginning, name=name))
    for column in ("episode_id", "episode_hash"):
        ids = pc.cast(episodes[column], pa.string())
        for matches in (pc.equal, pc.starts_with):
            rows: list[dict[str, Any]] = episodes.filter(matches(ids, name)).to_pylist()
            if rows:
                return rows
    rows = []
    for source in sorted(snapshot.manifest.tables["instructions"].partitions):
        for instruction in _unplaced(
            snapshot.table("instructions", [*_INSTRUCTION_COLUMNS], source, partial(_beginning, name=name))
        ):
            placed = []
            if episodes.num_rows:
                same = pc.equal(episodes["instruction_id"], instruction["instruction_id"])
                placed = episodes.filter(pc.and_(same, pc.equal(episodes["source"], source))).to_pylist()
            rows += placed or [instruction]
    return rows


def _unplaced(instructions: pa.Table) -> list[dict[str, Any]]:
    """Return rows of instructions in the form of rows of episodes, each with the reason why it has no episode."""
    rows = [{"episode_id": None, "no_episode": "no navmesh", **row} for row in instructions.to_pylist()]
    return [{**row, "instruction_text": row.pop("text")} for row in rows]


def spread(first: Mapping[tuple[str, str], Sequence[Item]], sample: int) -> list[Item]:
    """Choose `sample` items, evenly over categories, and within each category evenly over sources.

    Where a source has no more, the others go on; where a category has none, the other categories do. Each category
    begins with another source, so that a small sample is of several sources too.
    """
    queues: list[list[Item]] = []
    for number, category in enumerate(CATEGORIES):
        of_sources = [first[key] for key in sorted(first) if key[0] == category]
        begin = number % max(len(of_sources), 1)
        of_sources = of_sources[begin:] + of_sources[:begin]
        longest = max(map(len, of_sources), default=0)
        queues.append([items[k] for k in range(longest) for items in of_sources if k < len(items)])
    picked = [queue[k] for k in range(sample) for queue in queues if k < len(queue)]
    return picked[:sample]


def _of_instructions(rows: pa.Table, wanted: pa.Array) -> pa.Table:
    return rows.filter(pc.is_in(rows["instruction_id"], value_set=wanted))


def _programs(snapshot: Snapshot, rows: list[dict[str, Any]]) -> dict[tuple[str, str], Program]:
    found = {}
    for source in sorted({row["source"] for row in rows}):
        wanted = pa.array([row["instruction_id"] for row in rows if row["source"] == source], pa.string())
        kept = snapshot.table("instructions", partition=source, narrowed=partial(_of_instructions, wanted=wanted))
        found.update({(source, name): program for name, program in programs_from_table(kept)})
    return found


def _seen(row: dict[str, Any]) -> str:
    """Return the observability class of an episode with what it means; "not told" for a row without observability."""
    found = observability_class(row.get("observability"), row.get("evidence_in_view"))
    return "not told" if found is None else f"{found} ({OBSERVED[found]})"


def episode_lines(row: dict[str, Any], tree: str) -> list[str]:
    """Format a row of the episodes table, and the tree of its program, as lines."""
    lines = [
        f"{row['source']}/{row['scene_id']} · {row['category']} · {row['composition']} · {_seen(row)} · "
        f"episode {row['episode_id']}",
        f"  “{row['instruction_text']}”",
        *("  " + line for line in tree.splitlines()),
    ]
    for leaf in row["leaves"]:
        mark = "★" if leaf["leaf"] == row["gold_leaf"] else " "
        lines.append(
            f"  {mark} leaf {leaf['leaf']}: {leaf['object_id']}, {len(leaf['subgoals'])} subgoals, "
            f"{leaf['geodesic_distance']:.2f} m direct, {leaf['route_length']:.2f} m by its stops"
        )
    if row.get("looking_path"):
        decided = ", ".join(map(str, row["looking_decided"]))
        lines.append(
            f"  looking path {row['looking_length']:.2f} m, {len(row['looking_actions'])} actions; conditions of the "
            f"gold route decided after {decided}"
        )
    start = row["start_position"]
    lines.append(
        f"  start ({start['x']:.2f}, {start['y']:.2f}, {start['z']:.2f}) facing {row['start_heading_degrees']:.0f}°, "
        f"success within {row['success_distance']} m, at most {row['max_steps']} steps"
    )
    return lines


def _instruction_lines(row: dict[str, Any], tree: str) -> list[str]:
    """Format an instruction without episodes as lines. It has no start, no heading and no paths."""
    return [
        f"{row['source']}/{row['scene_id']} · {row['category']} · {row['composition']} · "
        f"instruction {row['instruction_id']} · no episode: {row['no_episode']}",
        f"  “{row['instruction_text']}”",
        *("  " + line for line in tree.splitlines()),
    ]


def world_of(config: Config, row: Mapping[str, Any]) -> World:
    """Open the scene of an episode with its surfaces, from the first source of the configuration that has it.

    Raises
    ------
    CondVLNError : no source has the scene, or its files can't be read
    """
    fault: CondVLNError = UsageError("no source of the configuration has the scene", remedy="Put its files back.")
    for configured in config.sources:
        if configured.family != row["source"]:
            continue
        asked = configured.model_copy(update={"scenes": (row["scene_id"],), "exclude": ()})
        try:
            return open_world(open_configured(config, asked, hash_file), row["scene_id"], config.agent)
        except CondVLNError as error:
            fault = error
    raise fault


def _picture(folder: Path, row: Mapping[str, Any]) -> Path:
    """Return the file to draw an episode to, in a folder that is then there."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{row['episode_id']}.png"


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
    found = [line.row() for line in _lines_shown(export, episode, sample or 1)]
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
        report.lines.extend(episode_lines(shown, tree))
        if picture is not None:
            navmesh = NavmeshFolder((export, *roots)).path(row.navmesh, row.navmesh_sha256, f"episode {row.episode_id}")
            bare = Scene(row.source, row.scene_id, export, (), ())
            path, floor = _picture(picture, shown), read_navmesh(navmesh).tile.outlines()
            draw_episode(path, bare, floor, shown, tree, program=row.program)
            report.lines.append(f"  picture: {path}")
        report.lines.append("")
    return report


def _lines_shown(export: Path, episode: str | None, sample: int) -> list[ManifestLine]:
    """Return the manifest lines whose id or hash is `episode` or, if there are none, those whose id or hash begins with
    `episode`. If `episode` is None, return `sample` lines, spread evenly over categories and sources; each category and
    source gives the lines with its first ids.
    """
    found: list[ManifestLine] = []
    exact: list[ManifestLine] = []
    first: dict[tuple[str, str], list[tuple[str, ManifestLine]]] = {}
    for line in _lines(export):
        fields = line.fields()
        category, source = fields.get("category"), fields.get("source")
        if not isinstance(category, str) or not isinstance(source, str):
            raise FormatError(
                "not a manifest row", where=line.path, place=f"line {line.number}", remedy="Export the split again"
            )
        number, hashed = line.ids()
        name = str(number)
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
