"""Open a store by its address, as given in a configuration or on a command line."""

from __future__ import annotations

from pathlib import Path

from factory.local_store import LocalStore
from factory.object_store import ObjectStore
from factory.store import Store

__all__ = ["open_store"]


def open_store(address: str | Path) -> Store:
    """Open the store at ``address``: a folder, or ``s3://bucket/prefix[?endpoint=…&region=…]``."""
    if isinstance(address, str) and "://" in address:
        return ObjectStore.from_url(address)
    return LocalStore(address)
