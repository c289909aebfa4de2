"""Blocks of scenes: a learner guesses each block after it has learned from the blocks before."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCKS", "NO_GUESS", "Indices", "blocks", "progressive"]

NO_GUESS: Final = -1
"""The guess in the first block, which is only learned from."""
BLOCKS: Final = 10
"""Number of blocks. The first is only learned from, never guessed."""

Indices = NDArray[np.int64]


def blocks(scenes: Sequence[str], count: int = BLOCKS) -> list[Indices]:
    """Split episodes into about `count` blocks of similar size, and return the ascending episode indices of each block.

    All episodes of a scene are in one block; no block is empty.

    Parameters
    ----------
    scenes : the scene of each episode
    """
    names = sorted(set(scenes), key=lambda name: hashlib.blake2b(name.encode(), digest_size=8).digest())
    rank = {name: k for k, name in enumerate(names)}
    place = np.array([rank[scene] for scene in scenes], dtype=np.int64)
    sizes = np.bincount(place, minlength=len(names))
    # A scene belongs to the block in which the middle of its episodes falls, so that blocks are about equally large.
    middles = (np.cumsum(sizes) - sizes / 2) / max(1, sizes.sum())
    block = np.floor(middles * count).astype(np.int64)
    found = [np.flatnonzero(block[place] == k) for k in range(count)] if len(place) else []
    return [indices for indices in found if len(indices)]


def progressive(scenes: Sequence[str], count: int = BLOCKS) -> Iterator[tuple[Indices, Indices]]:
    """Yield, for each block after the first, two arrays of episode indices: the episodes of all earlier blocks, to
    learn from, and the episodes of the block itself, to guess. The first array begins with the first array of the block
    before, in the same order.
    """
    parts = blocks(scenes, count)
    for k in range(1, len(parts)):
        yield np.concatenate(parts[:k]), parts[k]
