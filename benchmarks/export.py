"""Export: episodes per second and core with all variants and ground truth, peak memory, and a comparison of gzip
coders.

``python -c "from benchmarks.export import main; main()" 1000000`` exports a million.
"""

from __future__ import annotations

import gzip
import json
import resource
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson
import pyarrow as pa
from isal import igzip

from condvln.episodes.identity import numeric_id
from condvln.export.snapshot import export_snapshot
from condvln.export.tables import rows_of
from condvln.export.tokens import Vocabulary
from condvln.export.vlnce import ground_truth, scene_file, vlnce_episode
from condvln.formats.streams import GZIP_LEVEL
from schemas.tables import SCENES
from tests.made_snapshot import MemoryTables, made_scene, made_snapshot

EPISODES = 20_000
PER_SCENE = 600
"""Number of episodes of one made scene, which is repeated under other names."""
LOOPED = 600
"""Number of episodes of the loop with plain libraries."""


@dataclass(frozen=True)
class Repeated:
    """A snapshot of any size, from one scene's rows under new ids; it holds no copies."""

    scene: MemoryTables
    scenes: int
    id: str = "repeated"
    sources: tuple[str, ...] = ("procthor",)

    def batches(self, table: str, source: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """See ``FolderTables``."""
        for number in range(self.scenes):
            name = f"house_{number:07d}"
            if table == "scenes":
                rows = pa.Table.from_pylist([made_scene(name)], SCENES)
            else:
                rows = self._renamed(self.scene.tables[source][table], name)
            yield from rows.select(list(columns) if columns else rows.schema.names).to_batches(max_chunksize=1024)

    @staticmethod
    def _renamed(rows: pa.Table, name: str) -> pa.Table:
        for key in ("scene_id", "episode_hash", "instruction_id", "group_id", "instruction_text"):
            if key not in rows.schema.names:
                continue
            at = rows.schema.get_field_index(key)
            if key == "scene_id":
                values: pa.Array = pa.array([name] * rows.num_rows)
            else:
                values = pa.array(
                    [None if v is None else f"{v} {name}" for v in rows.column(key).to_pylist()], pa.string()
                )
            rows = rows.set_column(at, rows.schema.field(key), values)
        if "episode_hash" in rows.schema.names:
            numbers = pa.array([numeric_id(own) for own in rows.column("episode_hash").to_pylist()], pa.int64())
            rows = rows.set_column(rows.schema.get_field_index("episode_id"), rows.schema.field("episode_id"), numbers)
        return rows


def linear_text(episode: dict[str, Any], instruction: dict[str, Any]) -> str:
    """Return the text of an oracle twin."""
    moves = instruction["leaves"][instruction["gold_leaf"]]["moves"]
    return "Walk to the " + ", then to the ".join(move["label"] for move in moves) + "."


def main() -> None:
    """Print the figures of one run."""
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else EPISODES
    scene = made_snapshot({"procthor": ["house"]}, per_category=PER_SCENE // 6)
    _compare_coders(scene)
    plain = _plain_rate(scene)
    tables = Repeated(scene, -(-episodes // PER_SCENE))
    with tempfile.TemporaryDirectory() as folder:
        wall, cpu = time.perf_counter(), time.process_time()
        report = export_snapshot(tables, Path(folder), oracle_text=linear_text)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        size = sum(file.bytes for file in report.files.values()) / 1e6
    pool = tables.scenes * PER_SCENE
    written = sum(report.episodes.values())
    # The rows are made while they are read, in the same process: that cost is not part of an export.
    began = time.process_time()
    for table in ("instructions", "episodes", "instructions", "episodes", "instructions", "episodes"):
        for _ in tables.batches(table, "procthor"):
            pass
    making = time.process_time() - began
    net = cpu - making
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"pool of {pool} episodes, {written} exported, {size:.0f} MB: {wall:.0f} s, {cpu:.0f} s of one core")
    print(f"  {written / net:.0f} episodes/s a core with all variants and ground truth (aim: 1500)")
    print(f"  selection, two passes and writing; {making:.0f} s of making the rows taken off")
    print(
        f"  plain json and gzip, stock variant only: {plain:.0f} episodes/s: {written / net / plain:.1f} times as fast"
    )
    print(f"  peak memory {peak:.0f} MiB (aim: 1024)")


def _documents(scene: MemoryTables) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    rows = rows_of(scene.tables["procthor"]["episodes"])
    vocabulary = Vocabulary.of(row["instruction_text"] for row in rows)
    return [
        (
            vlnce_episode(row, scene_file("procthor", row["scene_id"]), vocabulary.padded(row["instruction_text"])),
            ground_truth(row),
        )
        for row in rows
    ]


def _compare_coders(scene: MemoryTables) -> None:
    data = b",".join(orjson.dumps(part) for pair in _documents(scene) for part in pair)
    print(f"gzip of {len(data) / 1e6:.1f} MB of episodes and ground truth (in use: zlib {GZIP_LEVEL}):")
    for name, pack in [
        *((f"zlib {level}", lambda block, level=level: zlib.compress(block, level)) for level in (1, 4, 6, 9)),
        *((f"igzip {level}", lambda block, level=level: igzip.compress(block, level)) for level in (0, 1, 2, 3)),
    ]:
        began = time.process_time()
        packed = pack(data)
        took = time.process_time() - began
        print(f"  {name}: {len(data) / took / 1e6:6.0f} MB/s, {len(packed) / len(data):.3f} of the size")


def _plain_rate(scene: MemoryTables) -> float:
    """Return the episodes per second of plain libraries that write the same files, from decoded rows."""
    documents = _documents(scene)[:LOOPED]
    rows = scene.tables["procthor"]["episodes"].slice(0, len(documents))
    began = time.process_time()
    lines = [json.dumps(row) for row in rows.to_pylist()]
    for _ in ("vlnce", "ansr", "oracle"):
        gzip.compress(json.dumps({"episodes": [episode for episode, _ in documents]}).encode())
        gzip.compress(json.dumps({episode["episode_id"]: truth for episode, truth in documents}).encode())
    return len(lines) / (time.process_time() - began)


if __name__ == "__main__":
    main()
