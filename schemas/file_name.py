"""Names of files as text."""

from __future__ import annotations

from pathlib import Path

__all__ = ["shown_path"]


def shown_path(path: str | Path) -> str:
    r"""Return a path as text that can be printed and stored: a byte of a name that is not UTF-8 becomes ``\xff``."""
    try:
        return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # not a name that an operating system gave
        return str(path).encode("utf-8", "backslashreplace").decode("utf-8")
