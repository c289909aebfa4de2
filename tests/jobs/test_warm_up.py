"""All kernels are compiled ahead, each group by the module that registers it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from rich.console import Console

from condvln.samples import make_samples
from jobs.generate import run_generate
from jobs.warm_up import GENERATED_WITH, KERNEL_MODULES, compile_kernels
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.program import CATEGORIES


def test_every_group_that_is_registered_is_compiled(repository: Path) -> None:
    found = {}
    for file in (repository / "condvln").rglob("*.py"):
        for name in re.findall(r'^register_warm_up\("([^"]+)"', file.read_text(encoding="utf-8"), re.MULTILINE):
            found[name] = ".".join(file.relative_to(repository).with_suffix("").parts)
    assert found == KERNEL_MODULES


PROGRAM = """
import io, sys
from pathlib import Path
from rich.console import Console
from condvln.bias import regression
from condvln.kernel_cache import KernelCache
from condvln.samples import make_samples
from jobs.generate import run_generate
from jobs.verify import verify_export
from jobs.warm_up import BUILDER, GENERATED_WITH, load_kernels
from schemas.config import Config, InstructionsConfig, SourceConfig
from schemas.program import CATEGORIES

folder, family = Path(sys.argv[1]), sys.argv[2]
make_samples(folder / "data", family=family, scenes=4, seed=3)
load_kernels(lambda line: None, {*GENERATED_WITH, BUILDER} if family == "procthor" else GENERATED_WITH)
load = KernelCache.load_overload

def told(self, signature, context):
    print("not ready:", self._kernel.__module__, self._kernel.__name__, signature)
    return load(self, signature, context)

KernelCache.load_overload = told
direction, fitted = regression.newton_direction, []
regression.newton_direction = lambda *arguments: fitted.append(1) or direction(*arguments)
config = Config(
    name=family, store=folder / "store", export=folder / "export",
    sources=(SourceConfig(family=family, root=folder / "data"),),
    instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 12)),
)
report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
assert report.exit_code == 0, report.lines
assert fitted
assert verify_export(config, folder / "export").exit_code == 0
"""


@pytest.mark.parametrize("family", ["procthor", "replicacad"])
def test_a_run_needs_only_the_kernels_loaded_before_it(tmp_path: Path, family: str) -> None:
    """With a navmesh that is built, and with one that is shipped: generation, export with regressions, proof. In a
    process of its own, which prints each kernel that it needs but has not loaded.
    """
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path), family], capture_output=True, text=True, check=True
    )
    assert done.stdout == ""


def test_what_the_cache_holds_is_not_compiled_again() -> None:
    said: list[str] = []
    compile_kernels(said.append, ("json scan",))
    report = compile_kernels(said.append, ("json scan",))
    assert report.document == {"compiled": {"json scan": 0}}
    assert said[-1] == "kernels 1/1: json scan, 0 compiled"


LOADED = """
import sys
from pathlib import Path
from jobs.warm_up import load_kernels
sys.path.append(Path("no text"))  # Python skips such entries
load_kernels(lambda line: print(line, flush=True), ["stops passed", "json scan"])
"""


def loaded(folder: Path) -> list[str]:
    """Load two groups in a process of its own, whose cache is `folder`, and return what was told."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED], capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
    )  # fmt: skip
    return done.stdout.splitlines()


def test_what_the_cache_lacks_is_compiled_side_by_side_and_kept(tmp_path: Path) -> None:
    first, *later = loaded(tmp_path)
    assert first == "compiling 2 groups of kernels"
    # As they are done: in processes of their own. This one loads both groups after that and compiles nothing.
    assert {line.partition(": ")[2].partition(",")[0] for line in later} == {"stops passed", "json scan"}
    assert loaded(tmp_path) == []


# What runs in the background of a shell ignores Ctrl-C, and Python leaves it so.
INTERRUPTIBLE = f"import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n{LOADED}"


@contextmanager
def compiling(folder: Path) -> Iterator[tuple[subprocess.Popen[str], list[psutil.Process]]]:
    """Start a process that compiles two groups, and yield it with its children as soon as all of them are there."""
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder)}, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "compiling 2 groups of kernels\n"
        deadline = time.monotonic() + 60
        while len(others := psutil.Process(process.pid).children(recursive=True)) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        yield process, others
    assert psutil.wait_procs(others, timeout=20)[1] == []


def test_a_compiler_that_is_killed_leaves_nothing_behind(tmp_path: Path) -> None:
    """What it has not compiled is compiled where it is needed."""
    with compiling(tmp_path) as (process, others):
        next(one for one in others if one.ppid() == process.pid).kill()
        said, _ = process.communicate()
    assert process.returncode == 0
    assert "compiling condvln." in said


@pytest.mark.parametrize("to", [os.kill, os.killpg], ids=["the process", "its group, as a terminal does"])
def test_ctrl_c_while_kernels_compile_ends_all_processes(tmp_path: Path, to: Callable[[int, int], None]) -> None:
    with compiling(tmp_path) as (process, _):
        to(process.pid, signal.SIGINT)
        _, said = process.communicate()
    assert process.returncode == -signal.SIGINT
    assert said.count("Traceback") == 1, said  # this process's own; the command's is one line


def test_kernels_are_loaded_only_before_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_samples(tmp_path / "data", family="replicacad", scenes=2, seed=3)
    config = Config(
        name="two", store=tmp_path / "store",
        sources=(SourceConfig(family="replicacad", root=tmp_path / "data"),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, 1)),
    )  # fmt: skip
    asked: list[Collection[str]] = []
    monkeypatch.setattr("jobs.warm_up.load_kernels", lambda note, groups: asked.append(groups))
    assert run_generate(config, inline=True, console=Console(quiet=True)).exit_code == 0
    assert asked == [sorted(GENERATED_WITH)]
    assert run_generate(config, inline=True, console=Console(quiet=True)).exit_code == 0
    assert len(asked) == 1


def test_without_a_folder_for_kernels_no_other_process_compiles_them(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert [line for line in loaded(tmp_path / "file" / "none") if line.startswith("kernels ")] == []


COLD = """
import importlib, sys
from numba.core import types
from numba.core.dispatcher import Dispatcher
from condvln.compiled import warm_up
from jobs.warm_up import KERNEL_MODULES

groups = sys.argv[1:]
for group in groups:
    importlib.import_module(KERNEL_MODULES[group])
warm_up(only=groups)
kernels = {
    kernel for name, module in sys.modules.items() if name.startswith("condvln.")
    for kernel in vars(module).values() if isinstance(kernel, Dispatcher)
}
print(sum(bool(kernel.signatures) for kernel in kernels))
for kernel in kernels:
    for signature in kernel.signatures:
        if len(kernel.signatures) > 1 and any(isinstance(one, types.Literal) for one in signature):
            print(kernel.py_func.__name__)
"""


@pytest.mark.soak
def test_no_kernel_is_compiled_once_more_for_the_value_of_a_literal(tmp_path: Path) -> None:
    """With an empty cache, in the two groups that do most; kernels of a few lines may be."""
    groups = ["candidates", "follower"]
    done = subprocess.run(
        [sys.executable, "-c", COLD, *groups], capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    count, *twice = done.stdout.splitlines()
    assert int(count) > 40
    assert set(twice) <= {"_any", "_append", "cumulative", "index"}
