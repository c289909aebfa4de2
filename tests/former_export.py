"""Exports and snapshots as the release before integer ids wrote them: an episode's id was the hash of its content."""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa

from condvln.export.tables import MemoryTables


def former_export(export: Path, out: Path) -> Path:
    """A copy of an export with hashes as ids and no ``episode_hash`` anywhere."""
    shutil.copytree(export, out, dirs_exist_ok=True)
    hashes: dict[str, str] = {}
    for path in sorted((out / "manifest").glob("*.jsonl")):
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        for row in rows:
            hashes[str(row["episode_id"])] = row["episode_hash"]
            row["episode_id"] = row.pop("episode_hash")
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    for path in sorted(out.glob("*/*/**/*.json.gz")):
        document = json.loads(gzip.decompress(path.read_bytes()))
        if "episodes" in document:
            for episode in document["episodes"]:
                episode["episode_id"] = episode["trajectory_id"] = hashes[str(episode["episode_id"])]
                del episode["info"]["episode_hash"]
        else:
            document = {hashes[name]: truth for name, truth in document.items()}
        path.write_bytes(gzip.compress(json.dumps(document).encode(), mtime=0))
    return out


def former_tables(tables: MemoryTables) -> MemoryTables:
    """The same snapshot with hashes as ids."""
    found: dict[str, Any] = {}
    for source, named in tables.tables.items():
        episodes = named["episodes"]
        hashes = episodes["episode_hash"]
        at = episodes.schema.get_field_index("episode_id")
        former = episodes.drop_columns(["episode_hash"]).set_column(at, pa.field("episode_id", pa.string()), hashes)
        found[source] = {**named, "episodes": former}
    return MemoryTables(tables.id, found)
