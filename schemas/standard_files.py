"""Standard input, output and errors of a process whose caller has closed them."""

from __future__ import annotations

import os
import sys

__all__ = ["open_standard_files"]


def open_standard_files() -> None:
    """Open what a caller has closed of standard input, output and errors: files opened later would get these numbers,
    and be replaced or missing in the processes that this one starts. What Python prints there goes nowhere.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # Not by its number, which may be a file's that was opened meanwhile.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - as long as the process
