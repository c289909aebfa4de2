"""A proof that is shared out over processes says what one process says."""

from __future__ import annotations

import gzip
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import psutil
import pytest

import jobs.verify
from condvln.export.contents import CERTIFICATES
from condvln.verify import Certificate
from jobs.proof_processes import prove_side_by_side
from jobs.report import Report
from jobs.verify import verify_export
from schemas.config import Config
from schemas.errors import ClusterError, FormatError

SCENES = 9


class OddError(Exception):
    """Can be pickled, and not read again."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} {other}")


def certificate(number: int) -> Certificate:
    return Certificate(number, "made", f"scene {number}", "train", {"words": os.getpid()})


def scenes(fault: str, mine: Callable[[int], bool]) -> Iterator[tuple[int, list[Certificate]]]:
    """Prove made scenes of two episodes each; at the sixth of them comes the fault."""
    for number in range(SCENES):
        if fault == "unread" and number == 5:
            raise FormatError("cut", where="a.json", remedy="Export again")
        if mine(number):
            if fault == "killed" and number == 5:
                os.kill(os.getpid(), signal.SIGKILL)
            if fault == "left" and number == 5:
                os._exit(7)
            found = certificate(number)
            if fault == "odd error" and number == 5:
                raise OddError("both", "words")
            if fault == "unpicklable" and number == 5:
                found.conditions.append({"a function": lambda: None})
            yield number, [found, found]
    yield SCENES, [certificate(SCENES)]


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_certificates_come_in_order_and_once(workers: int) -> None:
    found = [*prove_side_by_side(partial(scenes, "none"), workers)]
    assert [one.episode_id for one in found] == [*sorted([*range(SCENES)] * 2), SCENES]
    assert os.getpid() not in {one.checked["words"] for one in found}


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ("unread", FormatError, "a.json: cut"),
        ("killed", ClusterError, "signal 9"),
        ("left", ClusterError, "exit code 7"),
        ("unpicklable", AttributeError, "pickle"),
        ("odd error", RuntimeError, "both words"),
    ],
)
def test_what_ends_a_process_ends_the_proof_and_is_told(fault: str, error: type[Exception], message: str) -> None:
    found: list[int | str] = []
    with pytest.raises(error, match=message):
        found.extend(one.episode_id for one in prove_side_by_side(partial(scenes, fault), 2))
    assert set(found) <= set(range(5))
    if fault in ("unread", "unpicklable", "odd error"):
        assert found == sorted([*range(5)] * 2)


def test_a_process_that_can_not_start_is_told() -> None:
    with pytest.raises(AttributeError, match="pickle"):
        next(prove_side_by_side(lambda mine: iter(()), 2))


ORPHANS = """
import os, sys, time
from functools import partial
from jobs.proof_processes import prove_side_by_side

def scenes(mine):
    for number in range(40):
        if mine(number):
            if number == 0:
                print("child", os.getpid(), flush=True)
                time.sleep(600)
            print("child", os.getpid(), flush=True)
            yield number, []
    yield 40, []

if __name__ == "__main__":
    for _ in prove_side_by_side(scenes, 3):
        pass
