"""Read a building of 3DSceneGraph from Habitat's ``.scn`` JSON or from the original ``.npz``."""

from __future__ import annotations

import io
import zipfile
import zlib
from ast import literal_eval
from typing import Any, Final

from condvln.formats.json_document import JsonNode, parse_json
from condvln.formats.restricted_pickle import UnsafePickleError, load_plain, plain
from schemas.errors import FormatError

__all__ = ["MAX_GRAPH_BYTES", "read_npz", "read_scn"]

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
