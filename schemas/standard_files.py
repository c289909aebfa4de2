"""Standard input, output and errors of a process whose caller has closed them."""

from __future__ import annotations

import os
import sys

__all__ = ["open_standard_files"]


def open_standard_files() -> None:
    """Open what a caller has closed of standard input, output and errors: other files would get these numbers, and be
    replaced or missing in the processes that this one starts. To be called before any file is opened.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 - as long as the process
