"""Identity of an episode: the hash of its content, and the integer id used in files and tables.

Stock loaders call ``int()`` on an episode's id, and JSON readers keep integers exact only below 2^53. So the id is an
integer derived from the hash, and rows hold both.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["ID_BITS", "colliding", "content_hash", "numeric_id"]

HASH_DIGITS: Final = 16
"""Hex digits of an episode's hash: 64 bits; the odds of a collision in a million episodes are 1 in 10⁷."""

ID_BITS: Final = 52
"""Bits of an id. The odds that two of a million episodes get the same id are 1 in 10⁴; the larger hash is then
rejected.
"""


def content_hash(scene_id: str, instruction_id: str, start: NDArray[np.float64], yaw: float) -> str:
    """Return the hash of an episode's content: scene, instruction, and start pose (metres, radians)."""
    pose = ",".join(f"{value:.3f}" for value in start.tolist()) + f",{yaw:.6f}"
    return hashlib.sha256("\x1f".join([scene_id, instruction_id, pose]).encode()).hexdigest()[:HASH_DIGITS]


def numeric_id(episode_hash: str) -> int:
    """Return the integer id of an episode: the first `ID_BITS` bits of the SHA-256 of `episode_hash`."""
    return int.from_bytes(hashlib.sha256(episode_hash.encode()).digest()[:8], "big") >> (64 - ID_BITS)


def colliding(ids: Sequence[int], hashes: Sequence[str]) -> list[int]:
    """Return the ascending indices of episodes whose id also belongs to an episode with a smaller hash.

    Rows with equal hashes are the same episode and do not collide.
    """
    numbers = np.asarray(ids, dtype=np.int64)
    unique, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    if len(unique) == len(numbers):
        return []
    smallest: dict[int, str] = {}
    repeated = np.flatnonzero(counts[which] > 1).tolist()
    for index in repeated:
        known = smallest.get(ids[index])
        if known is None or hashes[index] < known:
            smallest[ids[index]] = hashes[index]
    return [index for index in repeated if hashes[index] != smallest[ids[index]]]
