"""Every test that somebody wrote is run by a target of the Makefile, and CI runs the targets."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
from pathlib import Path


def recipe(repository: Path, target: str) -> list[list[str]]:
    """Words of each pytest that a target runs."""
    command = ["make", "--dry-run", "--always-make", target]
    printed = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True).stdout
    return [shlex.split(line) for line in printed.splitlines() if "-m pytest" in line]


def test_every_test_of_the_repository_is_run(repository: Path) -> None:
    """Each is in a file that pytest collects, and has a mark that one of two targets asks for."""
    for path in (repository / "tests").rglob("*.py"):
        names = [node.name for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.FunctionDef)]
        assert path.name.startswith("test_") or not any(name.startswith("test_") for name in names), path
    assert [words[-1] for words in recipe(repository, "test")] == ["not soak"]
    assert "soak or costly" in recipe(repository, "soak")[0]


def test_ci_runs_the_targets(repository: Path) -> None:
    """Those of all tests, the one in whose environment the heavy packages are installed, and the one with a browser."""
    lines = (repository / ".ci" / "run").read_text().splitlines()
    targets = [line.removeprefix("make ") for line in lines if line.startswith("make ")]
    assert targets == ["test", "soak", "agents", "browser"]
    ((variable, *_, folder),) = recipe(repository, "browser")
    assert (variable, folder) == ("CONDVLN_BROWSER=1", "tests/browser")
    (words,) = recipe(repository, "agents")
    files = [word for word in words if word.endswith(".py")]
    assert len(files) == 2
    assert all("importorskip" in (repository / file).read_text() for file in files)


def test_the_wheel_holds_every_file_of_its_packages(repository: Path) -> None:
    text = (repository / "pyproject.toml").read_text()
    (section,) = re.findall(r"^\[tool\.setuptools\.package-data\]\n(.*?)\n\[", text, re.M | re.S)
    patterns = {name: ast.literal_eval(listed) for name, listed in re.findall(r"^(\w+) = (\[.*\])$", section, re.M)}
    assert [*patterns] == ["schemas", "factory", "jobs", "condvln"]
    for package, own in patterns.items():
        packed = {path for pattern in own for path in (repository / package).glob(pattern)}
        data = {
            path for path in (repository / package).rglob("*") if path.is_file() and "__pycache__" not in path.parts
        }
        assert {path for path in data - packed if path.suffix != ".py"} == set()
