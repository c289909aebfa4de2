"""Where compiled kernels are kept, and what is said while they compile. Each case runs in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import condvln.navigation

KERNEL = """
import sys
sys.path.insert(0, {folder!r})
from kernel import double
print(double(21))
"""
SOURCE = """
from condvln.compiled import compiled
@compiled
def double(x):
    return 2 * x
"""


@pytest.fixture
def kernels(tmp_path: Path) -> Path:
    """A folder that holds one small kernel."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "kernel.py").write_text(SOURCE)
    return folder


def run(kernels: Path, home: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Import and call the kernel with this home folder and environment."""
    variables = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    variables |= {"HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    code = KERNEL.format(folder=str(kernels))
    return subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True)


def cached(folder: Path) -> list[Path]:
    """Index files of numba's cache below a folder; rewritten only when a kernel compiles."""
    return sorted(folder.rglob("*.nbi"))


def test_the_named_folder_comes_first_and_is_used_again(kernels: Path, tmp_path: Path) -> None:
    first = run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert first.stdout == "42\n"
    (index,) = cached(tmp_path / "cache")
    assert not cached(kernels)
    written = index.stat().st_mtime_ns
    again = run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert again.stdout == "42\n"
    assert index.stat().st_mtime_ns == written


def test_without_one_the_cache_lies_beside_the_kernels(kernels: Path, tmp_path: Path) -> None:
    run(kernels, tmp_path / "home")
    assert len(cached(kernels / "__pycache__")) == 1


def test_where_nothing_beside_can_be_written_the_user_has_one(kernels: Path, tmp_path: Path) -> None:
    (kernels / "__pycache__").write_text("a file where the folder would be")
    run(kernels, tmp_path / "home")
    assert len(cached(tmp_path / "home" / ".cache" / "condvln")) == 1


def test_with_nowhere_to_write_kernels_still_run(kernels: Path, tmp_path: Path) -> None:
    (kernels / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    done = run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "home"))
    assert done.stdout == "42\n"
    assert not cached(tmp_path)


def test_an_edit_of_any_kernel_of_the_folder_makes_a_new_cache(kernels: Path, tmp_path: Path) -> None:
    """numba itself would not notice that a kernel's callee, in another file, has changed."""
    cache = tmp_path / "cache"
    for number in range(4):
        (kernels / "other.py").write_text(f"CHANGED = {number}\n")
        assert run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(cache)).stdout == "42\n"
    # The current version and two before it are kept.
    assert len(cached(cache)) == 3


def test_progress_is_told_while_kernels_compile(tmp_path: Path) -> None:
    """Cold: each step and each kernel by name. From the cache: the steps only."""
    code = (
        "from condvln.compiled import register_warm_up, warm_up, compiled\n"
        "from condvln.navigation.kernels.geometry import distance\n"
        "import numpy as np\n"
        "register_warm_up('geometry', lambda: distance(*[np.float32(0)] * 6))\n"
        "warm_up(print)"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    lines = [
        subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for _ in range(2)
    ]
    step = "navigation kernels 1/1: geometry"
    assert lines == [[step, "compiling condvln.navigation.kernels.geometry.distance"], [step]]


def test_public_names_load_on_first_use() -> None:
    assert set(condvln.navigation.__all__) == set(condvln.navigation._MODULE_OF)
    for name in condvln.navigation.__all__:
        assert getattr(condvln.navigation, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        condvln.navigation.nothing  # noqa: B018
    code = "import sys, condvln.navigation.settings; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
