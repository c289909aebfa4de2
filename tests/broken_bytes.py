"""Sound files with a few bytes or values broken, for tests of what readers make of them."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import Any

from hypothesis import strategies as st


def broken(data: st.DataObject, sound: bytes, tokens: Sequence[bytes], longest: int = 6) -> bytes:
    """`sound` with one to three runs of up to `longest` bytes replaced by one of the `tokens` or by other bytes."""
    bad = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(len(bad) - 1, 0)))
        bad[at : at + data.draw(st.integers(0, longest))] = data.draw(st.sampled_from(tokens) | st.binary(max_size=4))
    return bytes(bad)


ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.sampled_from(["", "a", "../x", "\ud7ff", "mp3d/a/a.glb", "<pad>"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["a", "position", "path"]), inner),
    max_leaves=6,
)


def spoiled(document: Any, data: st.DataObject) -> Any:
    """A copy of a JSON document in which one value somewhere is replaced by anything, or taken away with its key.

    It is sound JSON, and so gets further than broken bytes do.
    """
    found = copy.deepcopy(document)
    *path, last = data.draw(st.sampled_from([place for place in _places(found) if place]))
    at = found
    for key in path:
        at = at[key]
    if data.draw(st.booleans()):
        at[last] = data.draw(ANYTHING)
    else:
        at.pop(last)
    return found


def _places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield at
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from _places(part, (*at, key))
