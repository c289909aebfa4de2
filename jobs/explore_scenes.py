"""The scenes of an export or a snapshot, one by one, with their episodes as manifest rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from condvln.explorer.episode import UNPUBLISHED
from condvln.explorer.evidence import SceneFacts
from condvln.export.tables import rows_of
from condvln.instructions.programs import programs_from_table
from condvln.manifest import manifest_lines, manifest_paths, manifest_row
from condvln.navigation.navmesh_file import parse_navmesh, read_navmesh
from condvln.navigation.scene_navmesh import NavmeshFolder
from condvln.navigation.tile import NavMeshTile
from condvln.scene import Scene
from condvln.scene.tables import scene_from_tables
from factory.pipeline import Pipeline
from factory.snapshot import Snapshot
from jobs.pipeline import build_pipeline, built_navmeshes
from jobs.workspace import published
from schemas.base import Json as Row
from schemas.config import Config, Thresholds
from schemas.errors import InputError, StoreError
from schemas.program import Program

__all__ = ["ExploredScene", "Scenes", "export_scenes", "snapshot_scenes"]

_TABLES: Final = ("scenes", "rooms", "objects", "relations", "visibility", "instructions", "episodes", "rejections",
                  "funnel")  # fmt: skip


@dataclass(frozen=True, eq=False)
class ExploredScene:
    """A scene with everything that the page shows of it.

    Attributes
    ----------
    scene : rooms and objects; both empty where only an export is there
    tile : its navmesh; None where it is not there
    rows : manifest rows of its episodes, sorted by id
    relations : rows of its relations; None where they are not known
    tables : rows of ``rejections`` and ``funnel`` by name
    seen : rows of ``visibility`` by object id
    candidates : reads the scene's candidate programs by id, which the snapshot does not publish
    """

    scene: Scene
    tile: NavMeshTile | None
    rows: Sequence[Row]
    relations: Sequence[Row] | None = None
    seen: Mapping[str, Row] | None = None
    tables: Mapping[str, Sequence[Row]] | None = None
    thresholds: Thresholds | None = None
    candidates: Callable[[], Mapping[str, Program]] = dict

    @cached_property
    def facts(self) -> SceneFacts | None:
        """Return a look-up of the scene's relations by pairs of objects; None where the relations are not known."""
        return None if self.relations is None else SceneFacts(self.scene, self.relations, self.thresholds)


@dataclass(frozen=True)
class Scenes:
    """The scenes of one page; `scenes` opens them one after the other."""

    title: str
    snapshot: str
    scenes: Callable[[], Iterator[ExploredScene]]


def export_scenes(export: Path, roots: Sequence[Path]) -> Scenes:
    """Return the scenes of an export, sorted. They have a navmesh, and neither rooms nor furniture."""
    by_scene: dict[tuple[str, str], list[Row]] = {}
    snapshot = ""
    for path in manifest_paths(export):
        for line in manifest_lines(path):
            row = line.row().model_dump(mode="json")
            snapshot = snapshot or row["snapshot"]
            by_scene.setdefault((row["source"], row["scene_id"]), []).append(row)

    def scenes() -> Iterator[ExploredScene]:
        folder = NavmeshFolder((export, *roots))
        for (source, scene_id), rows in sorted(by_scene.items()):
            scene = Scene(source, scene_id, export, (), ())
            yield ExploredScene(scene, _shipped(folder, rows[0]), sorted(rows, key=_id))

    return Scenes(export.resolve().name, snapshot, scenes)


