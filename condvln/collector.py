"""Switch off Python's cyclic garbage collector while many rows are created: rows contain no reference cycles, and
scanning them is slow.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["no_collection"]


@contextmanager
def no_collection() -> Iterator[None]:
    """Return a context manager that switches the garbage collector off and restores its state afterwards."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
