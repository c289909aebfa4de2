"""Drivers in processes of their own, to be started, watched and killed by tests: ``python -m drivers …``."""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import sys
import threading
import time
from pathlib import Path
from typing import Any

import toys

from factory.executor import Executor, InlineExecutor
from factory.ray_executor import RayExecutor
from factory.run import run
from factory.store import open_store

COUNT = 60
LOSER = "loses a node"


def corpus(log: str = "", seconds: float = 0.0) -> list[toys.Unit]:
    """The corpus of the determinism matrix."""
    return toys.units(COUNT, log=log, seconds=seconds)


def main() -> None:
    """Run once and print the report as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("store")
    parser.add_argument("--workers", type=int, default=0, help="of Ray's; 0: inline")
    parser.add_argument("--nodes", type=int, default=0, help="of one CPU each, behind a head without any")
    parser.add_argument("--lose", action="store_true", help="lose a node once units are running, gain another")
    parser.add_argument("--shuffle", type=int, default=0)
    parser.add_argument("--log", default="")
    parser.add_argument("--seconds", type=float, default=0.0)
    parser.add_argument("--trouble", default="", help="of a further unit")
    options = parser.parse_args()
    with contextlib.redirect_stdout(sys.stderr):  # Ray writes of a lost node to standard output, until the very end
        document = drive(options)
    sys.stdout.write(json.dumps(document) + "\n")


def drive(options: argparse.Namespace) -> dict[str, Any]:
    """The run itself."""
    units = corpus(options.log, options.seconds)
    if options.trouble:
        units.append(
            toys.unit("a/trouble", 4, trouble=options.trouble, log=options.log, seconds=options.seconds, cost=9.0)
        )
    if options.shuffle:
        random.Random(options.shuffle).shuffle(units)
    executor: Executor = InlineExecutor()
    if options.nodes:
        executor = cluster(options.nodes, Path(options.log) if options.lose else None)
    elif options.workers:
        executor = RayExecutor(workers=options.workers)
    report = run(toys.pipeline(), units, open_store(options.store), executor=executor, part_bytes=2000)
    if isinstance(executor, RayExecutor):
        executor.close()
    if options.nodes:
        import ray

        for thread in threading.enumerate():
            if thread.name == LOSER:
                thread.join()
        ray.shutdown()  # and with it the thread that writes
    return {"id": report.snapshot_id, "exit": report.exit_code, "stages": dict(report.stages)}


def cluster(nodes: int, lose: Path | None) -> Executor:
    """A cluster of several nodes on this machine; with ``lose``, one dies when the log there shows work under way."""
    import ray
    from ray.cluster_utils import Cluster

    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    alive = [found.add_node(num_cpus=1) for _ in range(nodes)]
    ray.init(address=found.address, log_to_driver=False, logging_level="ERROR")

    def watch(folder: Path) -> None:
        while len([*folder.iterdir()]) < 8:
            time.sleep(0.02)
        found.remove_node(alive[0], allow_graceful=False)
        (folder.parent / "lost").write_text(str(len([*folder.iterdir()])))
        found.add_node(num_cpus=1)

    if lose is not None:
        threading.Thread(target=watch, args=(lose,), name=LOSER, daemon=True).start()
    return RayExecutor(address=found.address)


if __name__ == "__main__":
    main()
