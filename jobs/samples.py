"""``condvln samples``: whole made scenes in a family's native format."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from condvln.samples import make_samples

__all__ = ["write_samples"]


def write_samples(folder: Path, *, family: str, scenes: int, seed: int, console: Console) -> None:
    """Write `scenes` made scenes under `folder`."""
    report = make_samples(folder, family=family, scenes=scenes, seed=seed)
    console.print(f"{report}", highlight=False, markup=False)
