"""Kernels are compiled side by side: all of them by ``condvln warm-up``, those that a command needs before its work
begins.
"""

from __future__ import annotations

import importlib
import json
import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Final

from factory.machine import cores
from jobs.parent_watch import end_with_parent
from jobs.report import Report, Section

__all__ = ["BUILDER", "GENERATED_WITH", "KERNEL_MODULES", "PROVEN_WITH", "compile_kernels", "load_kernels"]

KERNEL_MODULES: Final = {
    "navmesh builder": "condvln.navigation.recast.builder",
    "follower": "condvln.navigation.follower",
    "candidates": "condvln.instructions.kernels.candidates",
    "paths": "condvln.navigation.pathfinder",
    "starts of episodes": "condvln.episodes.starts",
    "cameras": "condvln.sensors.renderer",
    "conditions of programs": "condvln.instructions.kernels.conditions",
    "regressions of the bias gate": "condvln.bias.newton_direction",
    "distances of meshes": "condvln.relations.triangle_trees",
    "beginnings of paths": "condvln.episodes.kernels.prefix",
    "gaps between leaves": "condvln.verify.kernels.separation",
    "line of sight among boxes": "condvln.navigation.occluders",
    "alignment": "condvln.evaluation.kernels.alignment",
    "an agent's map": "condvln.evaluation.kernels.floor_grid",
    "looks of the verifier": "condvln.verify.kernels.looking",
    "paths that part": "condvln.verify.kernels.parting",
    "depth images": "condvln.formats.depth_rows",
    "pixel goals": "condvln.trajectories.pixel_goals",
    "goal points of objects": "condvln.episodes.kernels.spread",
    "ways of episodes": "condvln.episodes.routes",
    "lines of sight in range": "condvln.navigation.sight",
    "json scan": "condvln.formats.json_scan",
    "stops passed": "condvln.verify.kernels.passing",
}
"""The groups of kernels and the module that registers each. Those that take longest come first. Kernels that several
groups call are loaded where another group has compiled them: `paths` and `starts of episodes` spend more than half of
their time on kernels that `follower` has too. Of two processes that compile all groups, one has compiled `follower`
before the other comes to them."""

BUILDER: Final = "navmesh builder"
GENERATED_WITH: Final = frozenset(KERNEL_MODULES) - {
    BUILDER,
    "alignment",
    "an agent's map",
    "cameras",
    "depth images",
    "pixel goals",
}
"""The groups that generating, exporting and proving need where a scene comes with its navmesh."""

PROVEN_WITH: Final = frozenset(
    {
        "follower",
        "gaps between leaves",
        "json scan",
        "line of sight among boxes",
        "lines of sight in range",
        "looks of the verifier",
        "paths",
        "paths that part",
        "stops passed",
    }
)
"""The groups that proving needs where a scene comes with its navmesh."""

CHILD: Final = """
import json, sys
sys.path[:], groups = json.loads(sys.argv[1])
from jobs.warm_up import compile_kernels
compile_kernels(lambda line: print(line, flush=True), groups)
"""
"""Run by a Python that reads neither the environment nor the working folder, so that it imports what this process does.
A process pool right here would import the main module of whoever calls this package once more."""


def load_kernels(note: Callable[[str], None], groups: Collection[str]) -> None:
    """Load the kernels of `groups`. Those that the cache lacks are compiled first, in as many processes as there are
    cores.

    note : gets lines about what is compiled; none if the cache holds all
    """
    from condvln.compiled import load_cached, warm_up
    from condvln.kernel_cache import can_be_kept

    ordered = [group for group in KERNEL_MODULES if group in groups]
    for group in ordered:
        importlib.import_module(KERNEL_MODULES[group])
    if load_cached(ordered):
        return
    note(f"compiling {len(ordered)} groups of kernels")
    if len(ordered) > 1 and can_be_kept(load_cached):
        path = [entry for entry in sys.path if isinstance(entry, str)]
        command = [sys.executable, "-I", "-c", CHILD, json.dumps([path, ordered])]
        # In a session of its own, so that Ctrl-C reaches this process alone, which kills that one without a word of it.
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        ) as child:
            try:
                for line in child.stdout or ():
                    note(line.rstrip("\n"))
            except BaseException:
                child.kill()  # its processes end with it
                raise
        if load_cached(ordered):
            return
    warm_up(note, only=ordered)  # what could not be kept is compiled here, and an error is raised here


def compile_kernels(note: Callable[[str], None], groups: Sequence[str] = tuple(KERNEL_MODULES)) -> Report:
    """Compile the kernels of `groups` that the cache does not hold, in as many processes as there are cores.

    note : gets one line when a group is ready
    """
    found: dict[str, int] = {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(cores(), len(groups)), mp_context=context, initializer=end_with_parent) as pool:
        tasks = {pool.submit(_compile, group): group for group in groups}
        try:
            for task in as_completed(tasks):
                found[tasks[task]] = task.result()
                note(f"kernels {len(found)}/{len(groups)}: {tasks[task]}, {found[tasks[task]]} compiled")
        except BaseException:
            for process in multiprocessing.active_children():  # this process starts no others
                process.kill()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    rows: list[tuple[str | int, ...]] = [(group, found[group]) for group in groups]
    lines = [f"{sum(found.values())} kernels compiled; the others were in the cache"]
    return Report({"compiled": found}, lines, [Section("Kernels", ("group", "compiled"), [*rows])])


def _compile(group: str) -> int:
    """Compile one group in this process. Returns the number of kernels that were not in the cache."""
    from condvln.compiled import warm_up

    importlib.import_module(KERNEL_MODULES[group])
    lines: list[str] = []
    warm_up(lines.append, only={group})
    return sum(line.startswith("compiling ") for line in lines)
