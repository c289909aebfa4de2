"""Every test that somebody wrote is run by `make test` or `make soak`.

The tests that exist are read from the syntax trees of the files that git knows; those that run are what pytest collects
for the command lines of the Makefile. Neither list is made from the other.
"""

from __future__ import annotations

import ast
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest

TARGETS = ("test", "soak")

NOT_OF_THE_CHOICE = ("-n", "--dist", "--draws", "--rounds")
"""Options, each with a value, that do not change which tests run."""


def output(command: list[str], folder: Path) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout


def sources(root: Path) -> list[Path]:
    """Python files that are in the repository or would be added to it; without git, those outside hidden folders."""
    if (root / ".git").exists() and shutil.which("git"):
        listed = output(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.py"], root)
        found = [Path(name) for name in listed.split("\0") if name]
    else:
        found = [path.relative_to(root) for path in root.rglob("*.py")]
        found = [path for path in found if not any(part.startswith(".") for part in path.parts)]
    return sorted(path for path in set(found) if (root / path).is_file())


def defined(tree: ast.Module | ast.ClassDef, prefix: str) -> Iterator[str]:
    """Names of the test functions and methods in a module, as node ids have them."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from defined(node, f"{prefix}::{node.name}")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test"):
            yield f"{prefix}::{node.name}"


def written(root: Path) -> tuple[Counter[str], set[str]]:
    """Tests defined anywhere in the repository with how often each, and files that are named as tests are."""
    tests: Counter[str] = Counter()
    files = set()
    for path in sources(root):
        if fnmatch(path.name, "test_*.py") or fnmatch(path.name, "*_test.py"):
            files.add(path.as_posix())
        if path.parts[0] == "tests" or path.as_posix() in files:
            tests.update(defined(ast.parse((root / path).read_bytes()), path.as_posix()))
    return tests, files


def command_lines(root: Path, target: str) -> list[list[str]]:
    """Arguments of each pytest that a target runs."""
    lines = output(["make", "--dry-run", "--always-make", target], root).splitlines()
    return [shlex.split(line.split("-m pytest", 1)[1]) for line in lines if "-m pytest" in line]


def collected(root: Path, lines: list[list[str]]) -> set[str]:
    """Tests that pytest would run for any of some command lines, without their parameters.

    Lines that differ in ``-m`` alone are asked for in one call: collecting takes a quarter of a minute.
    """
    chosen: dict[tuple[str, ...], list[str]] = {}
    for line in lines:
        at = line.index("-m")
        rest = [*line[:at], *line[at + 2 :]]
        for option in NOT_OF_THE_CHOICE:
            if option in rest:
                del rest[rest.index(option) : rest.index(option) + 2]
        chosen.setdefault(tuple(rest), []).append(f"({line[at + 1]})")
    found: set[str] = set()
    for rest, marks in chosen.items():
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *rest, "-m", " or ".join(marks)]
        said = output([*command, "-n", "0", "--collect-only"], root)
        found |= {line.split("[", 1)[0] for line in said.splitlines() if "::" in line}
    return found


def complaints(root: Path) -> list[str]:
    """Tests and files that no target runs, and names that a later definition hides."""
    tests, files = written(root)
    run = collected(root, [line for target in TARGETS for line in command_lines(root, target)])
    found = [f"{test} is not run by any of: make {', make '.join(TARGETS)}" for test in sorted(set(tests) - run)]
    found += [f"{test} is defined {number} times" for test, number in sorted(tests.items()) if number > 1]
    found += [f"{file} holds no test that is run" for file in sorted(files - {test.split("::")[0] for test in run})]
    return found


@pytest.mark.soak  # collecting everything takes a quarter of a minute
def test_every_test_of_the_repository_is_run(repository: Path) -> None:
    tests, files = written(repository)
    assert len(files) > 150
    assert len(tests) > 1000
    assert complaints(repository) == []


def test_ci_runs_the_targets(repository: Path) -> None:
    """Those of all tests, the one in whose environment the heavy packages are installed, and the one with a browser."""
    lines = (repository / ".ci" / "run").read_text().splitlines()
    targets = [line.removeprefix("make ") for line in lines if line.startswith("make ")]
    assert targets == [*TARGETS, "agents", "browser"]
    (line,) = (row for row in output(["make", "--dry-run", "browser"], repository).splitlines() if "-m pytest" in row)
    assert line.startswith("CONDVLN_BROWSER=1 ")
    assert line.endswith(" tests/browser")
    (line,) = (row for row in output(["make", "--dry-run", "agents"], repository).splitlines() if "-m pytest" in row)
    (file,) = (word for word in shlex.split(line) if word.endswith(".py"))
    assert "importorskip" in (repository / file).read_text()
