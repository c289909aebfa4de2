"""ANSR-v1: the stock episode plus top-level ``subgoals``, as the public evaluators of conditional episodes read it.

Source of the keys: dataset type ``ANSR-v1`` of the VLN-Zero and Open-Nav forks. The key is always there, ``[]``
where the gold branch has one move.
"""

from __future__ import annotations

from typing import Any

from condvln.export.rows import Row
from condvln.export.vlnce import encode, gold

__all__ = ["ansr_bytes", "subgoals"]


def subgoals(row: Row) -> list[dict[str, Any]]:
    """The gold leaf's subgoals in order, with the success distance as their radius."""
    return [{"position": s["position"], "radius": row["success_distance"]} for s in gold(row)["subgoals"]]


def ansr_bytes(stock: bytes, row: Row) -> bytes:
    """The encoded ANSR-v1 episode of an encoded stock one."""
    return stock[:-1] + b',"subgoals":' + encode(subgoals(row)) + b"}"
