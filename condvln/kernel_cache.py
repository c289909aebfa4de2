"""The cache of compiled kernels on disk, keyed on what numba compiles.

numba's own cache is keyed on the path and the modification time of a kernel's file: another checkout or environment
compiles everything again, and a change in another file that the kernel calls goes unnoticed. Here the key is a digest
of the kernel's bytecode and constants, of the values of all global names that it uses, and of all kernels that it
calls, wherever they are. Comments, docstrings, paths and times do not count. The types of the arguments (with the
fields of named tuples), the CPU and the versions of Python, numba, llvmlite and numpy are part of the key too.

One file holds one kernel for one signature, so that processes that compile side by side never share a file with
different content. A file that is damaged, or that another version wrote, counts as absent.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import secrets
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from numba.core import config as numba_config
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from numba.core.types.containers import BaseNamedTuple, BaseTuple
from numba.extending import _Intrinsic

__all__ = ["KernelCache", "cache_folders", "can_be_kept", "kernel_digest"]

VERSIONS_KEPT: Final = 24
"""Number of files kept per kernel, the last used ones: a few signatures of a few checkouts."""
_SETTINGS: Final = ("BOUNDSCHECK", "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "ENABLE_AVX")
"""numba's settings that change the code it makes."""
_CHECKSUM_BYTES: Final = 32


def cache_folders(kernel: Callable[..., object]) -> Iterator[Path]:
    """Yield the folders that may hold a kernel, in the order in which they are tried: ``NUMBA_CACHE_DIR`` alone if it
    is set, else the user's cache folder and ``__pycache__`` beside the kernel.
    """
    if numba_config.CACHE_DIR:
        yield Path(numba_config.CACHE_DIR)
        return
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    yield Path(home) / "condvln" / "kernels"
    yield Path(kernel.__code__.co_filename).resolve().parent / "__pycache__"


def can_be_kept(kernel: Callable[..., object]) -> bool:
    """Return whether a folder for a kernel's machine code is writable, so that other processes find the code there."""
    for folder in cache_folders(kernel):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return True
    return False


class KernelCache:
    """The cache of one kernel, in the place of numba's ``FunctionCache``.

    not_stored : called when no folder is writable
    """

    def __init__(self, kernel: FunctionType, options: object, not_stored: Callable[[], None]) -> None:
        self._kernel, self._options, self._not_stored = kernel, repr(options), not_stored
        self._digest: str | None = None  # Known at the first call only: until then names may not be bound.

    @property
    def cache_path(self) -> str:
        """The path of the first folder in which the compiled kernel is looked for."""
        return str(next(cache_folders(self._kernel)))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the compiled kernel, or None if no folder holds it."""
        context.refresh()
        name = self._name(signature, context.codegen())
        for folder in cache_folders(self._kernel):
            with suppress(OSError):
                content = (folder / name).read_bytes()
                checksum, data = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
                if hashlib.sha256(data).digest() != checksum:
                    continue
                with suppress(OSError):
                    os.utime(folder / name)  # the last used ones are kept
                return CompileResult._rebuild(context, *pickle.loads(data))
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store a compiled kernel in the first folder that is writable."""
        if result.library.has_dynamic_globals or any(not part.can_cache for part in result.lifted):
            return
        data = dumps(result._reduce())
        content = hashlib.sha256(data).digest() + data
        name = self._name(signature, result.codegen)
        for folder in cache_folders(self._kernel):
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                _write(folder / name, content)
                self._forget_old(folder)
                return
        self._not_stored()

    def enable(self) -> None:
        """The cache is always on."""

    def disable(self) -> None:
        """The cache is always on."""

    def flush(self) -> None:
        """There is nothing to flush: a file is never changed."""

    def _name(self, signature: Any, codegen: Any) -> str:
        if self._digest is None:
            self._digest = kernel_digest(self._kernel)
        settings = [getattr(numba_config, name, None) for name in _SETTINGS]
        versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
        key = (self._digest, _described(signature), self._options, codegen.magic_tuple(), settings, versions)
        return f"{self._stem()}{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}.nbc"

    def _stem(self) -> str:
        return f"{self._kernel.__module__}.{self._kernel.__qualname__.replace('<', '').replace('>', '')}-"

    def _forget_old(self, folder: Path) -> None:
        found = [path for path in folder.glob(f"{self._stem()}*.nbc") if len(path.name) == len(self._stem()) + 28]
        if len(found) > VERSIONS_KEPT:
            with suppress(OSError):
                found.sort(key=lambda path: path.stat().st_mtime, reverse=True)
                for path in found[VERSIONS_KEPT:]:
                    path.unlink()


