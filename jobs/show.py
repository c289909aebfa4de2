"""``condvln show``: print episodes with text, tree, truths and paths, and draw each from above.

Scenes without navmesh publish instructions that no episode was placed for: text, tree and truths are shown of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from pathlib import Path
from typing import Any, Final, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.picture import draw_episode, wall_lines
from condvln.export.axes import observability_class
from condvln.instructions.tables import programs_from_table
from condvln.instructions.tree import program_tree
from condvln.navigation.navmesh_file import NavMeshFile, parse_navmesh, read_navmesh
from condvln.scene import Scene
from condvln.scene.tables import scene_from_tables
from condvln.sources.source import hash_file
from condvln.world import World, open_world
from factory.snapshot import Snapshot
from jobs.pipeline import built_navmeshes, open_configured
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config
from schemas.errors import CondVLNError, UsageError
from schemas.program import CATEGORIES, Program

__all__ = ["episode_lines", "named_rows", "show_episodes", "spread"]

Item = TypeVar("Item")

_INSTRUCTION_COLUMNS: Final = (
    "scene_id", "instruction_id", "group_id", "category", "composition", "gold_leaf", "n_leaves", "moves", "words",
    "text",
)  # fmt: skip


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
        report.extend(episode_lines(row, tree) if placed else _instruction_lines(row, tree))
        if picture is not None and placed:
            path, fault = _draw(config, snapshot, row, tree, program, picture)
            report.lines.append(f"  picture: {path}" + (f", without walls and first view: {fault}" if fault else ""))
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
    # Ids are hashes: taking them in their order is a sample that is the same every time.
    episodes = snapshot.table("episodes", narrowed=partial(_first, sample=sample, by="episode_id"))
    first: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for category in CATEGORIES if episodes.num_rows else ():
        of_category = episodes.filter(pc.equal(episodes["category"], category)).sort_by("episode_id")
        for source in pc.unique(of_category["source"]).to_pylist():
            of_source = of_category.filter(pc.equal(of_category["source"], source))
            first[category, source] = of_source.slice(0, sample).to_pylist()
    for source in snapshot.manifest.tables["instructions"].partitions:
        lacking = [category for category in CATEGORIES if (category, source) not in first]
        least = partial(_first, sample=sample, by="instruction_id")
        table = _instructions(snapshot, source, least) if lacking else pa.table({})
        for category in lacking if table.num_rows else ():
            of_category = table.filter(pc.equal(table["category"], category)).sort_by("instruction_id")
            first[category, source] = _unplaced(of_category.slice(0, sample))
    if not any(first.values()):
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
    columns = {"episode_id", "episode_hash", "instruction_id"} & {*rows.column_names}
    masks = [pc.starts_with(pc.cast(rows[column], pa.string()), name) for column in sorted(columns)]
    return rows.filter(reduce(pc.or_, masks))


def named_rows(snapshot: Snapshot, name: str) -> list[dict[str, Any]]:
    """Return the rows of the episodes whose id begins with `name`. If there are none, return the rows of all episodes
    of the instructions whose id begins with `name`; an instruction without episodes is returned itself.
    """
    episodes = snapshot.table("episodes", narrowed=partial(_beginning, name=name))
    for column in ("episode_id", "episode_hash"):
        if column not in episodes.column_names:  # a snapshot of a former release, whose ids are hashes
            continue
        ids = pc.cast(episodes[column], pa.string())
        for matches in (pc.equal, pc.starts_with):
            rows: list[dict[str, Any]] = episodes.filter(matches(ids, name)).to_pylist()
            if rows:
                return rows
    rows = []
    for source in sorted(snapshot.manifest.tables["instructions"].partitions):
        for instruction in _unplaced(_instructions(snapshot, source, partial(_beginning, name=name))):
            placed = []
            if episodes.num_rows:
                same = pc.equal(episodes["instruction_id"], instruction["instruction_id"])
                placed = episodes.filter(pc.and_(same, pc.equal(episodes["source"], source))).to_pylist()
            rows += placed or [instruction]
    return rows


def _instructions(snapshot: Snapshot, source: str, narrowed: Callable[[pa.Table], pa.Table]) -> pa.Table:
    return snapshot.table("instructions", list(_INSTRUCTION_COLUMNS), source, narrowed)


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
    """Return the observability class of an episode (O0f, O0, O1 or O2); "not told" for a row without observability."""
    if row.get("observability") is None:
        return "not told"
    return str(observability_class(row["observability"], row["evidence_in_view"]))


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
    start = row["start_position"]
    lines.append(
        f"  start ({start['x']:.2f}, {start['y']:.2f}, {start['z']:.2f}) facing {row['start_heading_degrees']:.0f}°, "
        f"τ {row['success_distance']} m, at most {row['max_steps']} steps"
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


def _draw(
    config: Config, snapshot: Snapshot, row: dict[str, Any], tree: str, program: Program, folder: Path
) -> tuple[Path, str]:
    """Draw an episode; return the path of the picture, and the reason why the picture does not show the agent's view at
    the start (an empty text if it shows the view).
    """
    tables = {}
    for name in ("scenes", "rooms", "objects"):
        table = snapshot.table(name, partition=row["source"])
        tables[name] = table.filter(pc.equal(table["scene_id"], row["scene_id"])).drop_columns(["source"])
    roots = [source.root for source in config.sources if source.family == row["source"]]
    scenes = [scene_from_tables(tables, root, family=row["source"]) for root in roots]
    tile = _navmesh(config, snapshot, scenes).tile
    floor = [tile.verts[poly["verts"][: poly["vert_count"]]] for poly in tile.polys]
    world, fault = _world(config, row)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{row['episode_id']}.png"
    walls = None if world is None else wall_lines(world.scene, world.geometry)
    view = None if world is None else world.first_view(row)
    draw_episode(path, scenes[0], floor, row, tree, program=program, walls=walls, view=view)
    return path, fault


def _world(config: Config, row: Mapping[str, Any]) -> tuple[World | None, str]:
    """Return (the scene of a row with the scene's surfaces, an empty text) or, if the scene can't be opened, (None, the
    reason).
    """
    fault = "no source of the configuration has the scene"
    for configured in config.sources:
        if configured.family != row["source"]:
            continue
        asked = configured.model_copy(update={"scenes": (row["scene_id"],), "exclude": ()})
        try:
            return open_world(open_configured(config, asked, hash_file), row["scene_id"], config.agent), ""
        except CondVLNError as error:
            fault = str(error)
    return None, fault


def _navmesh(config: Config, snapshot: Snapshot, scenes: list[Scene]) -> NavMeshFile:
    """Return the navmesh of one scene; `scenes` holds the scene once for each configured folder of its family. A
    navmesh that a run built is read from the store, another from the first of these folders that has the file.
    """
    kept = built_navmeshes(config, snapshot)
    for scene in scenes:
        if scene.navmesh is None:
            continue
        built = kept(scene.family, {"scene_id": scene.scene_id, "navmesh_built": scene.navmesh.built})
        if built is not None:
            return parse_navmesh(built, scene.navmesh.path)
        if (scene.root / scene.navmesh.path).is_file():
            return read_navmesh(scene.root / scene.navmesh.path)
    raise UsageError(
        "the navmesh of this scene is not there", remedy="Put the source's files back: pictures need them."
    )
