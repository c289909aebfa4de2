"""How deep a JSON text is nested, told before it is parsed and without a copy of it."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

__all__ = ["nesting_depth"]

_PIECE: Final = 1 << 20
"""Bytes looked at in one go: what is counted for a piece takes ten times its size."""

# A whole string; or one that goes on behind the piece, of which its quote and a last lone backslash are kept. No input
# makes either try again from every quote.
_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"|(")[^"\\]*(?:\\.[^"\\]*)*(\\?)\Z', re.DOTALL)
_REST = re.compile(rb'[^"\\]*(?:\\(?:.|\Z)[^"\\]*)*(?:"|\Z)', re.DOTALL)


def nesting_depth(data: bytes) -> int:
    """The most brackets and braces that are open at one place, those inside of strings not counted."""
    at, depth, deepest = 0, 0, 0
    while at < len(data):
        end = min(at + _PIECE, len(data))
        bare = _STRING.sub(rb"\1\2", data[at:end])
        quote = bare.find(b'"')
        if quote >= 0:
            rest = _REST.match(data, end - len(bare) + quote + 1)
            assert rest is not None
            bare, end = bare[:quote], rest.end()
        marks = np.frombuffer(bare, dtype=np.uint8)
        opens, closes = (marks == ord("[")) | (marks == ord("{")), (marks == ord("]")) | (marks == ord("}"))
        steps = np.cumsum(opens.astype(np.int8) - closes.astype(np.int8), dtype=np.int32)
        if len(steps):
            deepest = max(deepest, depth + int(steps.max()))
            depth += int(steps[-1])
        at = end
    return deepest
