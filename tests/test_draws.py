"""Draws: the same for everyone by default, fresh and repeatable on request, whatever else the process has done."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import os
from hypothesis import given, settings, strategies as st

FILE = os.environ["DRAWN"]

@given(st.integers(), st.floats(), st.text(max_size=5))
@settings(max_examples=40)
def test_one(number, share, text):
    with open(FILE, "a") as file:
        file.write(f"one {number!r} {share!r} {text!r}\\n")

@given(st.integers(0, 10**9))
def test_two(drawn):
    with open(FILE, "a") as file:
        file.write(f"two {drawn!r}\\n")

@given(st.integers())
def test_sum(number):
    assert os.environ.get("BROKEN") is None or number < 1000
"""


@pytest.fixture
def project(tmp_path: Path, repository: Path) -> Path:
    """A project of a module with constants of its own and three properties, under our conftest's plugin."""
    (tmp_path / "local.py").write_text("NUMBERS = " + repr([7 * k + 1_000_003 for k in range(500)]) + "\n")
    (tmp_path / "test_drawing.py").write_text(TESTS)
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["tests.draws"]\n')
    return tmp_path


def drawn(project: Path, repository: Path, *options: str, **environment: str) -> tuple[str, str]:
    """What the properties drew, and what was printed."""
    file = project / "drawn"
    file.unlink(missing_ok=True)
    kept = {name: value for name, value in os.environ.items() if name not in ("CI", "PYTHONHASHSEED")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--rootdir={project}", *options]
    variables = {**kept, "PYTHONPATH": f"{repository}{os.pathsep}{project}", "DRAWN": str(file), **environment}
    done = subprocess.run(command, cwd=project, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == (1 if "BROKEN" in environment else 0), done.stdout + done.stderr
    return file.read_text(), done.stdout


def seed_in(said: str) -> str:
    """Return the seed that a run printed."""
    found = re.search(r"--draws (\d+)", said)
    assert found is not None, said
    return found[1]


def test_by_default_everyone_draws_the_same(project: Path, repository: Path) -> None:
    first, said = drawn(project, repository)
    assert "the same examples in every run" in said
    assert len(set(first.splitlines())) > 100
    assert drawn(project, repository, CI="true", PYTHONHASHSEED="1")[0] == first
    # Hypothesis would draw from the constants of this module, once it is loaded.
    assert drawn(project, repository, "-p", "local")[0] == first
    one = [line for line in first.splitlines() if line.startswith("two")]
    assert drawn(project, repository, "-k", "two")[0].splitlines() == one


@pytest.mark.soak  # ten seconds and more: each run is a process of its own
def test_fresh_draws_differ_and_can_be_repeated(project: Path, repository: Path) -> None:
    first, said = drawn(project, repository, "--draws", "fresh", CI="true")
    second, _ = drawn(project, repository, "--draws", "fresh", CI="true")
    assert first != second
    seed = seed_in(said)
    assert drawn(project, repository, "--draws", seed, "-p", "local")[0] == first
    # The processes of pytest-xdist draw from the same seed.
    assert sorted(drawn(project, repository, "--draws", seed, "-n", "2")[0].splitlines()) == sorted(first.splitlines())


@pytest.mark.soak  # ten seconds and more: each run is a process of its own
def test_each_round_has_a_seed_of_its_own(project: Path, repository: Path) -> None:
    rounds, said = drawn(project, repository, "--draws", "7", "--rounds", "3")
    assert "9 passed" in said
    alone = [drawn(project, repository, "--draws", str(seed))[0].splitlines() for seed in (7, 8, 9)]
    assert sorted(rounds.splitlines()) == sorted(line for lines in alone for line in lines)
    assert alone[0] != alone[1]


def test_a_failure_says_how_to_repeat_it(project: Path, repository: Path) -> None:
    _, said = drawn(project, repository, "--draws", "7", BROKEN="1")
    assert "repeat a failing test with `pytest --draws 7" in said
    assert "reproduce_failure" in said


@pytest.mark.parametrize("options", [("--draws", "1.5"), ("--rounds", "3"), ("--draws", "3", "--rounds", "0")])
def test_wrong_options_end_the_run(project: Path, repository: Path, options: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "pytest", f"--rootdir={project}", *options]
    variables = os.environ | {"PYTHONPATH": str(repository), "DRAWN": str(project / "drawn")}
    done = subprocess.run(command, cwd=project, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "--draws" in done.stderr
