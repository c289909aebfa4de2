"""What is loaded before the first unit is worked on."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

__all__ = ["NOTHING", "Preload"]


@dataclass(frozen=True, slots=True)
class Preload:
    """A function that imports and loads what workers need, such as compiled kernels; by default none.

    module, function : where it is; it is called with a function that shows a message, then with the arguments
    arguments : JSON values, because they are passed to the template process as JSON
    """

    module: str = ""
    function: str = ""
    arguments: tuple[Any, ...] = ()

    def load(self, note: Callable[[str], None]) -> None:
        """Call the function in this process."""
        if self.module:
            getattr(importlib.import_module(self.module), self.function)(note, *self.arguments)


NOTHING: Final = Preload()
"""Loads nothing."""
