"""Version of all contracts in this package.

The major part changes when a reader of the old form would misread the new one (new keys, everything is
recomputed); the minor part when fields are only added.
"""

from __future__ import annotations

from typing import Final

__all__ = ["SCHEMA_VERSION"]

SCHEMA_VERSION: Final = "1.0"
