"""Read the tables and texts that lie beside the package's code."""

from __future__ import annotations

import csv
from importlib.resources import files
from typing import Any

__all__ = ["own_rows", "own_text"]


def own_text(package: str, name: str) -> str:
    """Return the text of a file of a package, named by its path below it."""
    return files(package).joinpath(*name.split("/")).read_text(encoding="utf-8")


def own_rows(package: str, name: str) -> list[dict[str, Any]]:
    """Return the rows of a CSV file of a package, each by the names of its columns."""
    return list(csv.DictReader(own_text(package, name).splitlines()))
