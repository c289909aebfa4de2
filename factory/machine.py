"""The machine: host, versions, cores and memory, which are recorded but are no part of a key; and a memory limit for a
process while it works on a unit, so that a unit which is too large fails alone.

The system's limit on private memory (``RLIMIT_DATA``) is lowered while a stage runs: NumPy, Arrow, numba and Python
then raise ``MemoryError`` before anything is taken. C++ code that can't report a refused request (FCL, Ray's own
threads) aborts its process; in a worker that counts as its death. What the limit does not count (shared memory, mapped
files) is left to Ray's memory monitor. Linux only; elsewhere there is no limit.
"""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import resource
import socket
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Final

from schemas.errors import MemoryCeilingError

__all__ = [
    "LEAST",
    "SHARE",
    "container_limits",
    "cores",
    "host",
    "library_versions",
    "limited_memory",
    "memory_available",
    "memory_total",
    "named",
    "peak_rss",
    "private_memory",
    "reset_peak_rss",
    "rss",
    "share",
]


LEAST: Final = 1 << 30
"""Least limit that is derived from the machine, bytes: a worker holds 0.4 GiB before it reads a scene."""

SHARE: Final = 0.8
"""Share of the machine's memory, and of what is free of it, that all workers together may take."""


def share(slots: int) -> int | None:
    """Return how many bytes of memory this process may hold if `slots` such processes share the machine; None where the
    system does not report its memory.
    """
    total, free = memory_total(), memory_available()
    if not total:
        return None
    mine = rss() + int(SHARE * free / slots)
    return max(LEAST, min(int(SHARE * total / slots), mine))


@contextlib.contextmanager
def limited_memory(ceiling: int | None) -> Iterator[None]:
    """Context in which this process may take what is left below `ceiling` (bytes of resident memory; None for no
    limit), and requests beyond raise ``MemoryError``.
    """
    if ceiling is None or not rss():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = private_memory() + max(ceiling - rss(), 0)
    limits = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_DATA, (min([wanted, *limits]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def named(error: BaseException, ceiling: int | None) -> BaseException:
    """Return the error to report for `error`. A ``MemoryError`` becomes one that names the limit in force; any other
    error is returned as it is.
    """
    if ceiling is None or not isinstance(error, MemoryError) or isinstance(error, MemoryCeilingError):
        return error
    found = MemoryCeilingError(
        f"it needs more memory than the ceiling of {ceiling / 2**30:.2f} GiB a process "
        f"({str(error) or 'a request was refused'})",
        remedy="Raise ray.memory_gib, or lower ray.workers, and run again with --retry-quarantined",
    )
    found.__cause__ = error
    return found


@functools.cache
def host() -> str:
    """Return the name of this machine."""
    return socket.gethostname()


@functools.cache
def library_versions() -> dict[str, str]:
    """Return the versions of libraries that may change rows or bytes."""
    found = {"python": platform.python_version()}
    for name in ("numba", "numpy", "pyarrow", "ray", "scipy", "trimesh"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def reset_peak_rss() -> None:
    """Restart the measurement that ``peak_rss`` returns. This has no effect on systems other than Linux."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_rss() -> int:
    """Return the maximum resident memory of this process in bytes, since the last ``reset_peak_rss`` or else since its
    start.
    """
    with contextlib.suppress(OSError), open("/proc/self/status") as handle:
        for line in handle:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    # Kilobytes on Linux, bytes on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def rss() -> int:
    """Return the resident memory of this process in bytes; 0 where the system does not report it (not Linux)."""
    return _statm(1)


def private_memory() -> int:
    """Return the private virtual memory of this process in bytes, as ``RLIMIT_DATA`` counts it; 0 where unknown."""
    return _statm(5)


def _statm(field: int) -> int:
    try:
        with open("/proc/self/statm", "rb") as handle:
            return int(handle.read().split()[field]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def memory_total() -> int:
    """Return the memory of this machine or its container in bytes; 0 where the system does not report it."""
    return min([_meminfo("MemTotal"), *(limit for limit, _ in container_limits())])


def cores() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory_available() -> int:
    """Return the bytes that processes can still allocate before the machine or its container runs out; 0 where
    unknown.
    """
    return max(min([_meminfo("MemAvailable"), *(limit - used for limit, used in container_limits())]), 0)


def _meminfo(name: str) -> int:
    try:
        with open("/proc/meminfo") as handle:
            return next((int(line.split()[1]) * 1024 for line in handle if line.startswith(f"{name}:")), 0)
    except OSError:
        return 0


def container_limits(
    groups: Path = Path("/proc/self/cgroup"), mounted: Path = Path("/sys/fs/cgroup")
) -> Iterator[tuple[int, int]]:
    """Yield (limit, used) in bytes of each memory control group of this process that has a limit. Groups may be of
    version 1 or 2.
    """
    try:
        lines = groups.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        number, names, path = line.split(":", 2)
        if number == "0":
            folder, files = mounted, ("memory.max", "memory.current")
        elif "memory" in names.split(","):
            folder, files = mounted / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        own = folder / path.lstrip("/")
        # Inside a container its own group is often the root of what is mounted.
        for place in dict.fromkeys([own, *own.parents]):
            if place != folder and folder not in place.parents:
                break
            try:
                limit, used = ((place / name).read_text().strip() for name in files)
            except OSError:
                continue
            if limit.isdigit() and used.isdigit():
                yield int(limit), int(used)
