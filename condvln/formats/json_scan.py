"""Find where the values of a large JSON object or array begin and end, without parsing them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from condvln.compiled import compiled, register_warm_up

__all__ = ["DEPTH", "ESCAPED", "IN_STRING", "new_state", "scan"]

# Fields of the state that is carried from one block of bytes to the next.
DEPTH, IN_STRING, ESCAPED = 0, 1, 2

_QUOTE, _BACKSLASH, _COMMA = 34, 92, 44
_OPEN_LIST, _CLOSE_LIST, _OPEN_DICT, _CLOSE_DICT = 91, 93, 123, 125


def new_state() -> npt.NDArray[np.int64]:
    """Return the state with which to begin a scan, before the first byte."""
    return np.zeros(3, np.int64)


@compiled
def scan(block: npt.NDArray[np.uint8], state: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the offsets in ``block`` at which a container ends (just after its bracket), in ascending order. Only the
    outermost container and the containers directly inside it are considered.

    ``state`` is updated in place. An unmatched closing bracket makes the depth negative.
    """
    ends = np.empty(block.shape[0], np.int64)
    count = 0
    depth, in_string, escaped = state[DEPTH], state[IN_STRING], state[ESCAPED]
    for at in range(block.shape[0]):
        byte = block[at]
        if in_string:
            if escaped:
                escaped = 0
            elif byte == _BACKSLASH:
                escaped = 1
            elif byte == _QUOTE:
                in_string = 0
        elif byte == _QUOTE:
            in_string = 1
        elif byte in (_OPEN_LIST, _OPEN_DICT):
            depth += 1
        elif byte in (_CLOSE_LIST, _CLOSE_DICT):
            depth -= 1
            if depth <= 1:
                ends[count] = at + 1
                count += 1
            if depth <= 0:
                depth = -1 if depth < 0 else 0
    state[DEPTH], state[IN_STRING], state[ESCAPED] = depth, in_string, escaped
    return ends[:count].copy()


def _warm_up() -> None:
    scan(np.frombuffer(b"{}", np.uint8), new_state())


register_warm_up("json scan", _warm_up)
