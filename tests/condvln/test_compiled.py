"""Where compiled kernels are kept, and that no change in their sources goes unnoticed. Each case runs in a process of
its own, with a copy of the packages.
"""

from __future__ import annotations

import ast
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from condvln.compiled import KERNEL_SOURCES

ASK = """
import numpy as np
from condvln.navigation.kernels.mesh import point_to_segment, triangle_area
print(triangle_area(*np.float32([0, 0, 3, 4, 0, 0])), *point_to_segment(*np.float32([0, 0, 3, 4, 0, 0])))
"""


@pytest.fixture
def checkout(repository: Path, tmp_path: Path) -> Path:
    """A copy of the packages that kernels need, whose files a test may change."""
    for name in ("condvln", "schemas"):
        shutil.copytree(repository / name, tmp_path / "checkout" / name, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "checkout"


def ask(checkout: Path, home: Path, code: str = ASK, **environment: str) -> subprocess.CompletedProcess[str]:
    """Call kernels with this home folder and environment."""
    variables = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    variables |= {"HOME": str(home), "PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    return subprocess.run(
        [sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True, cwd=checkout
    )


def cached(folder: Path) -> dict[Path, int]:
    """Files of compiled kernels below a folder, with their inodes: one that is written again has another one."""
    return {path: path.stat().st_ino for path in folder.rglob("*.nbc")}


def test_kernels_are_kept_in_the_users_cache_folder_or_in_the_named_one(checkout: Path, tmp_path: Path) -> None:
    answer = ask(checkout, tmp_path / "home").stdout
    kept = cached(tmp_path)
    assert len(kept) == 2
    assert kept == cached(tmp_path / "home" / ".cache" / "condvln")
    assert ask(checkout, tmp_path / "home").stdout == answer
    assert cached(tmp_path) == kept
    ask(checkout, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "named"))
    assert len(cached(tmp_path / "named")) == 2


def test_with_nowhere_to_write_kernels_still_run(checkout: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file where the folder would be")
    done = ask(checkout, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "file"))
    assert done.stdout == ask(checkout, tmp_path / "home").stdout
    assert "set NUMBA_CACHE_DIR" in done.stderr
    assert not cached(tmp_path / "checkout")


CALLER = """
import numpy as np
import probe
print(probe.shifted(*np.float32([2, 0, 0, 0, 1, 0])))
"""
PROBE = """
from condvln.compiled import compiled
from condvln.navigation.kernels.mesh import ZERO, point_to_segment
@compiled
def shifted(x, z, px, pz, qx, qz):
    return point_to_segment(x, z, px, pz, qx, qz)[1] > ZERO
"""


def test_a_change_in_the_file_of_a_callee_is_noticed(checkout: Path, tmp_path: Path) -> None:
    """numba alone looks at the caller's file, and would run the old code of a callee."""
    (checkout / "probe.py").write_text(PROBE)
    file = checkout / "condvln" / "navigation" / "kernels" / "mesh.py"
    assert ask(checkout, tmp_path, CALLER).stdout == "True\n"
    text = file.read_text()
    assert text.count("    return dx * dx + dz * dz, t\n") == 1
    file.write_text(text.replace("    return dx * dx + dz * dz, t\n", "    return dx * dx + dz * dz, ZERO * t\n"))
    assert ask(checkout, tmp_path, CALLER).stdout == "False\n"


def imported(tree: ast.Module) -> set[str]:
    """Modules that a module imports, and `module.name` for each name that it takes from one."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} | {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {f"{node.module}".split(".")[0]}
    return found


def test_kernels_use_values_and_functions_of_files_in_the_digest_only(repository: Path) -> None:
    """What a file with kernels imports of this project is in the digest, or no value that numba puts into the code."""
    counted = {file for pattern in KERNEL_SOURCES for file in repository.glob(pattern)}
    packages = [repository / name for name in ("condvln", "factory", "jobs", "schemas")]
    texts = {file: file.read_text(encoding="utf-8") for folder in packages for file in folder.rglob("*.py")}
    trees = {file: ast.parse(text) for file, text in texts.items() if "numba" in text or "compiled" in text}
    assert [file.name for file, tree in trees.items() if "numba" in imported(tree)] == ["compiled.py"]
    decorators = {"condvln.compiled", "condvln.compiled.compiled", "condvln.compiled.inlined"}
    with_kernels = {file for file, tree in trees.items() if decorators & imported(tree)}
    assert with_kernels
    assert with_kernels <= counted
    for file in with_kernels:
        for node in ast.walk(trees[file]):
            name = getattr(node, "module", None) or ""
            if not isinstance(node, ast.ImportFrom) or name.split(".")[0] not in ("condvln", "schemas"):
                continue
            if repository / f"{name.replace('.', '/')}.py" not in counted:
                for one in node.names:
                    value = getattr(importlib.import_module(name), one.name)
                    assert not isinstance(value, bool | int | float | tuple | np.generic | np.ndarray), (file, one.name)
