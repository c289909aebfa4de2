"""What the tests of ``condvln trajectories`` ask for, and how they read what was made."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from jobs.report import Report
from jobs.trajectories import Request
from jobs.trajectory_units import find_split
from jobs.verify_trajectories import verify_trajectories
from schemas.config import CameraConfig, TrajectoryConfig

TINY = CameraConfig(width=32, height=24, hfov=79.0, max_depth=None, normalized=False)
FIFTEEN = ("streamvln", "navila", "janusvln", "internvla-n1", "lerobot")
THIRTY = ("snav", "uninavid", "lerobot")
"""Layouts by the turns that their words mean; LeRobot's says its own."""
WALKS = TrajectoryConfig(walks=("direct", "oracle", "recovery"))


def to(asked: Request, out: Path, **changes: Any) -> Request:
    """The request with another folder, and other changes."""
    return replace(asked, out=out, **changes)


def rows(folder: Path, table: str) -> list[dict[str, Any]]:
    """Rows of a table of a folder of trajectories."""
    found: list[dict[str, Any]] = pq.read_table(folder / f"{table}.parquet").to_pylist()
    return found


def content(folder: Path) -> dict[str, str]:
    """Hash of every file, without the run's own records."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".condvln" not in path.parts
    }


def proven(asked: Request, folder: Path, **options: Any) -> Report:
    """The report of the verifier."""
    return verify_trajectories(find_split(asked.target, asked.split, asked.scenes), folder, **options)
