"""Apartments of which each layout has five stagings, as RoboTHOR has them, pass the bias gate."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from condvln.bias import judge_export
from condvln.bias.report import ALL, PRESENCE
from jobs.generate import run_generate
from schemas.config.run import SplitsConfig
from tests.jobs.conftest import made_config


@pytest.mark.soak
def test_no_guesser_beats_chance_on_twenty_five_made_stagings(tmp_path: Path) -> None:
    config = made_config(tmp_path, "robothor", 25, 0, episodes=12, splits=SplitsConfig(bias="fail"))
    report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
    assert report.exit_code == 0, json.dumps(report.document["export"], default=str)[:2000]
    found = judge_export(tmp_path / "export")
    assert found.passed, found.verdict()
    assert found.episodes > 40 * 25
    asked = {f.guesser: f.episodes for f in found.findings if f.part == ALL}
    assert min(asked["whole statement"], asked["statement in its layout"]) > 600
    assert PRESENCE in {f.predicate for f in found.findings}
