"""A source that is published in many files is exported, proven and shown as one in a single file."""

from __future__ import annotations

import hashlib
import io
from functools import partial
from itertools import pairwise
from pathlib import Path

import pyarrow.parquet as pq
from rich.console import Console

from condvln.samples import make_samples
from factory.executor import InlineExecutor
from factory.run import run
from factory.store import LocalStore
from jobs.export import export_snapshot_of
from jobs.generate import run_generate
from jobs.pipeline import build_pipeline, listed_units
from jobs.show import _first, show_episodes
from jobs.verify import verify_export
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.config.run import SplitsConfig
from schemas.program import CATEGORIES


def episodes_of(folder: Path) -> dict[str, str]:
    """Return the hash of each file of an export that holds episodes, texts or ground truths."""
    found = [path for path in folder.rglob("*") if path.suffix in (".gz", ".jsonl") and path.is_file()]
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def test_an_export_does_not_depend_on_the_size_of_files(tmp_path: Path) -> None:
    """Scenes are spread over files by a hash of their names, so that those of a file are not neighbours."""
    make_samples(tmp_path / "data", family="replicacad", scenes=8, seed=1)

    def config(name: str) -> Config:
        return Config(
            name="parts",
            store=str(tmp_path / name / "store"),
            export=tmp_path / name / "export",
            sources=(SourceConfig(family="replicacad", root=tmp_path / "data"),),
            instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 2)),
            splits=SplitsConfig(bias="warn"),
        )

    whole, parts = config("whole"), config("parts")
    assert run_generate(whole, inline=True, console=Console(file=io.StringIO())).exit_code == 0
    store = LocalStore(tmp_path / "parts" / "store")
    run(build_pipeline(parts), listed_units(parts), store, parts.name, InlineExecutor(), part_bytes=100_000)
    assert published(parts).snapshot_id == published(whole).snapshot_id
    files = (tmp_path / "parts" / "store" / "snapshots").glob("*/episodes/source=replicacad/*.parquet")
    scenes = sorted(sorted({*pq.read_table(file, columns=["scene_id"])["scene_id"].to_pylist()}) for file in files)
    assert any(one[-1] > other[0] for one, other in pairwise(scenes))
    assert export_snapshot_of(parts).exit_code == 0
    assert len(episodes_of(tmp_path / "whole/export")) > 8
    assert episodes_of(tmp_path / "parts/export") == episodes_of(tmp_path / "whole/export")
    assert verify_export(parts, tmp_path / "parts/export").exit_code == 0
    shown = show_episodes(whole, sample=9)
    assert show_episodes(parts, sample=9).lines == shown.lines
    # Not all rows are in memory: each file gives no more than what can be shown.
    rows = published(parts).table("episodes", narrowed=partial(_first, sample=1, by="episode_id"))
    assert len(CATEGORIES) <= rows.num_rows <= len(CATEGORIES) * len(scenes)
    for episode in shown.document["episodes"]:
        for name in (episode["episode_id"], episode["episode_hash"][:12], episode["instruction_id"]):
            found = show_episodes(parts, episode=str(name))
            assert found.lines == show_episodes(whole, episode=str(name)).lines
            assert episode in found.document["episodes"]
