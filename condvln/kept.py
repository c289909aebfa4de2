"""Keep what a method returned, for the lifetime of its object."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

__all__ = ["kept"]

Own = TypeVar("Own")
Asked = ParamSpec("Asked")
Found = TypeVar("Found")


def kept(method: Callable[Concatenate[Own, Asked], Found]) -> Callable[Concatenate[Own, Asked], Found]:
    """Return a method that is run once for each of its arguments, which must be hashable and given by position; as
    ``functools.cached_property`` does for a property.
    """
    name = f"_kept_{method.__name__}"

    @wraps(method)
    def once(self: Any, *asked: Any) -> Any:
        known = self.__dict__.setdefault(name, {})
        if asked not in known:
            known[asked] = method(self, *asked)  # type: ignore[call-arg]
        return known[asked]

    return once  # type: ignore[return-value]
