"""The pictures of the dataset card: the plan of one episode for each source, drawn by the explorer's code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from condvln.explorer import episode_document, plan_document
from condvln.explorer.picture import plan_picture
from condvln.export.report import CardPicture
from condvln.export.snapshot import NavmeshBytes
from condvln.export.tables import SnapshotTables
from condvln.manifest import ManifestLine, manifest_lines, manifest_paths
from condvln.navigation.navmesh_file import parse_navmesh
from condvln.scene.tables import scene_from_tables
from condvln.sources.family import FAMILIES

__all__ = ["card_pictures"]

Row = Mapping[str, Any]
FOLDER: Final = "pictures"
LOOKED_AT: Final = 40
"""Number of a source's first episodes among which the one with most leaves is chosen."""


def card_pictures(tables: SnapshotTables, navmeshes: NavmeshBytes, export: Path) -> Iterator[CardPicture]:
    """Yield a picture for each source of an export. The pictures depend on the snapshot alone: navmeshes that belong to
    a dataset are not drawn, since the dataset may be missing on this machine. Sources whose terms forbid passing on
    images get no picture.

    Parameters
    ----------
    export : the new folder, in which the manifests are written
    """
    for source, row in sorted(_chosen(export, set(tables.sources)).items()):
        scene_id = row["scene_id"]
        own = {name: _rows(tables, name, source, scene_id) for name in ("scenes", "rooms", "objects")}
        scene = scene_from_tables(own, Path(), family=source)
        data = navmeshes(source, own["scenes"].to_pylist()[0])
        tile = None if data is None else parse_navmesh(data, scene_id).tile
        drawn = plan_picture(plan_document(scene, tile), episode_document(row, parsed=False))
        caption = f"{source}, scene {scene_id}, episode {row['episode_id']}: “{row['instruction_text']}”"
        yield CardPicture(f"{FOLDER}/{source}.svg", caption, drawn)


def _chosen(export: Path, sources: set[str]) -> dict[str, Row]:
    """Return the episode to draw for each source: of the source's first `LOOKED_AT` episodes, the one with the most
    leaves.
    """
    wanted = {source for source in sources if source in FAMILIES and not FAMILIES[source].licensed}
    found: dict[str, list[tuple[int, ManifestLine]]] = {source: [] for source in wanted}
    lines = (line for path in manifest_paths(export) for line in manifest_lines(path))
    for line in lines:
        fields = line.fields()
        source = fields.get("source")
        if source in found and len(found[source]) < LOOKED_AT:
            found[source].append((len(fields["leaves"]), line))
            if all(len(rows) == LOOKED_AT for rows in found.values()):
                break
    chosen = {source: max(rows, key=itemgetter(0))[1] for source, rows in found.items() if rows}
    return {source: line.row().model_dump(mode="json") for source, line in chosen.items()}


def _rows(tables: SnapshotTables, name: str, source: str, scene_id: str) -> pa.Table:
    """Return the rows of one scene."""
    kept: Sequence[pa.RecordBatch] = [
        batch.filter(pc.equal(batch["scene_id"], scene_id)) for batch in tables.batches(name, source)
    ]
    return pa.Table.from_batches(kept)
