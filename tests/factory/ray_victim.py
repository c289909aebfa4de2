"""A driver with a Ray of its own, one process of which is killed while units are under way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import toys

from factory.ray_executor import RayExecutor
from factory.receipt import Receipt
from factory.report import Progress
from factory.run import run
from factory.store import open_store
from schemas.errors import CondVLNError


def kill_below(parent: int, part: str) -> None:
    """SIGKILL the first process below `parent` whose command line begins with something that ends in `part`."""
    # Whole lines: ps cuts them at COLUMNS, which a test may have set.
    listed = subprocess.check_output(["ps", "-ww", "-eo", "pid,ppid,args"], text=True)
    rows = [line.split(None, 2) for line in listed.splitlines()]
    family, grown = {str(parent)}, True
    while grown:
        found = {row[0] for row in rows if len(row) == 3 and row[1] in family} - family
        family |= found
        grown = bool(found)
    for pid, _, args in (row for row in rows if len(row) == 3):
        if pid in family and args.split()[0].endswith(part):
            os.kill(int(pid), signal.SIGKILL)
            return
    raise RuntimeError(f"nothing below this process ends in {part}")


class Assassin(Progress):
    """Kills when the third unit of the last pass is done."""

    def __init__(self, part: str) -> None:
        self.part = part
        self.done = 0

    def phase(self, name: str, total: int, seconds: float, workers: int = 1) -> None:
        self.done = -1000 if name.startswith("first pass") else 0

    def unit(self, receipt: Receipt) -> None:
        self.done += 1
        if self.done == 3:
            threading.Thread(target=kill_below, args=(os.getpid(), self.part)).start()


def main() -> int:
    """As the command does: the error's message is the last line, its code the exit code."""
    store, part = sys.argv[1:]
    units = [toys.unit(f"a/{n:02d}", seconds=0.3) for n in range(40)]
    try:
        with RayExecutor(workers=2) as executor:
            report = run(toys.pipeline(), units, open_store(store), executor=executor, progress=Assassin(part))
    except CondVLNError as error:
        print(f"condvln: {error}", file=sys.stderr, flush=True)
        return error.exit_code
    print(report.snapshot_id)
    return report.exit_code


if __name__ == "__main__":
    sys.exit(main())
