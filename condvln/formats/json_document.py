"""Parse untrusted JSON within limits, and read its values by type; errors name the file and the place of the value."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_arrays import TextArray, parse_large
from schemas.errors import FormatError

__all__ = ["MAX_COORDINATE", "MAX_DEPTH", "JsonNode", "canonical_json", "is_shallow", "nesting_depth", "parse_json"]

MAX_DEPTH = 64
"""Deepest accepted nesting. Real documents have under ten levels; the parser's own limit depends on the call stack."""

MAX_COORDINATE = 1e5
"""Largest coordinate in metres. Buildings are smaller, and products of three such numbers stay precise in double
precision.
"""

LARGE_BYTES: Final = 16 << 20
"""Size in bytes from which long arrays stay text until accessed. Real documents of one scene have under 1 MB."""

_PIECE: Final = 1 << 20
"""Bytes scanned at once; counting takes ten times the memory of the scanned piece."""

_LEVELS: Final = 12
"""How often levels are taken out of a text to see that it is shallow, at most two at once; so `MAX_DEPTH` is at least
twice as much.
"""
_NO_BRACKETS: Final = bytes(set(range(256)) - set(b'[]{}"'))

# A whole string; or one that continues beyond the piece, of which the quote and a last single backslash are kept. The
# pattern never backtracks to retry from every quote, whatever the input.
_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|(")[^"\\]*(?:\\.[^"\\]*)*(\\?)\Z', re.DOTALL)
_REST = re.compile(rb'[^"\\]*(?:\\(?:.|\Z)[^"\\]*)*(?:"|\Z)', re.DOTALL)

_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")
_REMEDY = "Take the file from its dataset again, or correct the entry"


def parse_json(data: bytes, where: str) -> JsonNode:
    """Return the root node of a document.

    Raises
    ------
    FormatError : not UTF-8 JSON, nested deeper than `MAX_DEPTH`, a repeated key, NaN or infinite numbers
    """
    # The parser's own limit depends on the call stack.
    if not is_shallow(data) and (depth := nesting_depth(data)) > MAX_DEPTH:
        raise FormatError(
            f"the document is nested {depth} levels deep (at most {MAX_DEPTH})", where=where, remedy=_REMEDY
        )
    large, surrogates = len(data) >= LARGE_BYTES, _SURROGATE.search(data) is not None
    try:
        text = data.decode("utf-8-sig")
        del data
        value = parse_large(text, _DECODER) if large else _DECODER.decode(text)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"not UTF-8 text ({error.reason})", where=where, place=f"byte {error.start}", remedy=_REMEDY
        ) from None
    except json.JSONDecodeError as error:
        place = f"line {error.lineno} column {error.colno}"
        raise FormatError(f"not JSON: {error.msg}", where=where, place=place, remedy=_REMEDY) from None
    except (ValueError, RecursionError) as error:
        raise FormatError(f"invalid JSON: {error}", where=where, remedy=_REMEDY) from None
    if surrogates:
        _check_text(value, where)
    return JsonNode(value, where, "")


def canonical_json(value: Any) -> bytes:
    """Return a value as canonical JSON bytes for hashing: sorted keys, no blanks, ASCII."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=_listed).encode("ascii")


def is_shallow(data: bytes) -> bool:
    """Return whether brackets and braces are surely nested at most `MAX_DEPTH` deep; `nesting_depth` decides the rest.

    The text is cut down to brackets and quotes. If all quotes then stand in pairs, no string has a bracket, and pairs
    of brackets can be taken out level by level.
    """
    if data.count(b"[") + data.count(b"{") <= MAX_DEPTH:
        return True
    if b"\\" in data:
        return False
    bare = data.translate(None, _NO_BRACKETS).replace(b'""', b"")
    if b'"' in bare:
        return False
    for _ in range(_LEVELS):
        bare = bare.replace(b"[]", b"").replace(b"{}", b"")
        if not bare:
            return True
    return False


def nesting_depth(data: bytes) -> int:
    """Return the maximum nesting depth of brackets and braces. Those inside strings do not count."""
    at, depth, deepest = 0, 0, 0
    while at < len(data):
        end = min(at + _PIECE, len(data))
        bare = data[at:end]
        outside = None
        if b"\\" in bare:
            bare = _STRING.sub(rb"\1\2", bare)
            quote = bare.find(b'"')
        else:
            # Most documents have no escapes; a quote then begins or ends a string.
            odd = np.cumsum(np.frombuffer(bare, dtype=np.uint8) == ord('"'), dtype=np.uint8) & 1
            outside = odd == 0
            quote = bare.rfind(b'"') if odd[-1] else -1
        if quote >= 0:
            rest = _REST.match(data, end - len(bare) + quote + 1)
            assert rest is not None
            bare, end = bare[:quote], rest.end()
        marks = np.frombuffer(bare, dtype=np.uint8)
        opens, closes = (marks == ord("[")) | (marks == ord("{")), (marks == ord("]")) | (marks == ord("}"))
        steps = opens.astype(np.int8) - closes.astype(np.int8)
        if outside is not None:
            steps *= outside[: len(bare)]
        steps = np.cumsum(steps, dtype=np.int32)
        if len(steps):
            deepest = max(deepest, depth + int(steps.max()))
            depth += int(steps[-1])
        at = end
    return deepest


@dataclass(frozen=True, slots=True)
class JsonNode:
    """A value of a JSON document, with the name of its file and the path to the value inside the document."""

    value: Any
    where: str
    place: str

    def fail(self, what: str, remedy: str = _REMEDY) -> NoReturn:
        """Raise a FormatError about this node."""
        raise FormatError(what, where=self.where, place=self.place or "top level", remedy=remedy)

    def object(self) -> JsonNode:
        """Return this node after checking that it is an object."""
        if not isinstance(self.value, dict):
            self.fail(f"an object is expected, not {_kind(self.value)}")
        return self

    def __contains__(self, key: str) -> bool:
        return key in self.object().value

    def __getitem__(self, key: str) -> JsonNode:
        """Return a required member of this object."""
        members = self.object().value
        if key not in members:
            self.fail(f"the key {key!r} is missing")
        return JsonNode(members[key], self.where, f"{self.place}.{key}" if self.place else key)

    def get(self, key: str) -> JsonNode | None:
        """Return a member of this object; None if it is absent or null."""
        value = self.object().value.get(key)
        return None if value is None else JsonNode(value, self.where, f"{self.place}.{key}" if self.place else key)

    def items(self) -> Iterator[tuple[str, JsonNode]]:
        """Yield the members of this object, in file order."""
        return ((key, self[key]) for key in self.object().value)

    def entries(self) -> Iterator[JsonNode]:
        """Yield the elements of this array one at a time; of a large document, only the current one is in memory."""
        if not isinstance(self.value, (list, TextArray)):
            self.fail(f"an array is expected, not {_kind(self.value)}")
        return (JsonNode(v, self.where, f"{self.place}[{i}]") for i, v in enumerate(self.value))

    def elements(self) -> list[JsonNode]:
        """Return the elements of this array."""
        return list(self.entries())

    def array(self, key: str) -> list[JsonNode]:
        """Return the elements of a member that is an array; an empty list if it is absent or null."""
        member = self.get(key)
        return [] if member is None else member.elements()

    def text(self) -> str:
        """Return this node's text."""
        if not isinstance(self.value, str):
            self.fail(f"text is expected, not {_kind(self.value)}")
        return self.value

    def boolean(self) -> bool:
        """Return this node's boolean."""
        if not isinstance(self.value, bool):
            self.fail(f"true or false is expected, not {_kind(self.value)}")
        return self.value

    def integer(self) -> int:
        """Return this node's integer, which must be exact in a double."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.fail(f"a whole number is expected, not {_kind(value)}")
        if not abs(value) < 1 << 53 or value != int(value):
            self.fail(f"a whole number below 2^53 is expected, not {value!r:.40}")
        return int(value)

    def index(self, count: int) -> int:
        """Return this node's integer as an index into `count` items."""
        value = self.integer()
        if not 0 <= value < count:
            self.fail(f"the index {value} is out of range: there are {count} entries")
        return value

    def number(self, limit: float = MAX_COORDINATE) -> float:
        """Return this node's finite number; its absolute value is at most `limit`."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self.fail(f"a number is expected, not {_kind(value)}")
        if not abs(value) <= limit:
            self.fail(f"the number {value!r:.40} is beyond ±{limit:g}")
        return float(value)

    def vector(self, length: int, limit: float = MAX_COORDINATE) -> NDArray[np.float64]:
        """Return this array, which must have exactly `length` finite numbers of absolute value at most `limit`."""
        own = self.value
        if type(own) is list and len(own) == length and all(type(v) is float and abs(v) <= limit for v in own):
            return np.array(own)
        elements = self.elements()
        if len(elements) != length:
            self.fail(f"{length} numbers are expected, not {len(elements)}")
        return np.array([e.number(limit) for e in elements], dtype=np.float64)


def _listed(value: Any) -> list[Any]:
    if isinstance(value, TextArray):
        return list(value)
    raise TypeError(f"{type(value).__name__} is not JSON")


def _check_text(value: Any, where: str) -> None:
    try:
        json.dumps(value, ensure_ascii=False, default=_listed).encode("utf-8")
    except UnicodeEncodeError:
        raise FormatError("a text has an unpaired surrogate", where=where, remedy=_REMEDY) from None


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique = dict(pairs)
    if len(unique) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {twice!r} occurs twice in one object")
    return unique


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"the number {name} is not allowed")


_DECODER: Final = json.JSONDecoder(object_pairs_hook=_unique_keys, parse_constant=_refuse_constant)


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true or false"
    names = {
        dict: "an object",
        list: "an array",
        TextArray: "an array",
        str: "text",
        int: "a number",
        float: "a number",
    }
    return names[type(value)]
