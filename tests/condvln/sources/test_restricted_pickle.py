"""The pickle machine without its teeth."""

from __future__ import annotations

import os
import pickle
import pickletools
import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.sources.scene_graph import UnsafePickleError, load_plain, plain
from tests.broken_bytes import broken

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3) | st.tuples(inner, inner),
    max_leaves=12,
)
protocols = st.sampled_from([2, 3, 4])


@given(values, protocols)
def test_plain_data_is_what_it_was(value: Any, protocol: int) -> None:
    assert load_plain(pickle.dumps(value, protocol)) == value


ARRAYS = [
    np.array([1.5, -2, 3]),
    np.array([[1, 2], [3, 4]], dtype=np.int32),
    np.array([[1, 2, 3], [4, 5, 6]], order="F"),
    np.array([1, 2], dtype=">f4"),
    np.array(True),
    np.array(["bed", "microwave"]),
    np.array([], dtype=np.uint8),
]


@pytest.mark.parametrize("array", ARRAYS, ids=str)
@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_arrays_are_what_they_were(array: np.ndarray, protocol: int) -> None:
    assert plain(load_plain(pickle.dumps(array, protocol)), 10) == array.tolist()


@pytest.mark.parametrize("number", [np.float64(1.5), np.int64(-7), np.float32(0.25), np.bool_(True), np.str_("sofa")])
@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_numpy_numbers_are_numbers(number: Any, protocol: int) -> None:
    assert load_plain(pickle.dumps(number, protocol)) == number


def test_an_array_that_is_larger_than_wanted_is_not_spread_out() -> None:
    loaded = load_plain(pickle.dumps(np.zeros(1000), 4))
    with pytest.raises(UnsafePickleError, match=r"1000 items \(at most 3 are allowed\)"):
        plain(loaded, 3)


class Runs:
    """Runs a command when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.path}",)


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
def test_a_command_is_not_run(tmp_path: Path, protocol: int) -> None:
    data = pickle.dumps({"object": Runs(tmp_path / "ran")}, protocol)
    with pytest.raises(UnsafePickleError, match=r"the name (posix|nt)\.system is not allowed|not a valid pickle"):
        load_plain(data)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "data",
    [
        b"cos\nsystem\n(S'true'\ntR.",
        b"c__builtin__\neval\n(S'1'\ntR.",
        b"cbuiltins\ngetattr\n(cnumpy\nndarray\nS'x'\ntR.",
        b"cnumpy.f2py.crackfortran\nmyeval\n(S'1'\ntR.",
        b"(S'true'\nios\nsystem\n.",
        b"(cnumpy\ndtype\nS'f8'\no.",
        b"P1\n.",
        b"N\x51.",
        b"\x80\x04\x8c\x05numpy\x8c\x07ndarray\x93)\x81.",
        b"\x82\x01.",
        b"cnumpy.core.multiarray\n_reconstruct\n}S'x'\nI1\nsb.",
        b"cnumpy.core.multiarray\n_reconstruct\nN}S'value'\nI1\ns\x86b.",
        b"cnumpy.core.multiarray\n_reconstruct.__globals__\n.",
        b"cnumpy\nndarray\n(I1000000000000\ntR.",
        b"]}b.",
    ],
)
def test_other_ways_in_are_refused(data: bytes) -> None:
    with pytest.raises(UnsafePickleError):
        load_plain(data)


def array_state(shape: tuple[int, ...], dtype: str, content: Any) -> bytes:
    class Faked:
        def __reduce__(self) -> Any:
            make, arguments, _ = np.zeros(1).__reduce__()  # type: ignore[misc]
            return make, arguments, (1, shape, np.dtype(dtype), False, content)

    return pickle.dumps(Faked(), 4)


@pytest.mark.parametrize(
    ("shape", "dtype", "content"),
    [
        ((10**10,), "f8", b"12345678"),
        ((-1,), "f8", b""),
        ((2**40, 2**40), "f8", b""),
        ((3,), "f8", b"1234567"),
        ((1,) * 40, "f8", b"12345678"),
        ((2,), "O", [1]),
        ((1,), "V8", b"12345678"),
        ((1,), "O", None),
    ],
)
def test_an_array_that_claims_what_is_not_there_is_refused(shape: tuple[int, ...], dtype: str, content: Any) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(UnsafePickleError):
            plain(load_plain(array_state(shape, dtype, content)), 100)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "claim",
    [
        b"\x8e" + struct.pack("<Q", 10 << 30),
        b"\x8d" + struct.pack("<Q", 10 << 30),
        b"\x96" + struct.pack("<Q", 10 << 30),
        b"B" + struct.pack("<I", 4 << 29),
        b"\x8b" + struct.pack("<I", 1 << 30),
        b"\x80\x04\x95" + struct.pack("<Q", 10 << 30),
        b"Nr" + struct.pack("<I", 2**32 - 1),
    ],
)
def test_a_length_that_is_not_there_allocates_nothing(claim: bytes) -> None:
    tracemalloc.start()
    try:
        with suppress(UnsafePickleError):
            load_plain(claim + b"abc.")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


OPCODES = [opcode.code.encode("latin1") for opcode in pickletools.opcodes]


@pytest.mark.rounds(30)
@given(st.data())
def test_mutations_give_plain_data_or_our_error(data: st.DataObject) -> None:
    sound = pickle.dumps({"object": {1: {"location": np.array([1.0, 2, 3]), "class_": "bed"}}}, 4)
    with suppress(UnsafePickleError):
        loaded = load_plain(broken(data, sound, OPCODES, 2))
        if isinstance(loaded, dict):
            for value in loaded.values():
                plain(value, 100)
