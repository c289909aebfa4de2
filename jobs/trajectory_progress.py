"""Plan and progress of ``condvln trajectories``: frames, gigabytes, hours, and the speed of a run."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from rich.console import Console

from factory.commits import Commits
from factory.heartbeat import Busy
from factory.receipt import Receipt
from jobs.progress import RunProgress
from jobs.trajectory_units import Estimate

__all__ = ["Speed", "plan_lines"]


class Speed:
    """Progress that also shows images a second, the time left, and the disk used so far."""

    def __init__(self, inner: RunProgress, commits: Commits, console: Console) -> None:
        self._inner, self._commits, self._console = inner, commits, console
        self._began = time.monotonic()
        self._images, self._bytes = 0.0, 0.0
        self._shown = 0.0

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        self._inner.phase(name, total, seconds, workers)

    def unit(self, receipt: Receipt) -> None:
        for stage in receipt.stages:
            if stage.stage == "frames" and stage.made:
                found = self._commits.find(stage.stage, stage.key.hex(), discard=False)
                if found is not None:
                    self._images += found.commit.measures.get("images", 0.0)
                    self._bytes += found.commit.measures.get("image_bytes", 0.0)
        self._inner.unit(receipt)
        passed = time.monotonic() - self._began
        if self._images and passed - self._shown > 10:
            self._shown = passed
            self._inner.note(
                f"{self._images:,.0f} images, {self._images / passed:.0f} a second, {self._bytes / 1e9:.2f} GB so far"
            )

    def step(self) -> None:
        self._inner.step()

    def note(self, message: str) -> None:
        self._inner.note(message)

    def busy(self, unit: Busy, message: str) -> None:
        self._inner.busy(unit, message)


def plan_lines(expected: Estimate, folder: Path) -> list[str]:
    """Return what a run is expected to make and to cost, and the free space of its disk."""
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(parent).free / 1e9
    lines = [
        f"{expected.episodes:,} episodes of {expected.scenes:,} scenes: about {expected.frames:,} frames, of which "
        f"{expected.rendered:,} are rendered and the others show the same poses; {expected.images:,} images, "
        f"{expected.gigabytes:.2f} GB, {expected.hours:.2f} CPU hours; {free:.1f} GB are free"
    ]
    if expected.gigabytes > free:
        lines.append(f"The disk of {folder} is too small for this.")
    return lines
