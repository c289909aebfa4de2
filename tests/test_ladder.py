"""The results that the ladder keeps: a run that was stopped goes on from them, and its tables can be printed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import ladder
from benchmarks.__main__ import chosen

JOBS = [("made/procthor", 0), ("made/replicacad", 0), ("made/procthor", 1)]


def results(job: tuple[str, int], made: Path | None = None) -> list[ladder.Row]:
    """A row of the oracle in each scene but the second, which has no episodes."""
    data, number = job
    if data == "made/replicacad":
        return []
    return [
        ladder.Row("oracle", data, f"s{number}", "simple", "O0", f"e{number}", 1.0, 1.0, 1.0, 1.0, 9.0, "gründlich")
    ]


@pytest.fixture
def walks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[str, int]]:
    """The scenes that are walked; walking takes no time and gives `results`."""
    found: list[tuple[str, int]] = []

    class Pool:
        def __init__(self, workers: int) -> None: ...

        def __enter__(self) -> Pool:
            return self

        def __exit__(self, *error: object) -> None: ...

        def map(self, function: Any, jobs: list[tuple[str, int]]) -> Any:
            for job in jobs:
                found.append(job)
                yield results(job)

    monkeypatch.setattr(ladder, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(ladder, "make_samples", lambda *given, **named: None)
    monkeypatch.setenv("CONDVLN_LADDER_ROWS", str(tmp_path / "rows.jsonl"))
    return found


def test_a_run_that_was_stopped_goes_on_wherever_it_was_cut(walks: list[tuple[str, int]], tmp_path: Path) -> None:
    whole = ladder.walked_all(JOBS)
    assert walks == JOBS
    assert [row.episode for row in whole] == ["e0", "e1"]
    path = tmp_path / "rows.jsonl"
    data = path.read_bytes()
    lines = data.splitlines(keepends=True)
    assert len(lines) == 3, "a header, and the scenes with results"
    for end in range(len(data) + 1):
        walks.clear()
        path.write_bytes(data[:end])
        assert ladder.walked_all(JOBS) == whole
        done = max(data[:end].count(b"\n") - 1, 0)
        # A scene without results is walked again each time.
        assert walks == [JOBS[k] for k in (0, 1, 2) if k == 1 or (k + 1) // 2 >= done]
        assert sorted(path.read_bytes().splitlines()) == sorted(data.splitlines())


def test_tables_of_the_first_scenes_are_printed_without_walking(
    walks: list[tuple[str, int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(ladder, "PAGE", tmp_path / "ladder.md")
    monkeypatch.setattr(ladder, "REAL", tmp_path / "none")
    monkeypatch.setenv("CONDVLN_LADDER_SCENES", "1")
    ladder.main()
    assert walks == [("made/procthor", 0)]
    walks.clear()
    monkeypatch.setenv("CONDVLN_LADDER_SCENES", "3")
    ladder.main()
    assert walks == [("made/replicacad", 0), ("made/procthor", 1)]
    walks.clear()
    monkeypatch.setenv("CONDVLN_LADDER_SCENES", "1")
    capsys.readouterr()
    ladder.main()
    assert walks == []
    assert "1 episodes in 1 scenes: made/procthor." in capsys.readouterr().out
    assert "1 episodes in 1 scenes: made/procthor." in (tmp_path / "ladder.md").read_text(encoding="utf-8")


def test_long_benchmarks_run_by_name_only() -> None:
    assert {"ladder", "evidence", "versus"}.isdisjoint(chosen([]))
    assert {"relations", "readers", "export"} <= {*chosen([])}
    assert chosen(["evidence", "ladder"]) == ["evidence", "ladder"]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "nothing"], env={**os.environ}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "no benchmark nothing" in done.stderr
    assert "evidence" in done.stderr
