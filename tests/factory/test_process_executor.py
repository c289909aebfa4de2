"""What is particular to worker processes of this machine: how they start, share memory, and end."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory import InlineExecutor, LocalStore, StageOutput, machine, run
from factory.commits import Commits
from factory.context import RunContext
from factory.memory import SHARE
from factory.preload import Preload
from factory.process_crew import ProcessCrew
from factory.process_executor import ProcessExecutor
from factory.processes import Processes, WorkerProcess
from factory.ray_executor import RayExecutor
from factory.report import Silence
from jobs.generate import open_executor
from schemas.config import RayConfig
from schemas.errors import ClusterError, FormatError, UsageError
from tests.ending import kill_driver


def children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


# ---- loading


def loads(note: Callable[[str], None], word: str) -> None:
    """Run in the template; workers are forked with what this has set."""
    assert threading.active_count() == 1, "only a process of one thread may be forked"
    note(f"loading {word}")
    os.environ["CONDVLN_TEST_LOADED"] = word


def notes(note: Callable[[str], None], word: str) -> None:
    """Only say so."""
    note(word)


def fails(note: Callable[[str], None]) -> None:
    raise FormatError("the cache is damaged", where="kernels", remedy="Remove it.")


@dataclass(frozen=True)
class Inherits(toys.Count):
    """Fails in a process that has not what `loads` set, or that may use several threads."""

    def run(self, *arguments: Any) -> StageOutput:
        assert (os.environ["CONDVLN_TEST_LOADED"], os.environ["NUMBA_NUM_THREADS"]) == ("once", "1")
        return super().run(*arguments)


def test_what_is_preloaded_is_there_in_every_worker(store: LocalStore) -> None:
    said: list[str] = []
    with ProcessExecutor(2, Preload(__name__, "loads", ("once",)), said.append) as executor:
        report = run(toys.pipeline(Inherits()), toys.units(8), store, executor=executor)
    assert (report.exit_code, report.failures) == (0, [])
    assert said == ["loading once"]


@pytest.mark.parametrize("kind", [InlineExecutor, RayExecutor])
def test_other_executors_load_once_and_in_the_driver(
    kind: type[Any],
) -> None:
    said: list[str] = []
    executor = kind(preload=Preload(__name__, "notes", ("now",)), note=said.append)
    for _ in range(2):
        executor.prepare(1.0)
    assert said == ["now"]


def test_a_run_prepares_its_executor_where_there_is_work_and_only_there(store: LocalStore) -> None:
    said: list[str] = []
    for _ in range(2):
        executor = InlineExecutor(Preload(__name__, "notes", ("now",)), said.append)
        assert run(toys.pipeline(), toys.units(3), store, executor=executor).exit_code == 0
    assert said == ["now"], "the second run has nothing to do"


def test_an_error_while_loading_is_the_run_s(store: LocalStore) -> None:
    before = children()
    with (
        pytest.raises(FormatError, match="the cache is damaged"),
        ProcessExecutor(2, Preload(__name__, "fails")) as executor,
    ):
        run(toys.pipeline(), toys.units(4), store, executor=executor)
    assert children() == before


def test_kernels_are_loaded_before_a_fork_and_leave_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forking a process of several threads could leave a lock held for ever. The thread with which Arrow's allocator
    cleans up is no danger: the allocator takes its locks before a fork and frees them in the child.
    """
    monkeypatch.setattr("jobs.generate._ray_is_up", lambda: False)
    with open_executor(RayConfig(workers=1), False, lambda _: None, ["json scan", "paths"]) as executor:
        assert isinstance(executor, ProcessExecutor)
        processes = executor.start()
        names = [path.read_text().strip() for path in Path(f"/proc/{processes.template}/task").glob("*/comm")]
        assert len([name for name in names if name != "jemalloc_bg_thd"]) == 1


