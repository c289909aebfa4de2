"""How kernels are compiled, and how their compilation is announced. Only this module, ``condvln.uncounted``
and ``condvln.kernel_cache`` use numba.

Rules every kernel of this package follows:

* strict IEEE arithmetic: no ``fastmath`` and no contraction, so that float32 results equal the C++ they follow;
* kernels do no bounds checks, so the caller validates every index first.

Machine code is kept on disk, in ``NUMBA_CACHE_DIR`` if it is set, else in the user's cache folder, so that all
checkouts and environments of a machine share it; ``__pycache__`` beside the kernels is the last resort.
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import FunctionType
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core import event as numba_event

from condvln.collector import no_collection
from condvln.kernel_cache import KernelCache

__all__ = [
    "compilation_reported_to",
    "compiled",
    "compiled_apart",
    "constant",
    "inlined",
    "load_cached",
    "register_warm_up",
    "warm_up",
]

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C", int, bool)
Notify = Callable[[str], None]

_OPTIONS: Final = {
    "cache": False,
    "fastmath": False,
    "error_model": "numpy",
    "nogil": True,
    "no_cfunc_wrapper": True,
}
"""Options of ``numba.njit``; ``condvln.kernel_cache`` stands for its cache, and nothing calls kernels from C."""

_logger = logging.getLogger(__name__)
_warm_ups: dict[str, Callable[[], object]] = {}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` to machine code on its first call, and keep the code in a cache on disk.

    The function's type is kept, so that mypy checks the callers.
    """
    return _dispatcher(function, _OPTIONS)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` as a part of the only kernel that calls it, at one place.

    It is typed, optimised and turned into machine code there, not by itself before that, which takes less time; the
    results are the same. A call from Python, as in tests, compiles it by itself.
    """
    return _dispatcher(function, {**_OPTIONS, "inline": "always"})


def compiled_apart(function: Callable[P, R]) -> Callable[P, R]:
    """Compile ``function`` by itself, also where one place calls it, and with a wrapper for callers in C.

    For a few kernels LLVM makes faster machine code of that: rasterising of triangles takes a tenth less time. Both are
    needed, and for all kernels that call each other; the results are the same.
    """
    return _dispatcher(function, {**_OPTIONS, "no_cfunc_wrapper": False})


def constant(value: C) -> C:
    """Return a constant that kernels hand to kernels, as a scalar of NumPy.

    For each integer or truth value of Python, numba would compile the kernel that gets it once more.
    """
    return cast("C", np.bool_(value) if isinstance(value, bool) else np.int64(value))


def _dispatcher(function: Callable[P, R], options: Mapping[str, object]) -> Callable[P, R]:
    dispatcher = numba.njit(**options)(function)
    dispatcher._cache = KernelCache(cast("FunctionType", function), sorted(options.items()), _not_stored)
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
            with no_collection():  # numba makes millions of small objects; looking through them takes an eighth
                run()


def load_cached(groups: Collection[str]) -> bool:
    """Load the kernels of `groups` from the cache, and compile none. Returns False at the first one that is not there.

    The modules that register the groups must have been imported.
    """
    try:
        with compilation_reported_to(_refuse):
            for name in sorted(groups):
                _warm_ups[name]()
    except _NotCachedError:
        return False
    return True


class _NotCachedError(Exception):
    """A kernel would have to be compiled."""


def _refuse(line: str) -> None:
    raise _NotCachedError(line)


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
        function = event.data["dispatcher"].py_func
        self._depth.value = depth + 1  # before the message, which may raise: the event ends in any case
        # Another package's kernel is not told, nor one that is called by the kernel that was told.
        if not depth and function.__module__.startswith("condvln."):
            self._tell(function)

    def _tell(self, function: FunctionType) -> None:
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


@cache
def _not_stored() -> None:
    _logger.warning(
        "no writable folder for compiled kernels: each process will compile them again; set NUMBA_CACHE_DIR"
    )


_announcer = _Announcer()
numba_event.register("numba:compile", _announcer)
