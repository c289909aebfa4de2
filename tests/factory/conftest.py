"""Fixtures of the factory's tests."""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = str(Path(__file__).parent)
# The toys must be importable by name in other processes too: Ray's workers, and drivers that get killed.
if FOLDER not in sys.path:
    sys.path.insert(0, FOLDER)
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [FOLDER, os.environ.get("PYTHONPATH", "")]))

from factory.object_store import ObjectStore  # noqa: E402
from factory.ray_executor import RayExecutor  # noqa: E402
from factory.store import LocalStore  # noqa: E402


@pytest.fixture
def store(tmp_path: Path) -> LocalStore:
    """An empty local store."""
    return LocalStore(tmp_path / "store", durable=False)


@pytest.fixture
def object_store(s3_server: str) -> ObjectStore:
    """An empty store in the bucket."""
    return ObjectStore("bucket", f"a/{secrets.token_hex(6)}", endpoint=s3_server)


@pytest.fixture(scope="session")
def executor() -> Iterator[RayExecutor]:
    """One Ray of two workers for all tests of this folder."""
    with RayExecutor(workers=2) as found:
        yield found
