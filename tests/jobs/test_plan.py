"""What ``condvln plan`` shows: a row a cause, or a row a scene; and that a log keeps a message in one line."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from condvln.samples import make_samples
from jobs.plan import make_plan
from jobs.report import Report, print_report
from schemas.config import Config, SourceConfig

SCENES = 5


def test_scenes_of_one_cause_are_one_row(tmp_path: Path) -> None:
    made = make_samples(tmp_path / "data", family="procthor", scenes=SCENES, seed=2)
    source = SourceConfig(family="procthor", root=tmp_path / "data", scenes=("*", "houses-99"))
    config = Config(name="made", store=tmp_path / "store", sources=(source,))
    document, grouped = make_plan(config).document, make_plan(config).sections[0]
    assert grouped.columns[0] == "scenes"
    counts = {row[1]: row[0] for row in grouped.rows}
    assert counts == document["counts"]
    assert counts["MISSING"] >= SCENES
    assert "houses-99" in next(row[5] for row in grouped.rows if row[1] == "QUARANTINED")
    assert sum(row[4] for row in grouped.rows) == sum(entry["seconds"] for entry in document["scenes"])
    every = make_plan(config, every_scene=True).sections[0]
    assert {row[0] for row in every.rows} == {entry["unit_id"] for entry in document["scenes"]}
    assert len(every.rows) == len(made.scenes) + 1


def test_a_fresh_scene_has_a_row_too(made_run: tuple[Config, Report]) -> None:
    plan = make_plan(made_run[0], every_scene=True)
    assert [row[1] for row in plan.sections[0].rows] == ["FRESH"] * plan.document["counts"]["FRESH"] != []
    assert make_plan(made_run[0]).sections[0].rows == []


def test_a_line_of_a_report_is_one_line_of_a_log() -> None:
    line = "word " * 100  # longer than any console
    log = io.StringIO()
    with contextlib.redirect_stdout(log):
        print_report(Report({}, [line]))
    assert log.getvalue().splitlines() == [line.rstrip()] or log.getvalue().splitlines() == [line]
