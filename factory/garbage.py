"""When Python looks for unreachable reference cycles: between units, not during them."""

from __future__ import annotations

import contextlib
import functools
import gc
from collections.abc import Iterator
from typing import Final

__all__ = ["MANY", "collected_between_units", "exempt_what_is_loaded"]

MANY: Final = 20_000
"""A unit that leaves more new objects than this is followed by a full collection; after others, Python's own rules
apply.
"""


@functools.cache
def exempt_what_is_loaded() -> None:
    """Exempt all objects from later collections before the first unit, once a process: modules and compiled kernels,
    which live as long as the process. Otherwise the first collections look at a million of them.
    """
    gc.freeze()


@functools.cache
def _exempt() -> None:
    """Exempt all objects from later collections after the first unit, once a process. To ask how many are exempt takes
    20 ms each time.
    """
    gc.freeze()


@contextlib.contextmanager
def collected_between_units() -> Iterator[None]:
    """Context for the work on one unit. Python's garbage collector is off; afterwards it runs once if there are many
    new objects.

    A collection during a unit looks at a million objects, nearly all of them modules and compiled kernels that live as
    long as the process: it takes 0.3 s and comes once a scene. What is there after the first unit is therefore exempt
    from all later collections. Exempt objects are freed when their last reference goes, but not if they refer to
    themselves: what a stage keeps from one scene to the next must be without cycles.
    """
    if not gc.isenabled():
        yield
        return
    try:
        gc.disable()
        yield
    finally:
        try:
            if gc.get_count()[0] > MANY:
                gc.collect()
                _exempt()
        finally:
            gc.enable()  # even if a signal ends the collection
