"""Parse untrusted JSON within limits, and read its values by type; errors name the file and the place of the value."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from schemas.errors import FormatError

__all__ = [
    "MAX_COORDINATE",
    "MAX_DEPTH",
    "TOO_DEEP",
    "JsonNode",
    "nesting_depth",
    "parse_json",
    "parsed_value",
]

MAX_DEPTH: Final = 64
"""Deepest accepted nesting. Real documents have under ten levels; the parser's own limit depends on the call stack."""

TOO_DEEP: Final = f"is nested more than {MAX_DEPTH} levels deep"

MAX_COORDINATE = 1e5
"""Largest coordinate in metres. Buildings are smaller, and products of three such numbers stay precise in double
precision.
"""

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_HUGE = re.compile(r"[eE]\+?\d{3}|\d{200}")
"""A number may be infinite as a double only if its text has one of these."""
_REMEDY = "Take the file from its dataset again, or correct the entry"


def parse_json(data: bytes, where: str) -> JsonNode:
    """Return the root node of a document.

    Raises
    ------
    FormatError : as `parsed_value`
    """
    return JsonNode(parsed_value(data, where), where, "")


def parsed_value(
    data: bytes | str, where: str, place: str = "", *, nonfinite: bool = False, remedy: str = _REMEDY
) -> Any:
    """Return the value of JSON text, which is the whole file `where`, or its entry `place`.

    nonfinite : accept NaN and infinities, which Python's json module writes

    Raises
    ------
    FormatError : not UTF-8 JSON, nested deeper than `MAX_DEPTH`, a repeated key, NaN or infinite numbers, half of a
        surrogate pair
    """

    def refuse(what: str, inside: str = "") -> NoReturn:
        raise FormatError(what, where=where, place=", ".join(filter(None, (place, inside))), remedy=remedy)

    odd: list[str] = []

    def number(text: str) -> float:
        value = float(text)
        if not math.isfinite(value):
            odd.append(text)
        return value

    try:
        text = data if isinstance(data, str) else data.decode("utf-8-sig")
        parse_float = number if _HUGE.search(text) else None  # a call a number takes longer than the rest
        value = json.loads(text, object_pairs_hook=_unique_keys, parse_float=parse_float, parse_constant=number)
    except UnicodeDecodeError as error:
        refuse(f"not UTF-8 text ({error.reason})", f"byte {error.start}")
    except json.JSONDecodeError as error:
        at = f"character {error.pos}" if place else f"line {error.lineno} column {error.colno}"
        refuse(f"not JSON: {error.msg}", at)
    except RecursionError:
        refuse(f"the document {TOO_DEEP}")
    except ValueError as error:
        refuse(f"invalid JSON: {error}")
    if text.count("[") + text.count("{") > MAX_DEPTH and nesting_depth(value) > MAX_DEPTH:
        refuse(f"the document {TOO_DEEP}")
    if odd and not nonfinite:
        refuse(f"the number {odd[0]:.20} is not finite", _place_of_infinity(value) or "top level")
    if _SURROGATE.search(text) is not None:
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            refuse("a text has an unpaired surrogate")
    return value


def nesting_depth(value: Any) -> int:
    """Return how many arrays and objects are nested in a value."""
    level, depth = [value], 0
    while level := [item for item in level if isinstance(item, (dict, list))]:
        depth += 1
        level = [inner for item in level for inner in (item.values() if isinstance(item, dict) else item)]
    return depth


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
        """Yield the elements of this array."""
        if not isinstance(self.value, list):
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


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique = dict(pairs)
    if len(unique) != len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {twice!r} occurs twice in one object")
    return unique


def _place_of_infinity(value: Any, place: str = "") -> str | None:
    """Return the path to the first number in a value that is not finite; None if there is none."""
    if isinstance(value, float) and not math.isfinite(value):
        return place
    inside = (
        ((f"{place}.{key}" if place else key, item) for key, item in value.items())
        if isinstance(value, dict)
        else ((f"{place}[{k}]", item) for k, item in enumerate(value))
        if isinstance(value, list)
        else ()
    )
    found = (_place_of_infinity(item, own) for own, item in inside)
    return next((path for path in found if path is not None), None)


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true or false"
    names = {
        dict: "an object",
        list: "an array",
        str: "text",
        int: "a number",
        float: "a number",
    }
    return names[type(value)]