def test_a_script_without_a_guard_for_its_main_part_works(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(
        "import toys\n"
        "from factory import LocalStore, run\n"
        "from factory.process_executor import ProcessExecutor\n"
        "print('once')\n"
        "with ProcessExecutor(2) as executor:\n"
        f"    store = LocalStore({str(tmp_path / 'store')!r})\n"
        "    report = run(toys.pipeline(), toys.units(9), store, executor=executor)\n"
        "print(report.exit_code, report.counts['ok'])\n"
    )
    path = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(
        [sys.executable, str(tmp_path / "script.py")],
        capture_output=True, text=True, timeout=120, check=False, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "once\n0 8\n"), done.stderr


# ---- which executor


@pytest.mark.parametrize(
    ("ray", "kind"), [({"workers": 2}, ProcessExecutor), ({"workers": 2, "address": "local"}, RayExecutor)]
)
def test_ray_is_used_where_it_is_named(ray: dict[str, Any], kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jobs.generate._ray_is_up", lambda: False)
    with open_executor(RayConfig(**ray), False, lambda _: None) as executor:
        assert type(executor) is kind


def test_a_ray_that_this_process_has_started_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: True))
    with open_executor(RayConfig(workers=2), False, lambda _: None) as executor:
        assert isinstance(executor, RayExecutor)
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False))
    with open_executor(RayConfig(workers=2), False, lambda _: None) as executor:
        assert isinstance(executor, ProcessExecutor)


# ---- sharing the machine


class Fake:
    """Stands for a worker's connection and log: takes jobs, and never answers."""

    def send(self, message: object) -> None:
        """Take it."""

    def truncate(self, size: int) -> None:
        """As a log."""


class FakeProcesses(Processes):
    """Processes that start at once and do nothing."""

    def __init__(self) -> None:
        self.all = []
        self.numbers = count(1)
        self._ended = {}

    def fork(self) -> Any:
        process = WorkerProcess(Fake(), Fake(), number=len(self.all) + 1)  # type: ignore[arg-type]
        self.all.append(process)
        return process


@given(
    jobs=st.lists(st.tuples(st.integers(0, 150), st.booleans()), max_size=20),
    most=st.integers(1, 4),
    order=st.randoms(use_true_random=False),
)
def test_jobs_begin_in_their_order_as_far_as_processes_and_memory_go(
    jobs: list[tuple[int, bool]], most: int, order: Any
) -> None:
    processes = FakeProcesses()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "memory_available", lambda: 100 / SHARE)
        crew = ProcessCrew(RunContext(toys.pipeline(), LocalStore("nowhere")), processes, most)
    begun: list[int] = []
    sent = [crew.send((memory, alone), memory, alone=alone) for memory, alone in jobs]  # type: ignore[arg-type]
    while True:
        working = [process.job for process in processes.all if process.job is not None]
        begun += [job[0] for job in working if job[0] not in begun]
        assert len(working) <= most
        assert sum(job[2] for job in working) <= 100 or len(working) == 1
        assert len(working) == 1 or not any(job[3] for job in working)
        if not working:
            break
        done = order.choice([process for process in processes.all if process.job is not None])
        done.job = None
        crew._begin()
    assert begun == sent, "none overtakes another, and none is left waiting"


# ---- ends


class Interrupts(Silence):
    """Raises when the first receipt comes."""

    def unit(self, receipt: object) -> None:
        raise KeyboardInterrupt