def snapshot_scenes(config: Config, export: Path | None) -> Scenes:
    """Return the scenes of the published snapshot, sorted, with the splits of the export where there is one.

    Raises
    ------
    StoreError : nothing is published
    """
    snapshot = published(config)
    splits: dict[str, str] = {}
    for path in manifest_paths(export) if export is not None else ():
        splits.update({str(line.ids()[0]): path.stem for line in manifest_lines(path)})

    def scenes() -> Iterator[ExploredScene]:
        built, pipeline = built_navmeshes(config, snapshot), build_pipeline(config)
        for source in sorted(snapshot.manifest.tables["scenes"].partitions):
            tables = {name: _Sliced(snapshot, name, source) for name in _TABLES}
            roots = [one.root for one in config.sources if one.family == source]
            for scene_id in tables["scenes"].scenes:
                own = {name: table.of(scene_id) for name, table in tables.items()}
                known = {name: own[name] for name in ("scenes", "rooms", "objects")}
                scene = scene_from_tables(known, roots[0] if roots else Path(), family=source)
                tile = _tile(scene, roots, built)
                yield ExploredScene(
                    scene,
                    tile,
                    _rows(own, scene, splits, snapshot.snapshot_id),
                    rows_of(own["relations"]),
                    {row["object_id"]: row for row in rows_of(own["visibility"])},
                    {name: rows_of(own[name]) for name in ("rejections", "funnel")},
                    config.thresholds,
                    partial(_candidates, snapshot, pipeline, f"{source}/{scene_id}"),
                )

    return Scenes(config.name, snapshot.snapshot_id, scenes)


def _candidates(snapshot: Snapshot, pipeline: Pipeline, unit_id: str) -> Mapping[str, Program]:
    """Return a scene's published programs, and examples of rejected ones, by id; none where the store no longer has
    them.
    """
    try:
        table = snapshot.unit_table(unit_id, pipeline, "programs")
    except StoreError:
        return {}
    return dict(programs_from_table(table)) if table.num_rows else {}


class _Sliced:
    """A table of one source, sorted by scene, cut into the rows of each scene."""

    def __init__(self, snapshot: Snapshot, name: str, source: str) -> None:
        table = snapshot.table(name, partition=source) if name in snapshot.manifest.tables else pa.table({})
        self._table = table.drop_columns(["source"]) if table.num_rows else table
        runs = pc.run_end_encode(table["scene_id"].combine_chunks()) if table.num_rows else None
        ends = [] if runs is None else runs.run_ends.to_pylist()
        names = [] if runs is None else runs.values.to_pylist()
        self._runs = dict(zip(names, zip([0, *ends][: len(ends)], ends, strict=True), strict=True))

    @property
    def scenes(self) -> list[str]:
        """Ids of the scenes with rows, sorted."""
        return sorted(self._runs)

    def of(self, scene_id: str) -> pa.Table:
        """Return the rows of one scene."""
        start, end = self._runs.get(scene_id, (0, 0))
        return self._table.slice(start, end - start)


def _rows(own: Mapping[str, pa.Table], scene: Scene, splits: Mapping[str, str], snapshot: str) -> list[Row]:
    instructions = {row["instruction_id"]: row for row in rows_of(own["instructions"])}
    found = []
    for episode in rows_of(own["episodes"]):
        instruction = instructions[episode["instruction_id"]]
        split = splits.get(str(episode["episode_id"]), UNPUBLISHED)
        navmesh = "" if scene.navmesh is None else scene.navmesh.path
        found.append(
            manifest_row(episode, instruction, source=scene.family, split=split, navmesh=navmesh, snapshot=snapshot)
        )
    return sorted(found, key=_id)


def _id(row: Row) -> str:
    return str(row["episode_id"]).rjust(16)


def _tile(scene: Scene, roots: Sequence[Path], built: Callable[[str, Row], bytes | None]) -> NavMeshTile | None:
    navmesh = scene.navmesh
    if navmesh is None:
        return None
    data = built(scene.family, {"scene_id": scene.scene_id, "navmesh_built": navmesh.built})
    if data is not None:
        return parse_navmesh(data, navmesh.path).tile
    for root in roots:
        if (root / navmesh.path).is_file():
            return read_navmesh(root / navmesh.path).tile
    return None


def _shipped(folder: NavmeshFolder, row: Row) -> NavMeshTile | None:
    """Return the navmesh of an export's scene; None where neither the export nor a dataset has it."""
    try:
        return read_navmesh(folder.path(row["navmesh"], row["navmesh_sha256"], row["scene_id"])).tile
    except InputError:
        return None
