"""``condvln trajectories`` killed at ten random moments: what is made in the end is the same, byte for byte."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jobs.trajectories import Request, make_trajectories
from schemas.config import TrajectoryConfig
from tests.jobs.trajectories.made import content, to

KILLS = 5
GOLD = TrajectoryConfig()


def killed_at(call: int, request: Request) -> None:
    """Make trajectories in a process that dies without notice at a write or rename, the `call`-th of the run."""
    left = [call]

    def counted(real: Any) -> Any:
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                os._exit(9)
            return real(*args, **kwargs)

        return wrapper

    Path.write_bytes = counted(Path.write_bytes)  # type: ignore[method-assign]
    os.replace = counted(os.replace)
    os.rename = counted(os.rename)
    os.link = counted(os.link)
    make_trajectories(request)
    os._exit(0)


@pytest.mark.soak
def test_killed_at_random_moments(asked: Request, tmp_path: Path) -> None:
    layouts = ("streamvln", "janusvln", "internvla-n1")
    clean = to(asked, tmp_path / "clean", config=GOLD, layouts=layouts)
    assert make_trajectories(clean).exit_code == 0
    wanted = content(clean.out)
    again = to(clean, tmp_path / "killed")
    draw = np.random.default_rng(5)
    fork = multiprocessing.get_context("fork")
    kills = 0
    while kills < KILLS:
        process = fork.Process(target=killed_at, args=(int(draw.integers(1, len(wanted) // 2)), again))
        process.start()
        process.join()
        if process.exitcode == 0:  # it was done before its moment came: a new folder
            shutil.rmtree(again.out)
        else:
            assert process.exitcode == 9
            kills += 1
    assert make_trajectories(again).exit_code == 0
    assert content(again.out) == wanted
