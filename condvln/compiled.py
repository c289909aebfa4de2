"""The only module that uses numba: how kernels are compiled, cached and announced.

Rules every kernel of this package follows:

* strict IEEE arithmetic: no ``fastmath`` and no contraction, so that float32 results equal the C++ they follow;
* a kernel calls only kernels of its own folder. numba's cache notices an edit of a kernel's own file, not of the files
  it calls into; the cache folder is therefore keyed on the content of the kernel's whole folder;
* kernels do no bounds checks, so the caller validates every index first.

The cache is in the first of these folders that is writable: ``NUMBA_CACHE_DIR``, ``__pycache__`` beside the
kernels, the user's cache folder. If none is, each process compiles the kernels again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import config as numba_config
from numba.core import event as numba_event

__all__ = ["compilation_reported_to", "compiled", "register_warm_up", "warm_up"]

P = ParamSpec("P")
R = TypeVar("R")
Notify = Callable[[str], None]

# Each edit of a kernel leaves an old cache behind; this many old caches are kept beside the current one.
CACHE_VERSIONS_KEPT = 2

_logger = logging.getLogger(__name__)
_warm_ups: dict[str, Callable[[], object]] = {}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` to machine code on its first call, and keep the code in a cache on disk.

    The function's type is kept, so that mypy checks the callers.
    """
    folder = Path(function.__code__.co_filename).resolve().parent
    package = function.__module__.rpartition(".")[0] or folder.name
    with _numba_cache_in(_cache_folder(folder, package)):
        try:
            dispatcher = numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function)
        except RuntimeError:  # numba found no writable folder
            dispatcher = numba.njit(cache=False, fastmath=False, error_model="numpy", nogil=True)(function)
    return cast("Callable[P, R]", dispatcher)


def register_warm_up(name: str, run: Callable[[], object]) -> None:
    """Register `run` as a function that :func:`warm_up` calls. `run` must compile the kernels of the group `name` by
    calling each of these kernels on a small input.
    """
    _warm_ups[name] = run


def warm_up(report: Notify | None = None, only: Collection[str] | None = None) -> None:
    """Compile all registered kernels now, or only the groups named in `only`. Kernels that are in the cache are loaded
    from it.

    Call it before timing or before starting workers, which then find the code in the shared cache. ``report`` gets one
    line per group.
    """
    with compilation_reported_to(report or _report_to_stderr):
        chosen = [(name, run) for name, run in sorted(_warm_ups.items()) if only is None or name in only]
        for number, (name, run) in enumerate(chosen, start=1):
            if report is not None:
                report(f"navigation kernels {number}/{len(chosen)}: {name}")
            run()


@contextmanager
def compilation_reported_to(report: Notify) -> Iterator[None]:
    """Return a context manager. Within its block, ``report`` is called with one line for each kernel that is compiled,
    but not for kernels that are loaded from the cache.
    """
    before = _announcer.report
    _announcer.report = report
    try:
        yield
    finally:
        _announcer.report = before


class _Announcer(numba_event.Listener):  # type: ignore[misc]
    """Announces that kernels are being compiled, which takes half a minute.

    If no caller listens, one line per process goes to stderr.
    """

    def __init__(self) -> None:
        self.report: Notify | None = None
        self._told = False
        self._depth = threading.local()

    def on_start(self, event: Any) -> None:
        depth = getattr(self._depth, "value", 0)
        self._depth.value = depth + 1
        function = event.data["dispatcher"].py_func
        if depth or not function.__module__.startswith("condvln."):
            return  # called by the kernel that was announced, or another package's kernel
        if self.report is not None:
            self.report(f"compiling {function.__module__}.{function.__name__}")
        elif not self._told:
            self._told = True
            _report_to_stderr(
                "condvln: compiling navigation kernels (once on this machine; later starts load them from a cache)"
            )

    def on_end(self, event: Any) -> None:
        self._depth.value = getattr(self._depth, "value", 1) - 1


def _report_to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@contextmanager
def _numba_cache_in(folder: Path | None) -> Iterator[None]:
    before = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(folder) if folder is not None else ""
    try:
        yield
    finally:
        numba_config.CACHE_DIR = before


@cache
def _cache_folder(kernels: Path, package: str) -> Path | None:
    """Return the cache folder of the kernels in folder ``kernels``, or None if no folder is writable. The cache
    folder's name depends on the content of the kernels.
    """
    digest = hashlib.sha256()
    for file in sorted(kernels.glob("*.py")):
        with suppress(OSError):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    name = f"{package}-{digest.hexdigest()[:12]}"
    for base in _cache_bases(kernels):
        folder = base / name
        with suppress(OSError):
            created = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                if created:
                    _forget_old_versions(folder, package)
                return folder
    _logger.warning(
        "no writable folder for compiled kernels: each process will compile them again; set NUMBA_CACHE_DIR"
    )
    return None


def _cache_bases(kernels: Path) -> Iterator[Path]:
    if numba_config.CACHE_DIR:
        yield Path(numba_config.CACHE_DIR)
    yield kernels / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    yield Path(home) / "condvln" / "kernels"


def _forget_old_versions(current: Path, package: str) -> None:
    others = [folder for folder in current.parent.glob(f"{package}-????????????") if folder != current]
    with suppress(OSError):
        others.sort(key=lambda folder: folder.stat().st_mtime, reverse=True)
        for folder in others[CACHE_VERSIONS_KEPT:]:
            shutil.rmtree(folder, ignore_errors=True)


_announcer = _Announcer()
numba_event.register("numba:compile", _announcer)
