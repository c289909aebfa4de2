"""Where compiled kernels are kept, and what is said while they compile. Each case runs in a process of its own."""

from __future__ import annotations

import dis
import importlib
import inspect
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import CodeType, FunctionType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import TypingError
from numba.typed import List

import condvln
import condvln.navigation
from condvln.compiled import compiled
from condvln.uncounted import keep, uncounted

KERNEL = """
import sys
sys.path.insert(0, {folder!r})
from kernel import double
print(double(21))
"""
SOURCE = """
from condvln.compiled import compiled
@compiled
def double(x):
    return 2 * x
"""
TELLING = (
    SOURCE
    + """
from numba.core import event
class Listener(event.Listener):
    def on_start(self, event):
        print("compiling")
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())
"""
)


@pytest.fixture
def kernels(tmp_path: Path) -> Path:
    """A folder that holds one small kernel."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "kernel.py").write_text(SOURCE)
    return folder


def run(kernels: Path, home: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Import and call the kernel with this home folder and environment."""
    variables = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    variables |= {"HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    code = KERNEL.format(folder=str(kernels))
    return subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True)


def cached(folder: Path) -> list[Path]:
    """Files of the cache below a folder; one is written when a kernel compiles."""
    return sorted(folder.rglob("*.nbc"))


def test_the_named_folder_is_the_only_one_and_is_used_again(kernels: Path, tmp_path: Path) -> None:
    for _ in range(2):
        done = run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert done.stdout == "42\n"
        assert len(cached(tmp_path)) == len(cached(tmp_path / "cache")) == 1


def test_a_copy_elsewhere_with_other_times_and_comments_compiles_nothing(kernels: Path, tmp_path: Path) -> None:
    """Another checkout or environment of the same user; the first run alone says that it compiles."""
    (kernels / "kernel.py").write_text(TELLING)
    assert "compiling" in run(kernels, tmp_path / "home").stdout
    copy = tmp_path / "other" / "kernels"
    copy.mkdir(parents=True)
    said = TELLING.replace("return", '"""Twice x."""\n    # by two\n    return')
    (copy / "kernel.py").write_text(f"\n\n{said}")
    assert run(copy, tmp_path / "home").stdout == "42\n"
    assert len(cached(tmp_path / "home" / ".cache" / "condvln")) == len(cached(tmp_path)) == 1


def test_a_kernel_may_use_a_module_without_a_file(kernels: Path, tmp_path: Path) -> None:
    """In the Python of Debian, ``math`` is part of the program."""
    builtin = "import math\nmath.__dict__.pop('__file__', None)\n"
    (kernels / "kernel.py").write_text(builtin + SOURCE.replace("2 * x", "2 * x + math.floor(0.5)"))
    assert run(kernels, tmp_path).stdout == "42\n"
    assert len(cached(tmp_path)) == 1
    assert run(kernels, tmp_path).stdout == "42\n"
    assert len(cached(tmp_path)) == 1


def test_where_the_home_cannot_be_written_the_cache_lies_beside_the_kernels(kernels: Path, tmp_path: Path) -> None:
    (tmp_path / "home").write_text("a file where the folder would be")
    run(kernels, tmp_path / "home")
    assert len(cached(kernels / "__pycache__")) == 1


def test_with_nowhere_to_write_kernels_still_run(kernels: Path, tmp_path: Path) -> None:
    (kernels / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    done = run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "home"))
    assert done.stdout == "42\n"
    assert not cached(tmp_path)


CALLER = """
from condvln.compiled import compiled
from far.away import CONSTANT, Pair, callee
@compiled
def summed(pair):
    return pair.one + callee(pair.other) * CONSTANT
def double(x):
    return summed(Pair(x, x))
"""
CALLEE = """
from typing import NamedTuple
from condvln.compiled import compiled
CONSTANT = 1
class Pair(NamedTuple):
    one: int
    other: int
@compiled
def callee(x):
    return deeper(x)
@compiled
def deeper(x):
    return x
"""
EDITS = {
    "return x\n": ("return x + 1\n", 43),
    "CONSTANT = 1": ("CONSTANT = 2", 63),
    "one: int\n    other: int": ("other: int\n    one: int", 42),
}


@pytest.mark.parametrize("decorator", ["compiled", "inlined"])
@pytest.mark.parametrize("edit", EDITS)
def test_a_change_in_another_folder_is_noticed(kernels: Path, tmp_path: Path, edit: str, decorator: str) -> None:
    """Of what a callee's callee does, of a constant, and of the order of a tuple's fields."""
    source = CALLEE.replace("compiled\n", f"{decorator}\n")
    (kernels / "far").mkdir()
    (kernels / "kernel.py").write_text(CALLER)
    callee = kernels / "far" / "away.py"
    callee.write_text(source)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(kernels, tmp_path / "home", **environment).stdout == "42\n"
    before = len(cached(tmp_path))
    callee.write_text(source.replace(edit, EDITS[edit][0]))
    assert run(kernels, tmp_path / "home", **environment).stdout == f"{EDITS[edit][1]}\n"
    assert len(cached(tmp_path)) > before


