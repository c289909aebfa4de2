"""Read a building of 3DSceneGraph from Habitat's ``.scn`` JSON or from the original ``.npz``, which holds a pickle.

A pickle can call any function that it names. Here only four names are allowed, bound to classes of this module that
only store their arguments; arrays are built afterwards, from the actual bytes. The standard library's pure-Python
unpickler is used, because the compiled one allocates what a length field claims before it checks for the bytes.
"""

from __future__ import annotations

import io
import math
import pickle
import zipfile
import zlib
from ast import literal_eval
from collections.abc import Callable
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode, parse_json
from schemas.errors import FormatError

__all__ = [
    "MAX_GRAPH_BYTES",
    "UnsafePickleError",
    "load_plain",
    "plain",
    "read_npz",
    "read_scn",
]

MAX_ARRAY_DIMENSIONS: Final = 8

# Opcodes that create instances, request external objects, or allocate by a claimed length.
_FORBIDDEN: Final = (
    b"P", b"Q", b"i", b"o", b"\x81", b"\x92", b"\x82", b"\x83", b"\x84", b"\x96", b"\x97", b"\x98",
)  # fmt: skip
_DTYPE_KINDS: Final = frozenset("biufSUO")


class UnsafePickleError(ValueError):
    """The pickle contains something other than plain data and arrays."""


class _DType:
    """A numpy dtype as a pickle states it: the dtype's string (`text`) and the byte order (`order`), which the pickle
    sets afterwards.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self.order = ""

    def dtype(self) -> np.dtype[Any]:
        try:
            found = np.dtype((self.order if self.order in ("<", ">") else "") + self.text)
        except (TypeError, ValueError) as error:
            raise UnsafePickleError(f"{self.text!r:.40} is not a numeric dtype") from error
        if found.kind not in _DTYPE_KINDS or found.fields is not None or found.subdtype is not None:
            raise UnsafePickleError(f"{self.text!r:.40} is not a numeric dtype")
        return found


class _Array:
    """An array's shape, dtype and content as stated by the pickle."""

    def __init__(self) -> None:
        self.state: Any = None

    def value(self) -> Any:
        """Return the array; for an object array, a nested list."""
        try:
            _, shape, dtype, fortran, content = self.state
            shape = tuple(int(n) for n in shape)
            found = dtype.dtype()
        except (TypeError, ValueError, AttributeError) as error:
            raise UnsafePickleError("the state of an array is invalid") from error
        count = int(np.prod(shape, dtype=object)) if shape else 1
        if len(shape) > MAX_ARRAY_DIMENSIONS or any(n < 0 for n in shape):
            raise UnsafePickleError(f"the shape of an array is invalid: {shape!r:.60}")
        if found.kind == "O":
            if not isinstance(content, list) or len(content) != count:
                raise UnsafePickleError("the number of objects in an array differs from its shape")
            return content[0] if shape == () else content
        if isinstance(content, str):  # written by Python 2
            content = content.encode("latin1")
        if not isinstance(content, bytes) or len(content) != count * found.itemsize or not found.itemsize:
            raise UnsafePickleError(f"the bytes of an array do not match its {count} items")
        array: NDArray[Any] = np.frombuffer(content, dtype=found).reshape(shape, order="F" if fortran else "C")
        return array


def _reconstruct(*_: Any) -> _Array:
    return _Array()


def _dtype(text: Any, *_: Any) -> _DType:
    if not isinstance(text, str):
        raise UnsafePickleError("a dtype is not given as text")
    return _DType(text)


def _scalar(dtype: Any, content: Any = None) -> Any:
    if not isinstance(dtype, _DType):
        raise UnsafePickleError("a number has no dtype")
    array = _Array()
    array.state = (1, (), dtype, False, [content] if dtype.text.startswith("O") else content)
    found = array.value()
    return found.item() if isinstance(found, np.ndarray) else found


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    """Return a text as bytes, in place of `_codecs.encode`, which pickles of protocol 2 call to make bytes."""
    if not isinstance(text, str) or encoding != "latin1":
        raise UnsafePickleError("bytes are not encoded as Latin-1")
    return text.encode("latin1")


def _no_bytes(*content: Any) -> bytes:
    """Return empty bytes. This takes the place of the `bytes` constructor, which pickles of protocol 2 call to make
    empty bytes.
    """
    if content:
        raise UnsafePickleError("the pickle calls bytes with arguments; only literal bytes are accepted")
    return b""


def _ndarray(*_: Any) -> Any:
    raise UnsafePickleError(
        "the pickle calls numpy.ndarray itself; only arrays in the form that numpy writes are accepted"
    )


_KNOWN: Final = {
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _reconstruct for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    ("numpy", "ndarray"): _ndarray,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("__builtin__", "bytes"): _no_bytes,
}


class _Unpickler(pickle._Unpickler):
    stack: list[Any]
    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {
        key: operation for key, operation in pickle._Unpickler.dispatch.items() if bytes([key]) not in _FORBIDDEN
    }

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _KNOWN[module, name]
        except KeyError:
            raise UnsafePickleError(f"the name {module}.{name} is not allowed") from None

    def load_build(self) -> None:
        """Set the state of one of our own classes; raise an error for any other object."""
        state = self.stack.pop()
        target = self.stack[-1]
        if isinstance(target, _Array):
            target.state = state
        elif isinstance(target, _DType) and isinstance(state, tuple) and len(state) > 1 and isinstance(state[1], str):
            target.order = state[1]
        else:
            raise UnsafePickleError("the pickle sets a state on an object that has none")

    dispatch[pickle.BUILD[0]] = load_build