"""


def test_no_process_outlives_the_one_that_started_it(tmp_path: Path) -> None:
    """The first scene is slow, so that the others wait for a place, one of them with the lock."""
    (tmp_path / "orphans.py").write_text(ORPHANS)
    command = [sys.executable, str(tmp_path / "orphans.py")]
    root = str(Path(__file__).parents[2])
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": root}) as parent:
        assert parent.stdout is not None
        children = set()
        while len(children) < 2:
            children.add(int(parent.stdout.readline().split()[1]))
        parent.kill()
        alive = [psutil.Process(pid) for pid in children if psutil.pid_exists(pid)]
        assert psutil.wait_procs(alive, timeout=20)[1] == []


@pytest.fixture(scope="module")
def made(export: Path, made_run: tuple[Config, Report]) -> tuple[Config, Path]:
    return made_run[0], export


def both(config: Config, folder: Path, tmp_path: Path) -> list[tuple[Report, dict[str, bytes]]]:
    """Return the reports and certificates of one process, and of two."""
    found = []
    for workers in (1, 2):
        own = Path(shutil.copytree(folder, tmp_path / str(workers)))
        report = verify_export(config, own, workers=workers)
        kept = {path.name: path.read_bytes() for path in (own / CERTIFICATES).iterdir()}
        found.append((report, kept))
    return found


def test_two_processes_write_the_same_certificates(made: tuple[Config, Path], tmp_path: Path) -> None:
    (one, its), (two, others) = both(*made, tmp_path)
    assert one.exit_code == two.exit_code == 0
    assert one.document == two.document
    assert its == others
    assert len(its) > 1


def test_two_processes_find_the_same_faults(made: tuple[Config, Path], tmp_path: Path) -> None:
    """A text that says something else, an episode that is there twice, a record without a row."""
    config, whole = made
    folder = Path(shutil.copytree(whole, tmp_path / "folder"))
    manifest = max(folder.glob("manifest/*.jsonl"), key=lambda path: path.stat().st_size)
    lines = manifest.read_bytes().splitlines(keepends=True)
    lines[0] = lines[0].replace(b" is ", b" isn't ", 1).replace(b"there's a", b"there's no", 1)
    manifest.write_bytes(b"".join([*lines[:-1], lines[1]]))
    (one, its), (two, others) = both(config, folder, tmp_path)
    assert one.exit_code == two.exit_code == 3
    assert one.lines[:-1] == two.lines[:-1]  # the last one names the folder
    assert its == others


def test_two_processes_refuse_the_same_export(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, whole = made
    folder = Path(shutil.copytree(whole, tmp_path / "folder"))
    truths = max(folder.glob("vlnce/*/*_gt.json.gz"), key=lambda path: path.stat().st_size)
    truths.write_bytes(gzip.compress(gzip.decompress(truths.read_bytes())[:-9]))
    (one, _), (two, _) = both(config, folder, tmp_path)
    assert one.exit_code == two.exit_code == 3
    assert one.document["faults"] == two.document["faults"]


@pytest.mark.parametrize(
    ("episodes", "cores", "gib", "expected"),
    [
        (2_999, 64, 64, 1),
        (3_000, 64, 64, 2),
        (10**6, 64, 64, 8),
        (10**6, 4, 64, 4),
        (10**6, 64, 2, 2),
        (10**6, 64, 0, 8),
    ],
)
def test_processes_are_as_many_as_are_worth_it_and_have_room(
    monkeypatch: pytest.MonkeyPatch, made: tuple[Config, Path], episodes: int, cores: int, gib: int, expected: int
) -> None:
    """No free memory is known where its number is 0."""
    started: list[int] = []

    def prove(_: object, workers: int) -> Iterator[Certificate]:
        started.append(workers)
        return iter(())

    for name, found in {
        "cores": lambda: cores,
        "memory_available": lambda: gib << 30,
        "prove_side_by_side": prove,
        "load_kernels": lambda note, groups: None,
    }.items():
        monkeypatch.setattr(f"jobs.verify.{name}", found)
    next(jobs.verify._certificates(*made, None, episodes), None)
    assert (started or [1]) == [expected]


PROGRAM = """
import sys
from pathlib import Path
from condvln.kernel_cache import KernelCache
from jobs.verify import verify_export
from jobs.warm_up import PROVEN_WITH, load_kernels
from schemas.config import Config

load_kernels(print, PROVEN_WITH)
load = KernelCache.load_overload

def told(self, signature, context):
    print("not ready:", self._kernel.__module__, self._kernel.__name__, signature)
    return load(self, signature, context)

KernelCache.load_overload = told
config = Config.model_validate_json(sys.argv[1])
assert verify_export(config, Path(sys.argv[2])).exit_code == 0
"""


def test_a_proof_needs_only_the_kernels_loaded_before_it(made: tuple[Config, Path], tmp_path: Path) -> None:
    config, whole = made
    folder = shutil.copytree(whole, tmp_path / "folder")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, config.model_dump_json(), str(folder)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == ""
