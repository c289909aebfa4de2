"""Canonical JSON: equal values give equal bytes, and so equal hashes, on every machine.

Keys are sorted, nothing is padded, text is ASCII-escaped (so that a file name with undecodable bytes still has a form),
and NaN and infinities are refused: they are not JSON, and a NaN in a key would silently equal ``null``. It is not
RFC 8785: ``1`` and ``1.0`` stay different, as they are in Python.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import TypeAlias, Union

__all__ = ["JSON", "canonical_json", "digest"]

JSON: TypeAlias = Union[bool, int, float, str, Sequence["JSON"], Mapping[str, "JSON"], None]  # noqa: UP007
"""A JSON value; tuples count as arrays."""

_PLAIN = frozenset({str, int, float, bool, type(None)})
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def canonical_json(value: JSON) -> bytes:
    """Encode ``value`` as canonical JSON: sorted keys, no blanks, ASCII.

    Raises ``ValueError`` on NaN and infinities, ``TypeError`` on what is not JSON (keys that are not text included,
    since ``1`` and ``"1"`` would fall together).
    """
    return _ENCODER.encode(_checked(value)).encode("ascii")


def digest(value: JSON) -> str:
    """Return the SHA-256 of the canonical JSON, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def _checked(value: JSON) -> JSON:
    # Most values are plain, and asking for a mapping takes long.
    if type(value) in _PLAIN:
        return value
    if isinstance(value, (list, tuple)):
        return [item if type(item) in _PLAIN else _checked(item) for item in value]
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise TypeError(f"keys of a canonical document must be text, not {type(name).__name__} ({name!r})")
        return {name: item if type(item) in _PLAIN else _checked(item) for name, item in value.items()}
    return value
