"""The export's command: what moved since the last snapshot, R2R where connectivity is, shards on request."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from condvln.export.changelog import CHANGELOG
from jobs.export import export_snapshot_of
from jobs.generate import run_generate
from jobs.report import Report
from schemas.config import Config, InstructionsConfig


def test_a_second_snapshot_tells_what_moved(
    made_run: tuple[Config, Report], made_dataset: Path, tmp_path: Path, configured: Callable[..., Config]
) -> None:
    first, _ = made_run
    shutil.copytree(first.store, tmp_path / "store")
    config = configured(made_dataset, export=tmp_path / "out")
    export_snapshot_of(config)
    assert not (tmp_path / "out" / CHANGELOG).exists()
    more = config.model_copy(update={"instructions": InstructionsConfig(per_category={"simple": 3, "nested": 2})})
    before = json.loads((tmp_path / "out" / "export.json").read_text())
    report = run_generate(more, inline=True)
    after = json.loads((tmp_path / "out" / "export.json").read_text())
    assert after["snapshot"] == report.document["snapshot_id"] != before["snapshot"]
    text = (tmp_path / "out" / CHANGELOG).read_text()
    assert text.startswith(f"# Changelog\n\n## {after['snapshot']}\n\nFrom {before['snapshot']};")
    # the former snapshot is kept, so that generation and choice are told apart
    assert "chosen otherwise" not in text
    assert "newly generated" in text or "was left out before" in text
    # exporting again changes nothing, and a fresh folder is compared with the snapshot published before
    export_snapshot_of(more)
    assert (tmp_path / "out" / CHANGELOG).read_text() == text
    export_snapshot_of(more.model_copy(update={"export": tmp_path / "fresh"}))
    assert (tmp_path / "fresh" / CHANGELOG).read_text() == text
    shutil.rmtree(tmp_path / "store" / "snapshots" / before["snapshot"])
    export_snapshot_of(more.model_copy(update={"export": tmp_path / "alone"}))
    assert not (tmp_path / "alone" / CHANGELOG).exists()