def test_a_stopped_run_leaves_no_worker_at_work_and_the_next_goes_on(store: LocalStore, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.mkdir()
    before = children()
    units = [*toys.units(6, log=str(log)), toys.unit("a/slow", 4, seconds=600.0, cost=1.0)]
    with ProcessExecutor(2) as executor:
        with pytest.raises(KeyboardInterrupt):
            run(toys.pipeline(), units, store, executor=executor, progress=Interrupts())
        assert all(process.job is None for process in executor.start().all)
        report = run(toys.pipeline(), units[:-1], store, executor=executor)
        assert (report.exit_code, report.counts["ok"] + report.counts["skipped"]) == (0, 6)
    assert children() == before


def test_a_lost_template_ends_the_run_with_a_word(store: LocalStore) -> None:
    """What was committed stays, and a new executor goes on from it."""

    class Kills(Silence):
        def unit(self, receipt: object) -> None:
            if processes.template in children():
                os.kill(processes.template, signal.SIGKILL)

    units = toys.units(20, seconds=0.1)
    with ProcessExecutor(2) as executor:
        processes = executor.start()
        with pytest.raises(ClusterError, match=r"starts workers has ended. \d+ of the 20 units of this pass were done"):
            run(toys.pipeline(), units, store, executor=executor, progress=Kills())
    with ProcessExecutor(2) as executor:
        report = run(toys.pipeline(), units, store, executor=executor)
    assert (report.exit_code, report.counts["total"]) == (0, 20)


def test_what_a_dead_worker_printed_is_in_its_record(store: LocalStore) -> None:
    with ProcessExecutor(2) as executor:
        report = run(toys.pipeline(), [*toys.units(3), toys.unit("a/x", 4, trouble="abort")], store, executor=executor)
    (failed,) = report.failures
    record = Commits(store).quarantine_record("count", failed[1].key.hex())
    assert record is not None
    assert (record.cause, record.exception) == ("worker", "WorkerError")
    assert "3 workers died" in record.message
    assert "signal SIGABRT" in record.message
    assert "a word of compiled code" in record.message
    assert "misbehave" in record.message, "where it stood"


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("die-with-child", "left by itself with exit code 11"),
        ("print-and-die", "a word of Python"),
        ("signal-and-die", "was ended by signal 40"),
    ],
)
def test_however_a_worker_dies_its_unit_alone_is_blamed(store: LocalStore, trouble: str, said: str) -> None:
    units = [*toys.units(3), toys.unit("a/x", 4, trouble=trouble)]
    with ProcessExecutor(2) as executor:
        report = run(toys.pipeline(), units, store, executor=executor)
        session = executor.start().template
        held = {process.number for process in executor.start().all} | {session}
        left = [one for one in psutil.process_iter() if one.pid not in held and _session(one.pid) == session]
        _, left = psutil.wait_procs([one for one in left if one.status() != psutil.STATUS_ZOMBIE], timeout=5)
    assert not left, "what a worker started ends with it"
    ((name, failure),) = report.failures
    assert (name, report.counts["ok"] + report.counts["skipped"]) == ("a/x", 3)
    assert said in failure.message


def _session(number: int) -> int:
    try:
        return os.getsid(number)
    except ProcessLookupError:
        return 0


class Fails:
    """Can be loaded in the process that made it only."""

    def __init__(self, how: str) -> None:
        self.state = (os.getpid(), how)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        home, how = self.state
        if os.getpid() != home:
            if how == "raises":
                raise ValueError("not here")
            os._exit(9)


@dataclass(frozen=True)
class Unloadable(toys.Count):
    content: Any = None


@pytest.mark.parametrize(
    ("how", "error", "said"),
    [
        ("raises", UsageError, "a worker can't load what the run is made of: ValueError: not here"),
        ("dies", ClusterError, "workers end before they begin to work: the worker left by itself with exit code 9"),
    ],
)
def test_what_can_t_be_loaded_ends_the_run_and_not_the_next(
    tmp_path: Path, how: str, error: type[Exception], said: str
) -> None:
    store = LocalStore(tmp_path / "first")
    with ProcessExecutor(2) as executor:
        assert run(toys.pipeline(), toys.units(3), LocalStore(tmp_path / "zero"), executor=executor).exit_code == 0
        with pytest.raises(error, match=said):
            run(toys.pipeline(Unloadable(content=Fails(how))), toys.units(3), store, executor=executor)
        assert [*Commits(store).quarantined()] == []
        report = run(toys.pipeline(), toys.units(5), LocalStore(tmp_path / "next"), executor=executor)
    assert (report.exit_code, report.counts["total"]) == (0, 5)