@pytest.mark.parametrize(("one", "files"), [("constant(1)", 2), ("1", 3)])
def test_a_constant_does_not_compile_its_kernel_once_more(kernels: Path, tmp_path: Path, one: str, files: int) -> None:
    """As an integer of Python does, for whose value alone numba compiles the kernel."""
    source = f"""
from condvln.compiled import compiled, constant
ONE = {one}
@compiled
def callee(x, more):
    return x + more
@compiled
def double(x):
    return callee(x, ONE) + callee(x, x)
"""
    (kernels / "kernel.py").write_text(source)
    assert run(kernels, tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "cache")).stdout == "64\n"
    assert len(cached(tmp_path)) == files


INTRINSIC = """
from numba import types
from numba.extending import intrinsic
from condvln.compiled import compiled
@intrinsic
def times(typing, x):
    return x(x), lambda context, builder, signature, native: builder.mul(native[0], native[0].type(2))
@compiled
def double(x):
    return times(x)
"""


def test_a_kernel_that_uses_an_intrinsic_is_kept_until_what_it_does_changes(kernels: Path, tmp_path: Path) -> None:
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for text, answer, files in (
        (INTRINSIC, 42, 1),
        (INTRINSIC, 42, 1),
        (INTRINSIC.replace("type(2)", "type(3)"), 63, 2),
    ):
        (kernels / "kernel.py").write_text(text)
        assert run(kernels, tmp_path / "home", **environment).stdout == f"{answer}\n"
        assert len(cached(tmp_path)) == files


class Pair(NamedTuple):
    numbers: npt.NDArray[np.float64]
    count: int
    inner: tuple[npt.NDArray[np.int64], bool]


@compiled
def _callee(pair: Pair, k: int) -> float:
    if k > 3:
        return 0.0
    pair.inner[0][k] += 1
    return float(pair.numbers[k] * pair.count)


@compiled
def _caller(pair: Pair, rounds: int) -> tuple[float, float]:
    pair = uncounted(pair)
    held = (np.zeros(8), np.zeros((2, 8)))
    total, rows = uncounted(held)
    row = rows[1]
    for i in range(rounds):
        other = np.full(8, 7.0)  # would get the memory of `held` if that had been freed
        total[i % 8] += _callee(pair, i % 6)
        row[i % 8] += other[i % 8] - 6.0
    keep(held)
    return total.sum(), row.sum()


def test_uncounted_arrays_are_the_same_memory_and_live_as_long_as_they_are_kept() -> None:
    numbers, seen = np.arange(1.0, 5.0), np.zeros(4, np.int64)
    references = sys.getrefcount(numbers), sys.getrefcount(seen)
    for _ in range(3):
        seen[:] = 0
        assert _caller(Pair(numbers, 2, (seen, True)), 600) == (2000.0, 600.0)
        assert seen.tolist() == [100] * 4
    assert (sys.getrefcount(numbers), sys.getrefcount(seen)) == references


