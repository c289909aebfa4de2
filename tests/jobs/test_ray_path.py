"""Ray does the work of more than one worker, by its public names, and nothing else starts processes for it."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from factory.ray_executor import RayExecutor
from jobs.executor import open_executor
from schemas.config import RayConfig

PACKAGES = ("schemas", "condvln", "factory", "jobs")


@cache
def imports(file: Path) -> frozenset[str]:
    """Every module and name that a file imports, dotted."""
    return frozenset(_imports(file))


def _imports(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def file_of(repository: Path, module: str) -> Path | None:
    path = repository.joinpath(*module.split("."))
    found = (path.with_suffix(".py"), path / "__init__.py")
    return next((one for one in found if one.is_file()), None)


def reached(repository: Path, module: str) -> dict[str, set[str]]:
    """What each file imports that a module reaches, by the file's path."""
    found: dict[str, set[str]] = {}
    ahead = [module]
    while ahead:
        file = file_of(repository, ahead.pop())
        if file is not None and str(file) not in found:
            names = found[str(file)] = {*imports(file)}
            ahead += [name for name in names if name.split(".")[0] in PACKAGES]
    return found


@pytest.mark.parametrize("verb", ["jobs.generate", "jobs.rebuild", "jobs.verify", "jobs.trajectories"])
def test_the_path_of_a_verb_reaches_ray(repository: Path, verb: str) -> None:
    using = {Path(file).name for file, names in reached(repository, verb).items() if "ray" in names}
    assert {"ray_executor.py", "dispatch.py"} <= using


@pytest.mark.ray
def test_two_workers_are_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with open_executor(RayConfig(workers=2)) as executor:
        assert isinstance(executor, RayExecutor)
        assert executor.begin(0.0) == 2
        assert executor.running
        assert sys.modules["ray"].cluster_resources()["CPU"] == 2


def test_nothing_else_starts_workers(repository: Path) -> None:
    """Neither processes of ours nor private names of Ray; Ray is imported by the factory alone."""
    for package in PACKAGES:
        for file in (repository / package).rglob("*.py"):
            names = {*imports(file)}
            roots = {name.split(".")[0] for name in names}
            assert "multiprocessing" not in roots, file
            assert not {name for name in names if name.endswith("ProcessPoolExecutor")}, file
            assert package == "factory" or "ray" not in roots, file
            private = {name for name in names if name.startswith("ray.") and "._" in name}
            assert not private, file
            used = {node.attr for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Attribute)}
            assert not used & {"_global_node", "_private", "internal_kv", "fork", "forkpty"}, file