def load_plain(data: bytes) -> Any:
    """Return a pickle's content: dicts, lists, tuples, sets, text, bytes, numbers, and `_Array`s to convert with
    `plain`.

    Raises
    ------
    UnsafePickleError : the pickle contains anything else, or is damaged
    """
    try:
        return _Unpickler(io.BytesIO(data), encoding="latin1").load()
    except UnsafePickleError:
        raise
    except Exception as error:  # a damaged pickle may raise any exception
        raise UnsafePickleError(f"not a valid pickle ({error!r:.80})") from None


def plain(value: Any, most: int) -> Any:
    """Return an array or number of a loaded pickle as lists and numbers, and other values unchanged.

    Raises
    ------
    UnsafePickleError : an array has no valid state, or more than `most` items
    """
    found = value.value() if isinstance(value, _Array) else value
    if not isinstance(found, np.ndarray):
        return found
    if found.size > most:
        raise UnsafePickleError(f"an array has {found.size} items (at most {most} are allowed)")
    return found.tolist()


MAX_GRAPH_BYTES: Final = 256 << 20
"""Size limit in bytes of the file, also after decompression; the largest building, with segmentations, takes a
tenth.
"""

MEMBER: Final = "output.npy"
OBJECT_KEYS: Final = ("id", "class_", "location", "size", "parent_room")
ROOM_KEYS: Final = ("id", "scene_category", "location", "size", "floor_number")
MAX_FIELD: Final = 3
_PIECE: Final = 1 << 20
_MAGIC: Final = b"\x93NUMPY"
_REMEDY = "Take the file from its dataset again"


def read_scn(data: bytes, where: str) -> JsonNode:
    """Return the document ``{"objects": [...], "rooms": [...]}`` of a ``.scn`` file.

    Raises
    ------
    FormatError : the file is malformed
    """
    return parse_json(data, where).object()


def read_npz(data: bytes, where: str) -> JsonNode:
    """Return the same document as `read_scn`, but from the original ``.npz`` file: a zip of one array that holds one
    pickled dictionary.

    Only the parts that a scene needs are read. The pickle is read by the restricted reader, which allows plain data and
    arrays.

    Raises
    ------
    FormatError : the file is malformed, too large when decompressed, or its pickle contains anything but plain data
    """
    try:
        graph = load_plain(_pickle_of(_member(data, where), where))
        if not isinstance(graph, dict):
            # equivalent to np.load's .item(): the one object of a zero-dimensional array
            graph = plain(graph, 1)
        document = {"objects": _entries(graph, "object", OBJECT_KEYS), "rooms": _entries(graph, "room", ROOM_KEYS)}
    except UnsafePickleError as error:
        raise FormatError(f"the pickle is not accepted: {error}", where=where, place=MEMBER, remedy=_REMEDY) from None
    return JsonNode(document, where, "")


def _entries(graph: Any, kind: str, keys: tuple[str, ...]) -> list[dict[str, Any]]:
    found = graph.get(kind) if isinstance(graph, dict) else None
    if not isinstance(found, dict) or not all(isinstance(entry, dict) for entry in found.values()):
        raise UnsafePickleError(f"it does not hold a dictionary for each {kind}")
    return [{key: _value(entry[key]) for key in keys if key in entry} for entry in found.values()]


def _value(value: Any) -> Any:
    """Return a field as a JSON value."""
    opened = plain(value, MAX_FIELD)
    if isinstance(opened, float) and not math.isfinite(opened):
        raise UnsafePickleError(f"a field is {opened}, not a finite number")
    if opened is None or isinstance(opened, (bool, int, float, str)):
        return opened
    if isinstance(opened, (list, tuple)) and len(opened) <= MAX_FIELD:
        return [_value(part) for part in opened]
    raise UnsafePickleError(f"a field is {type(opened).__name__}, not a number, text or three numbers")


def _member(data: bytes, where: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, archive.open(MEMBER) as stream:
            pieces, size = [], 0
            while piece := stream.read(_PIECE):
                size += len(piece)
                if size > MAX_GRAPH_BYTES:
                    raise FormatError(
                        f"the array decompresses to more than {MAX_GRAPH_BYTES} bytes",
                        where=where,
                        place=MEMBER,
                        remedy=_REMEDY,
                    )
                pieces.append(piece)
            return b"".join(pieces)
    except KeyError:
        raise FormatError(f"the file holds no {MEMBER}", where=where, remedy=_REMEDY) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError, NotImplementedError) as error:
        raise FormatError(f"not a valid npz file ({error!r:.80})", where=where, remedy=_REMEDY) from None


def _pickle_of(array: bytes, where: str) -> bytes:
    """Return the pickle inside a ``.npy`` file of one object."""

    def fail(what: str) -> FormatError:
        return FormatError(what, where=where, place=MEMBER, remedy=_REMEDY)

    if array[:6] != _MAGIC or len(array) < 12 or array[6] not in (1, 2, 3):
        raise fail("not a numpy array")
    wide = array[6] > 1
    start = 12 if wide else 10
    length = int.from_bytes(array[8:start], "little")
    if length > 10_000 or start + length > len(array):
        raise fail(f"the array's header claims {length} bytes, which is too large")
    try:
        header = literal_eval(array[start : start + length].decode("latin1"))
        descr, shape = header["descr"], header["shape"]
    except (ValueError, SyntaxError, KeyError, TypeError, MemoryError, RecursionError):
        raise fail("the array's header can't be read") from None
    if descr not in ("|O", "O", "<O") or shape not in ((), (1,)):
        raise fail("the array does not hold exactly one object")
    return array[start + length :]