@compiled
def _copied(numbers: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    return uncounted(numbers)[1:].copy(), np.empty_like(uncounted(numbers))


def test_a_copy_of_an_uncounted_array_is_counted() -> None:
    """Else nothing would free it."""
    copied, alike = _copied(np.arange(3.0))
    assert copied.tolist() == [1.0, 2.0]
    assert alike.shape == (3,)


def test_what_would_not_be_freed_or_held_does_not_compile() -> None:
    @compiled
    def first(texts: list[float]) -> float:
        return uncounted(texts)[0]

    @compiled
    def view(numbers: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return uncounted(numbers)[1:]

    with pytest.raises(TypingError, match="references to ListType"):
        first(List([1.0]))
    with pytest.raises(TypingError, match="can't be returned to Python"):
        view(np.zeros(2))


def test_kernels_that_one_place_calls_are_inlined_there_and_no_others() -> None:
    """Inlined at two places, a kernel would be compiled twice; one that Python calls is compiled by itself anyway.

    The kernels that rasterise triangles are faster if they are compiled apart. So are the kernels of stops whose rare
    parts, which allocate, stay calls: a part that may fail makes a kernel count the references of all its arrays. A
    candidate is drawn by four kernels: one that holds all of them takes twice as long to compile.
    """
    rare_parts = {"_closes_cycle", "_draw_label", "_search"}
    large_parts = {"_finish", "draw_conditions", "draw_stops"}
    package = Path(condvln.__path__[0])
    for path in sorted(package.rglob("*.py")):
        if re.search(r"condvln\.compiled|kernels|navigation\.recast", path.read_text()):
            importlib.import_module(".".join(path.relative_to(package.parent).with_suffix("").parts))
    places: Counter[Dispatcher] = Counter()
    called_from_python: set[Dispatcher] = set()
    kernels: set[Dispatcher] = set()
    for module in [module for name, module in sys.modules.items() if name.startswith("condvln.")]:
        for value in vars(module).values():
            if isinstance(value, Dispatcher):
                if value.py_func.__module__ == module.__name__:
                    kernels.add(value)
                    places.update(used_in(value.py_func.__code__, vars(module)))
            elif isinstance(value, FunctionType | type) and value.__module__ == module.__name__:
                for code in codes_of(value):
                    called_from_python.update(used_in(code, vars(module)))
    expected = {kernel for kernel in kernels if places[kernel] == 1 and kernel not in called_from_python}
    apart = {kernel for kernel in kernels if not kernel.targetoptions["no_cfunc_wrapper"]}
    assert {kernel.py_func.__module__ for kernel in apart} == {"condvln.navigation.recast.heightfield"}
    expected -= apart
    found = {kernel for kernel in kernels if kernel.targetoptions.get("inline") == "always"}
    assert {kernel.py_func.__qualname__ for kernel in found ^ expected} == rare_parts | large_parts
    assert not (rare_parts | large_parts) & {kernel.py_func.__qualname__ for kernel in found}


def used_in(code: CodeType, names: Mapping[str, object]) -> Iterator[Dispatcher]:
    """Yield a kernel as often as `code`, or code within it, names it."""
    for instruction in dis.get_instructions(code):
        used = names.get(str(instruction.argval)) if instruction.opname == "LOAD_GLOBAL" else None
        if isinstance(used, Dispatcher):
            yield used
    for const in code.co_consts:
        if isinstance(const, CodeType):
            yield from used_in(const, names)


def codes_of(value: FunctionType | type) -> Iterator[CodeType]:
    """Yield the code of a function, or of all methods and properties of a class."""
    members = vars(value).values() if isinstance(value, type) else (value,)
    for member in members:
        for name in ("fget", "func", "__func__"):
            member = getattr(member, name, member)
        if isinstance(member, FunctionType):
            yield inspect.unwrap(member).__code__


GLOBALS = {
    "a type": ("import numba\nONE = numba.int64\n", "numba.int64", "numba.int8", "ONE(x * 200) // 100"),
    "a record's dtype": (
        "import numpy as np\nONE = np.dtype([('a', 'f8')])\n",
        "'f8'",
        "'i1'",
        "np.zeros(1, ONE)['a'].itemsize + 2 * x - 8",
    ),
}


@pytest.mark.parametrize("kind", GLOBALS)
def test_a_changed_global_of_any_kind_is_noticed(kernels: Path, tmp_path: Path, kind: str) -> None:
    head, old, new, expression = GLOBALS[kind]
    source = head + SOURCE.replace("2 * x", expression)
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    (kernels / "kernel.py").write_text(source)
    assert run(kernels, tmp_path / "home", **environment).stdout == "42\n"
    (kernels / "kernel.py").write_text(source.replace(old, new))
    assert run(kernels, tmp_path / "home", **environment).stdout != "42\n"


def test_a_damaged_file_is_written_again(kernels: Path, tmp_path: Path) -> None:
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    run(kernels, tmp_path / "home", **environment)
    (file,) = cached(tmp_path)
    whole = file.read_bytes()
    file.write_bytes(whole[:-100] + bytes(100))
    assert run(kernels, tmp_path / "home", **environment).stdout == "42\n"
    assert file.read_bytes() != whole[:-100] + bytes(100)


def test_progress_is_told_while_kernels_compile(tmp_path: Path) -> None:
    """Cold: each step and each kernel by name. From the cache: the steps only."""
    code = (
        "from condvln.compiled import register_warm_up, warm_up, compiled\n"
        "from condvln.navigation.kernels.geometry import distance\n"
        "import numpy as np\n"
        "register_warm_up('geometry', lambda: distance(*[np.float32(0)] * 6))\n"
        "warm_up(print)"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    lines = [
        subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for _ in range(2)
    ]
    step = "navigation kernels 1/1: geometry"
    assert lines == [[step, "compiling condvln.navigation.kernels.geometry.distance"], [step]]


def test_what_the_cache_lacks_is_refused_as_often_as_it_is_asked_for(tmp_path: Path) -> None:
    code = (
        "from condvln.compiled import load_cached, register_warm_up, warm_up, compiled\n"
        "from condvln.navigation.kernels.geometry import distance\n"
        "import numpy as np\n"
        "register_warm_up('geometry', lambda: distance(*[np.float32(0)] * 6))\n"
        "print([load_cached(['geometry']) for _ in range(4)], distance.signatures)\n"
        "warm_up(print)\n"
        "print(load_cached(['geometry']))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "[False, False, False, False] []",
        "navigation kernels 1/1: geometry",
        "compiling condvln.navigation.kernels.geometry.distance",
        "True",
    ]


def test_public_names_load_on_first_use() -> None:
    assert set(condvln.navigation.__all__) == set(condvln.navigation._MODULE_OF)
    for name in condvln.navigation.__all__:
        assert getattr(condvln.navigation, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        condvln.navigation.nothing  # noqa: B018
    code = "import sys, condvln.navigation.settings; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
