"""A made snapshot, and its export."""

from __future__ import annotations

from pathlib import Path

import pytest

from condvln.export.snapshot import export_snapshot
from tests.made_snapshot import MemoryTables, made_snapshot


def linear_text(episode: dict, instruction: dict) -> str:
    """A plain instruction of the gold leaf."""
    moves = instruction["leaves"][instruction["gold_leaf"]]["moves"]
    return "Walk to the " + ", then to the ".join(move["label"] for move in moves) + "."


@pytest.fixture(scope="session")
def tables() -> MemoryTables:
    return made_snapshot()


@pytest.fixture(scope="session")
def exported(tables: MemoryTables, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an export with all variants."""
    out = tmp_path_factory.mktemp("export")
    export_snapshot(tables, out, oracle_text=linear_text)
    return out