def test_an_interrupt_while_a_worker_begins_or_is_given_a_job_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(place: Any, name: str, after: int) -> None:
        real, calls = getattr(place, name), count()

        def method(*arguments: Any) -> Any:
            if next(calls) == after:
                raise KeyboardInterrupt
            return real(*arguments)

        monkeypatch.setattr(place, name, method)

    before = children()
    with ProcessExecutor(2) as executor:
        executor.start()
        for at, (place, name, after) in enumerate(
            [
                (socket, "send_fds", 0),
                (Processes, "_next", 0),
                (Connection, "send", 0),
                (Connection, "send", 1),
                (Connection, "send", 2),
                (ProcessCrew, "returned", 0),
            ]
        ):
            interrupted(place, name, after)
            with pytest.raises(KeyboardInterrupt):
                run(toys.pipeline(), toys.units(5), LocalStore(tmp_path / f"{at}"), executor=executor)
            monkeypatch.undo()
            report = run(toys.pipeline(), toys.units(6), LocalStore(tmp_path / f"after {at}"), executor=executor)
            assert (report.exit_code, report.counts["total"]) == (0, 6)
            assert all(process.number for process in executor.start().all)
    assert children() == before


def test_workers_keep_no_thread_of_an_earlier_run(tmp_path: Path) -> None:
    with ProcessExecutor(1) as executor:
        threads = []
        for at in range(3):
            run(toys.pipeline(), toys.units(2), LocalStore(tmp_path / f"{at}"), executor=executor)
            (process,) = executor.start().all
            time.sleep(0.2)
            threads.append(psutil.Process(process.number).num_threads())
    assert len(set(threads)) == 1


def test_two_runs_at_once_need_an_executor_each(store: LocalStore, tmp_path: Path) -> None:
    class Again(Silence):
        def unit(self, receipt: object) -> None:
            run(toys.pipeline(), toys.units(2), LocalStore(tmp_path / "other"), executor=executor)

    with ProcessExecutor(1) as executor, pytest.raises(UsageError, match="at work for another run"):
        run(toys.pipeline(), toys.units(2), store, executor=executor, progress=Again())