def kernel_digest(kernel: FunctionType) -> str:
    """Return a digest of everything that determines a kernel's machine code, except the types of the kernel's
    arguments.
    """
    found: dict[FunctionType, str] = {}
    ahead = [kernel]
    while ahead:
        function = ahead.pop()
        if function not in found:
            found[function], called = _content(function)
            ahead += called
    return hashlib.sha256(repr((found[kernel], sorted(found.values()))).encode()).hexdigest()


@cache
def _content(function: FunctionType) -> tuple[str, tuple[FunctionType, ...]]:
    """Return the digest of one function, and the kernels that the function calls. In the digest, these kernels count by
    name only, not by content.
    """
    code = function.__code__
    names = {name: function.__globals__[name] for name in _names(code) if name in function.__globals__}
    cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
    content = (
        _name_of(function),
        _code(code, function.__doc__),
        _value((function.__defaults__, tuple((function.__kwdefaults__ or {}).items()), cells)),
        [(name, _value(value)) for name, value in sorted(names.items())],
    )
    called = tuple(value.py_func for value in (*names.values(), *cells) if isinstance(value, Dispatcher))
    return hashlib.sha256(repr(content).encode()).hexdigest(), called


def _name_of(function: FunctionType) -> tuple[str, str]:
    return function.__module__, function.__qualname__


def _names(code: CodeType) -> set[str]:
    """Return the names of globals and attributes that a function uses, and those that the functions defined within it
    use.
    """
    inner = (const for const in code.co_consts if isinstance(const, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _code(code: CodeType, doc: str | None = None) -> object:
    consts = [_code(const) if isinstance(const, CodeType) else _value(const) for const in code.co_consts]
    if doc is not None and code.co_consts and code.co_consts[0] == doc:
        consts[0] = _value(None)  # as in a function without a docstring
    variables = (code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount, code.co_kwonlyargcount)
    return code.co_code.hex(), consts, code.co_names, variables, code.co_flags


def _value(value: object) -> object:
    """Return the content of a value that a kernel uses, as plain data whose ``repr`` is the same in each process, or is
    never the same if the content of such a value is unknown.
    """
    if isinstance(value, Dispatcher):
        return "kernel", _name_of(value.py_func)
    if isinstance(value, np.ndarray | np.generic):
        return "array", str(value.dtype), np.shape(value), np.asarray(value).tobytes().hex()
    if isinstance(value, frozenset):
        return "set", sorted(repr(_value(part)) for part in value)
    if isinstance(value, tuple):
        return type(value).__qualname__, getattr(value, "_fields", None), [_value(part) for part in value]
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return type(value).__name__, repr(value)
    if isinstance(value, ModuleType):
        return "module", value.__name__, _own_file(value)
    if isinstance(value, type):
        return "class", value.__module__, value.__qualname__, getattr(value, "_fields", None)
    if isinstance(value, np.dtype | numba.types.Type):
        return "type", type(value).__qualname__, repr(value)
    if isinstance(value, _Intrinsic):
        module = sys.modules[value._defn.__module__]  # of this package, the whole module counts
        return "intrinsic", _name_of(value._defn), _own_file(module) or _content(value._defn)[0]
    if isinstance(value, np.ufunc | BuiltinFunctionType):
        return "function", getattr(value, "__module__", None), value.__name__
    # Nothing says what else may hold. A kernel that uses it is compiled in each process; a stale one would be wrong.
    return "unknown", secrets.token_hex()


def _own_file(module: ModuleType) -> str:
    """Return the source text of a module of this package, since a kernel may read constants from the module; empty for
    any other module.
    """
    file = getattr(module, "__file__", None)  # a module that is part of Python's program has none
    return Path(file).read_text() if file is not None and module.__name__.split(".")[0] == "condvln" else ""


def _described(signature: Any) -> object:
    """Return the types of arguments as texts, nested as in `signature`; a named tuple also has its class and its
    fields.
    """
    if isinstance(signature, BaseNamedTuple):
        owner = signature.instance_class
        inner = [_described(one) for one in signature]
        return owner.__module__, owner.__qualname__, signature.fields, inner
    if isinstance(signature, tuple | BaseTuple):
        return [_described(one) for one in signature]
    owner = type(signature)
    return str(signature) if owner.__module__.startswith("numba.") else (owner.__module__, str(signature))


def _write(path: Path, content: bytes) -> None:
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(content)
        os.replace(name, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(name)
        raise
