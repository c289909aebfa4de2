"""Facts about the machine, which are recorded but are not part of any key: host, versions, memory, and a speed test."""

from __future__ import annotations

import functools
import os
import platform
import resource
import socket
import sys
import time
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Final

import numpy as np

__all__ = [
    "REFERENCE_PROBE_SECONDS",
    "container_limits",
    "cores",
    "host",
    "library_versions",
    "memory_available",
    "memory_total",
    "peak_rss",
    "private_memory",
    "probe",
    "reset_peak_rss",
    "rss",
    "slowness",
]


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
    try:
        with open("/proc/self/clear_refs", "w") as handle:
            handle.write("5")
    except OSError:
        pass


def peak_rss() -> int:
    """Return the maximum resident memory of this process in bytes, since the last ``reset_peak_rss`` or else since its
    start.
    """
    try:
        with open("/proc/self/status") as handle:
            for line in handle:
                if line.startswith("VmHWM:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
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


REFERENCE_PROBE_SECONDS: Final = 0.0098
"""CPU seconds of ``probe`` on the reference machine. Estimates of units are in CPU seconds of that machine, so ``python
-m benchmarks costs`` measures both together."""

_ROUNDS: Final = 4
"""Number of times that the probe runs. The fastest counts, since disturbances only make it longer."""


def probe() -> float:
    """Measure the CPU seconds of a fixed piece of work: half numpy on small arrays, half plain Python. Takes
    under 0.1 s.
    """
    return min(_round() for _ in range(_ROUNDS))


@functools.cache
def slowness() -> float:
    """Return how many CPU seconds this machine needs for the work of one CPU second on the reference machine; measured
    once per process.
    """
    return probe() / REFERENCE_PROBE_SECONDS


def _round() -> float:
    began = time.process_time()
    # Small arrays, as rooms and paths are: the time goes into calls as much as into arithmetic.
    points = np.arange(900, dtype=np.float64).reshape(300, 3) % 7.0
    total = 0.0
    for at in range(3):
        gaps = points[:, None, :] - points[None, :, :] + at
        total += float(np.sqrt((gaps * gaps).sum(axis=2)).min())
    # Dictionaries, strings and tuples, as the sampling of programs is.
    seen: dict[tuple[str, int], list[int]] = {}
    for at in range(5_000):
        seen.setdefault((f"label {at % 97}", at % 13), []).append(at)
    total += sum(len(values) for values in seen.values())
    assert total > 0
    return time.process_time() - began
