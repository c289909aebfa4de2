"""The export's command: what moved since the last snapshot, R2R where connectivity is, shards on request."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from condvln.export.staging import alone_in
from condvln.formats.json_entries import read_unpacked
from jobs.configuration import load_config
from jobs.export import graphs_of, run_export
from jobs.generate import run_generate
from jobs.rebuild import run_rebuild
from jobs.report import Report
from jobs.validate import validate_files
from schemas.config import Config, SplitsConfig
from schemas.errors import CondVLNError, ConfigError, StoreError
from schemas.program import CATEGORIES, SHAPES


def test_shards_groups_and_shortfalls_are_the_configurations(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    config, _ = made_run
    splits = SplitsConfig(sharded=True, scenes={"val_unseen": ("replicacad/*",)}, per_cell=3)
    report = run_export(config.model_copy(update={"export": tmp_path / "out", "splits": splits}))
    counts = report.document["episodes"]
    assert {split for split, count in counts.items() if count} == {"val_unseen"}
    folder = tmp_path / "out" / "vlnce" / "val_unseen"
    assert json.loads(read_unpacked(folder / "val_unseen.json.gz"))["episodes"] == []
    shards = [json.loads(read_unpacked(path))["episodes"] for path in sorted((folder / "content").iterdir())]
    assert all(shards)
    assert sum(map(len, shards)) == counts["val_unseen"]
    assert not [f for f in validate_files(tmp_path / "out" / "vlnce").findings if f.severity == "error"]
    short = report.document["cells"]
    assert sum(cell["shortfall"] for cell in short) + sum(cell["selected"] for cell in short) == 3 * 4 * sum(
        SHAPES[category].leaves for category in CATEGORIES
    )
    count = sum(cell["shortfall"] > 0 for cell in short)
    assert any(line.startswith(f"{count} cells are short") for line in report.lines)


def test_a_category_of_which_nothing_is_kept_is_said_with_why_and_what_to_do(
    made_run: tuple[Config, Report], tmp_path: Path
) -> None:
    config, _ = made_run
    lone = SplitsConfig(max_tokens=None, scenes={"test": ("*/*",)})
    report = run_export(config.model_copy(update={"export": tmp_path / "out", "splits": lone}))
    (section,) = [section for section in report.sections if section.title == "Categories"]
    assert {row[0] for row in section.rows} == {*config.instructions.per_category} < {*CATEGORIES}
    for name, wanted, placed, kept, reasons in section.rows:
        assert wanted > 0 < placed >= kept == report.document["shapes"]["test"]["category"].get(name, 0)
        assert placed - kept == sum(report.document["lost"].get(name, {}).values())
        assert bool(reasons) is (placed > kept)
    none = run_export(
        config.model_copy(update={"export": tmp_path / "none", "splits": SplitsConfig(max_tokens=30, bias="off")})
    )
    lost = [line for line in none.lines if line.startswith("WARNING: no episode of")]
    gone = [row for row in none.sections[1].rows if not row[3]]
    assert len(lost) == len(gone) > 0
    assert any("more tokens than an agent reads" in line and "use more scenes" in line for line in lost)


def test_connectivity_is_where_the_configuration_says(tmp_path: Path) -> None:
    source = {"family": "mp3d", "root": "scans", "connectivity": "graphs"}
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps({"name": "a", "store": "store", "sources": [source]}))
    (tmp_path / "scans" / "connectivity").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"sources\.0\.connectivity"):
        load_config(path, environment={})
    (tmp_path / "graphs").mkdir()
    for folder, scan in (("graphs", "a"), ("scans/connectivity", "b")):
        (tmp_path / folder / f"{scan}_connectivity.json").write_text("[]")
    config = load_config(path, environment={})
    assert list(graphs_of(config)) == ["a"]
    (bare,) = config.sources
    sources = (bare.model_copy(update={"connectivity": None}),)
    assert list(graphs_of(config.model_copy(update={"sources": sources}))) == ["b"]


def test_one_export_at_a_time_writes_a_folder(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    """Two would write the same provisional files, and one's half could end under the other's final name."""
    config = made_run[0].model_copy(update={"export": tmp_path / "out"})
    run_export(config)
    before = {path: path.read_bytes() for path in sorted((tmp_path / "out").rglob("*")) if path.is_file()}
    with (
        alone_in(tmp_path / "out"),
        pytest.raises(StoreError, match=r"another .* is writing this folder"),
    ):
        run_export(config)
    run_export(config)  # and who is done holds it no more
    assert before == {path: path.read_bytes() for path in sorted((tmp_path / "out").rglob("*")) if path.is_file()}


def test_the_folder_is_held_before_any_scene_is_made(
    made_dataset: Path, tmp_path: Path, configured: Callable[..., Config]
) -> None:
    """Else the second of two runs does all its work and then learns that it was for nothing."""
    config = configured(made_dataset, export=tmp_path / "out")
    with alone_in(tmp_path / "out"):
        for start in (run_generate, run_rebuild):
            with pytest.raises(StoreError, match="Wait until it is done"):
                start(config, inline=True)
    assert not (Path(config.store) / "units").exists()
    assert not (tmp_path / ".out.lock").exists()


def test_a_killed_holder_blocks_nobody(tmp_path: Path) -> None:
    (tmp_path / ".out.lock").touch()
    with alone_in(tmp_path / "out"):
        assert (tmp_path / ".out.lock").exists()
    assert [*tmp_path.iterdir()] == []


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="Choose another export folder"), alone_in(tmp_path / "file" / "out"):
        raise AssertionError("held")


def test_a_missing_partition_of_a_snapshot_is_refused(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    store = Path(shutil.copytree(made_run[0].store, tmp_path / "store"))
    (folder,) = store.glob("snapshots/*/instructions/source=*")
    shutil.rmtree(folder)
    with pytest.raises(CondVLNError, match=r"instructions/source=.*: the file is missing"):
        run_export(made_run[0].model_copy(update={"store": store, "export": tmp_path / "out"}))
    assert not (tmp_path / "out").exists()


def test_a_snapshot_with_fewer_rows_than_it_says_stays(made_run: tuple[Config, Report], tmp_path: Path) -> None:
    store = Path(shutil.copytree(made_run[0].store, tmp_path / "store"))
    config = made_run[0].model_copy(update={"store": store, "export": tmp_path / "out"})
    part = next(store.glob("snapshots/*/episodes/*/part-*.parquet"))
    table = pq.ParquetFile(part).read()
    pq.write_table(table.slice(1), part)
    with pytest.raises(CondVLNError, match=r"episodes.*differ from their recorded hash"):
        run_export(config)
    data = part.read_bytes()
    part.write_bytes(data[:100] + b"?" * (len(data) // 2) + data[100 + len(data) // 2 :])
    with pytest.raises(CondVLNError, match="rebuild"):
        run_export(config)
    assert not (tmp_path / "out").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store"]
