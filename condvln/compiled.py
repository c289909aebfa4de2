"""How kernels are compiled, and where their machine code is kept.

Rules every kernel of this package follows:

* strict IEEE arithmetic: no ``fastmath`` and no contraction, so that float32 results equal the C++ they follow;
* kernels do no bounds checks, so the caller validates every index first.

numba keeps machine code on disk, and notices when the file of a kernel changes, but not when another file does that
the kernel calls. So the folder is named by a digest of the sources of all kernels.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final, ParamSpec, TypeVar, cast

import numba

__all__ = ["KERNEL_SOURCES", "cache_folder", "compiled", "has_kernels", "inlined"]

P = ParamSpec("P")
R = TypeVar("R")

KERNEL_SOURCES: Final = (
    "condvln/compiled.py",
    "condvln/*/kernels/*.py",
    "condvln/navigation/recast/*.py",
    "condvln/navigation/tile.py",
    "condvln/sensors/raster.py",
    "schemas/config/constants.py",
)
"""Patterns of the files that hold kernels, and all constants and functions that kernels use."""

_logger = logging.getLogger(__name__)


def cache_folder() -> Path | None:
    """Return the folder of the machine code of kernels with these sources: in ``NUMBA_CACHE_DIR`` if it is set, else in
    the user's cache folder. None if it can't be written.
    """
    root = Path(__file__).parents[1]
    files = sorted({file for pattern in KERNEL_SOURCES for file in root.glob(pattern)})
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(root)}\0".encode() + hashlib.sha256(file.read_bytes()).digest())
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    given = os.environ.get("NUMBA_CACHE_DIR")
    folder = (Path(given) if given else Path(home) / "condvln") / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_FOLDER: Final = cache_folder()
if _FOLDER is None:
    _logger.warning(
        "no writable folder for compiled kernels: each process will compile them again; set NUMBA_CACHE_DIR"
    )
else:
    numba.config.CACHE_DIR = str(_FOLDER)


def has_kernels() -> bool:
    """Return whether the folder holds machine code of an earlier run."""
    return _FOLDER is not None and any(_FOLDER.iterdir())


_OPTIONS: Final = {"cache": _FOLDER is not None, "error_model": "numpy", "nogil": True}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` to machine code on its first call, and keep the code on disk.

    The function's type is kept, so that mypy checks the callers.
    """
    return cast("Callable[P, R]", numba.njit(function, **_OPTIONS))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` as a part of the kernels that call it, which takes less time for a function with one caller.

    A call from Python, as in tests, compiles it by itself. The results are the same.
    """
    return cast("Callable[P, R]", numba.njit(function, inline="always", **_OPTIONS))
