"""What is recorded about the machine, never keyed: host, library versions, seconds, peak memory."""

from __future__ import annotations

import functools
import platform
import resource
import socket
import sys
from importlib import metadata

__all__ = ["host", "library_versions", "peak_rss", "reset_peak_rss"]


@functools.cache
def host() -> str:
    """Name of this machine."""
    return socket.gethostname()


@functools.cache
def library_versions() -> dict[str, str]:
    """Versions that a difference in rows or bytes could come from."""
    found = {"python": platform.python_version()}
    for name in ("numba", "numpy", "pyarrow", "ray", "scipy", "trimesh"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def reset_peak_rss() -> None:
    """Let the next ``peak_rss`` count from now on, where the system can (Linux)."""
    try:
        with open("/proc/self/clear_refs", "w") as handle:
            handle.write("5")
    except OSError:
        pass


def peak_rss() -> int:
    """Highest resident memory of this process in bytes, since ``reset_peak_rss`` or the start."""
    try:
        with open("/proc/self/status") as handle:
            for line in handle:
                if line.startswith("VmHWM:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    # Kilobytes on Linux, bytes on macOS.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
