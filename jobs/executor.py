"""Where the work of a verb is done: in this process, or in Ray tasks on this machine or on a cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Final

from condvln.compiled import has_kernels
from factory.executor import Executor, InlineExecutor
from factory.machine import cores
from factory.ray_address import ENVIRONMENT
from factory.ray_executor import RayExecutor
from jobs.costs import COMPILE_SECONDS
from jobs.workspace import source_paths
from schemas.config import Config, RayConfig

__all__ = ["SMALL_SECONDS", "every_node_sees", "open_executor", "place_of_work"]

LOCAL: Final = "local"
"""Value of `ray.address` that means this machine, whatever RAY_ADDRESS says."""

SMALL_SECONDS: Final = 20.0
"""CPU seconds of estimated work below which Ray is not started unasked: two workers would save less than the ten
seconds that its start takes."""


def place_of_work(ray: RayConfig, seconds: float, *, inline: bool = False) -> tuple[bool, str]:
    """Return whether work of so many CPU seconds is done in Ray tasks, and a sentence that says where and why."""
    address, place = _cluster(ray)
    if inline:
        return False, "the work is done in this process (--inline)"
    if address is not None:
        return True, f"the work is done on the Ray cluster at {address} ({place})"
    if ray.workers == 1:
        return False, "the work is done in this process (ray.workers is 1)"
    if ray.workers is None and cores() == 1:
        return False, "the work is done in this process (this machine has one core)"
    if ray.workers is None and seconds < SMALL_SECONDS:
        why = (
            f"less than {SMALL_SECONDS:.0f} CPU s, and Ray takes about ten seconds to start; ray.workers: 2 asks for it"
        )
        return False, f"the work is done in this process ({why})"
    return True, f"the work is done by {ray.workers or cores()} workers of a Ray on this machine"


def _cluster(ray: RayConfig) -> tuple[str | None, str]:
    """Return the address of the cluster to join, None for this machine; and where that address comes from."""
    if ray.address is not None:
        return (None if ray.address == LOCAL else ray.address), "ray.address"
    address = os.environ.get(ENVIRONMENT, "").strip()
    return (None if address in ("", LOCAL) else address), f"environment variable {ENVIRONMENT}"


def every_node_sees(config: Config) -> list[str]:
    """Return the folders of a run that must be the same on every node of a cluster."""
    return [str(folder) for folder in (*source_paths(config), config.store) if "://" not in str(folder)]


@contextmanager
def open_executor(
    ray: RayConfig,
    *,
    inline: bool = False,
    say: Callable[[str], None] = lambda _: None,
    folders: Iterable[str | Path] = (),
) -> Iterator[Executor]:
    """Open what runs the tasks. Ray starts, or a cluster is joined, when the first work comes.

    say : shows a message
    folders : that every node of a cluster must see
    """

    def warm(executor: Executor) -> None:
        if isinstance(executor, InlineExecutor) and not inline:
            say(place_of_work(ray, 0.0)[1])
        if not has_kernels():
            say(f"kernels are compiled once on a machine, about {COMPILE_SECONDS:.0f} CPU s, which estimates leave out")

    if not place_of_work(ray, float("inf"), inline=inline)[0]:
        yield InlineExecutor(warm)
        return
    address, place = _cluster(ray)
    # Ray writes about lost nodes to standard output, in the middle of a line if need be; that one is the report's.
    with (
        redirect_stdout(sys.stderr),
        RayExecutor(
            workers=ray.workers,
            address=address,
            place=place,
            init={"runtime_env": ray.runtime_env} if ray.runtime_env else {},
            warm=warm,
            folders=[os.path.abspath(folder) for folder in folders],
            small=SMALL_SECONDS if ray.workers is None else 0.0,
        ) as executor,
    ):
        yield executor
