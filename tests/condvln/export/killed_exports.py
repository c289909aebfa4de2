"""Kills an export by SIGKILL before each change that it makes to the disk, and looks at what is left each time.

Run as ``killed_exports.py FOLDER exchange|rename none|other|same STEP``. A child is forked for every STEP-th change and
for all changes around the exchange; prints how many changes there are. It needs no fault points in the product:
Python's audit events tell of each rename, removal, link, new folder and file opened for writing.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[3]))

from condvln.export import staging
from condvln.export.snapshot import export_snapshot
from schemas.config import SplitsConfig
from tests.made_snapshot import MemoryTables, made_snapshot

CHANGES = {"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.chmod", "shutil.rmtree"}
CONFIG = SplitsConfig(bias="off")


def files(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


class Changes:
    """Counts changes of the disk below a folder; kills this process before the one of a number."""

    def __init__(self, below: Path, last: int) -> None:
        self.below, self.last = str(below), last
        self.count = 0
        self.names: list[str] = []

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if not isinstance(path, str) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                return
        elif event not in CHANGES:
            return
        if not any(self.below in str(argument) for argument in arguments):
            return
        self.count += 1
        self.names.append(event)
        if self.count == self.last:
            os.kill(os.getpid(), signal.SIGKILL)


def forked(out: Path, tables: MemoryTables, last: int, report: Path) -> int:
    """Export in a child that is killed before change number `last`; how it ended."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            changes = Changes(out.parent, last)
            sys.addaudithook(changes)
            export_snapshot(tables, out, CONFIG)
            count, names = changes.count, " ".join(changes.names)
            changes.last = 0
            report.write_text(f"{count} {names}")
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main(folder: Path, way: str, former: str, step: int) -> None:
    if way == "rename":
        staging._exchange = lambda one, other: False  # type: ignore[assignment]
    scenes = {"replicacad": ["apt_0", "v3_sc0_staging_00", "v3_sc1_staging_00"]}
    new = made_snapshot(scenes, per_category=4)
    old = new if former == "same" else made_snapshot({"replicacad": ["apt_1", "v3_sc0_staging_01"]}, per_category=4)
    prepared, place, report = folder / "prepared" / "out", folder / "place", folder / "report"
    if former != "none":
        export_snapshot(old, prepared, CONFIG)
        (prepared / "notes.txt").write_text("mine")
        (prepared / "plots").mkdir()
        (prepared / "plots" / "a.png").write_text("mine")

    def prepare() -> Path:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        if former != "none":
            shutil.copytree(prepared, place / "out")
        return place / "out"

    out = prepare()
    before = files(out) if out.exists() else {}
    assert forked(out, new, 0, report) == 0
    count, *names = report.read_text().split()
    after = files(out)
    assert after != before or former == "same"
    total = int(count)
    near = {number for number, name in enumerate(names, 1) if name in ("os.rename", "os.link", "shutil.rmtree")}
    last_writes = max(number for number, name in enumerate(names, 1) if name == "open")
    points = sorted({*range(1, total + 1, step)} | {number for number in near if number > last_writes} | {total})
    for number in points:
        out = prepare()
        assert forked(out, new, number, report) == -signal.SIGKILL, number
        between = way == "rename" and not out.exists() and former != "none"
        if not between:
            assert files(out) in ((before, after) if out.exists() else ({},)), (
                f"killed at {number}: {names[number - 1]}"
            )
        staging.recover(out)
        found = files(out) if out.exists() else {}
        assert found in (before, after), f"recovered from {number}: {names[number - 1]}"
        assert [path.name for path in place.iterdir()] in (["out"], []), f"left by {number}"
        # and the next export is as if nothing had happened
        if number == points[-1] or number % 50 == 0:
            assert forked(out, new, 0, report) == 0
            assert files(out) == after
            assert [path.name for path in place.iterdir()] == ["out"]
    print(total, len(points))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]))
