"""Say in one line what is wrong with a document that pydantic refused."""

from __future__ import annotations

from pydantic import ValidationError

__all__ = ["first_fault"]


def first_fault(error: Exception) -> str:
    """Return what is wrong in one line: of a refused document, its first wrong value with the place; of another error,
    its message.
    """
    if not isinstance(error, ValidationError):
        return str(error)
    fault = error.errors()[0]
    return ": ".join(filter(None, [".".join(map(str, fault["loc"])), fault["msg"]]))
