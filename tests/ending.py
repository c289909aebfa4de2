"""How tests end a driver with no warning, and know that nothing of it is at work any more."""

from __future__ import annotations

import subprocess
from typing import Final

import psutil

__all__ = ["kill_driver"]

PATIENCE: Final = 120.0
"""Seconds for Ray's processes to notice, on a busy machine, that their driver is gone."""


def kill_driver(driver: subprocess.Popen[bytes]) -> None:
    """SIGKILL to `driver` alone; returns when it and every process that it started have ended."""
    left = psutil.Process(driver.pid).children(recursive=True)
    driver.kill()
    driver.wait()
    _, alive = psutil.wait_procs(left, timeout=PATIENCE)
    assert not alive, f"still at work: {alive}"