def test_a_driver_may_have_many_files_open(store: LocalStore) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 4096:
        pytest.skip("this user may not open so many files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 4096), hard))
    held = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        with ProcessExecutor(1) as executor:
            assert run(toys.pipeline(), toys.units(3), store, executor=executor).exit_code == 0
    finally:
        for one in held:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize("closed", [[0], [1], [2], [0, 1, 2]], ids=str)
def test_closed_standard_files_cost_nothing(tmp_path: Path, closed: list[int]) -> None:
    code = (
        f"import os\nfor number in {closed}: os.close(number)\n"
        "import toys\n"
        "from factory import LocalStore, run\n"
        "from factory.process_executor import ProcessExecutor\n"
        "with ProcessExecutor(2) as executor:\n"
        f"    store = LocalStore({str(tmp_path / 'store')!r})\n"
        "    report = run(toys.pipeline(), toys.units(4), store, executor=executor)\n"
        f"open({str(tmp_path / 'said')!r}, 'w').write(str(report.exit_code))\n"
    )
    path = os.pathsep.join(filter(None, sys.path))
    subprocess.run([sys.executable, "-c", code], timeout=120, check=True, env={**os.environ, "PYTHONPATH": path})
    assert (tmp_path / "said").read_text() == "0"


def test_workers_that_die_with_nothing_to_do_are_replaced(store: LocalStore) -> None:
    with ProcessExecutor(4) as executor:
        assert run(toys.pipeline(), toys.units(12), store, executor=executor).exit_code == 0
        processes = executor.start()
        while len(processes.all) < 4:
            processes.fork()
        for process in processes.all:
            os.kill(process.number, signal.SIGKILL)
            time.sleep(0.1)  # so that the template notices each by itself
        assert run(toys.pipeline(toys.Count(modulus=7)), toys.units(6), store, executor=executor).counts["ok"] > 0


def test_a_template_that_ends_before_it_reads_is_told(store: LocalStore) -> None:
    with ProcessExecutor(1) as executor:
        processes = executor.start()
        os.kill(processes.template, signal.SIGSTOP)
        threading.Timer(1.0, os.kill, (processes.template, signal.SIGKILL)).start()
        with pytest.raises(ClusterError, match="the process that starts workers has ended"):
            run(toys.pipeline(), toys.units(3), store, executor=executor)


@pytest.mark.parametrize("python", ["", None, "/nowhere/python"])
def test_without_a_python_to_start_the_error_says_so(monkeypatch: pytest.MonkeyPatch, python: str | None) -> None:
    monkeypatch.setattr(sys, "executable", python)
    with ProcessExecutor(1) as executor, pytest.raises(ClusterError, match="can't be started with Python"):
        executor.start()


@contextmanager
def driver(folder: Path, *more: str) -> Iterator[subprocess.Popen[bytes]]:
    """A driver whose workers have begun."""
    log = folder / "log"
    log.mkdir()
    command = [sys.executable, "-m", "drivers", str(folder / "store"), f"--log={log}", "--seconds=0.5"]
    listen = partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen([*command, "--processes=2", *more], stderr=subprocess.PIPE, preexec_fn=listen)
    try:
        while len([*log.iterdir()]) < 3:
            assert process.poll() is None
            time.sleep(0.02)
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_killed_driver_takes_its_workers_along(tmp_path: Path) -> None:
    with driver(tmp_path) as process:
        kill_driver(process)
    report = run(toys.pipeline(), toys.units(60), LocalStore(tmp_path / "store"))
    assert report.exit_code == 0


def test_ctrl_c_at_a_terminal_ends_all_processes(tmp_path: Path) -> None:
    with driver(tmp_path) as process:
        left = psutil.Process(process.pid).children(recursive=True)
        assert len(left) == 3
        process.send_signal(signal.SIGINT)
        process.wait(30)
        _, alive = psutil.wait_procs(left, timeout=10)
        assert not alive


@pytest.mark.parametrize("first", ["the driver", "its workers"])
def test_sigterm_to_all_processes_at_once_stops_the_run_as_one(tmp_path: Path, first: str) -> None:
    """So do systemd and batch systems."""
    with driver(tmp_path) as process:
        everybody = [process.pid, *(child.pid for child in psutil.Process(process.pid).children(recursive=True))]
        for number in everybody if first == "the driver" else everybody[::-1]:
            os.kill(number, signal.SIGTERM)
        _, said = process.communicate(timeout=60)
    assert said.decode().splitlines()[-1].startswith("KeyboardInterrupt")


def test_a_lost_template_leaves_no_worker(store: LocalStore) -> None:
    numbers: list[int] = []

    def kill() -> None:
        numbers.extend(process.number for process in processes.all)
        os.kill(processes.template, signal.SIGKILL)

    with ProcessExecutor(1) as executor:
        processes = executor.start()
        threading.Timer(2.0, kill).start()
        with pytest.raises(ClusterError):
            run(toys.pipeline(), [toys.unit("a/slow", 4, seconds=600.0)], store, executor=executor)
    assert len(numbers) == 1
    end = time.monotonic() + 10.0
    while psutil.pid_exists(numbers[0]) and psutil.Process(numbers[0]).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_what_a_stage_started_ends_with_a_stopped_run(tmp_path: Path, how: signal.Signals) -> None:
    with driver(tmp_path, "--trouble=child") as process:
        end = time.monotonic() + 20.0
        while not any(child.name() == "sleep" for child in psutil.Process(process.pid).children(recursive=True)):
            assert time.monotonic() < end
            time.sleep(0.02)
        left = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(how)
        process.wait(30)
        _, alive = psutil.wait_procs(left, timeout=10)
        assert not alive
