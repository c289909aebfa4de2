"""Whole scenes in a seeded order, cut into blocks: each block is guessed by who has seen those before it, and no other.

Progressive validation (Blum, Kalai and Langford 1999). In ordinary cross-validation each fold is guessed from folds
that were guessed from it, so that right guesses come in pairs and their number is not binomial. Here, if words tell
nothing, every guess is a fair draw whatever was seen before, and the number of right ones is exactly binomial.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCKS", "Indices", "blocks", "progressive"]

BLOCKS: Final = 10
"""The first is only learned from."""

Indices = NDArray[np.int64]


def blocks(scenes: Sequence[str], count: int = BLOCKS) -> list[Indices]:
    """Indices of the episodes of each block, ascending; a scene is in one block, and none is empty.

    Parameters
    ----------
    scenes : the scene of each episode
    """
    names = sorted(set(scenes), key=lambda name: hashlib.blake2b(name.encode(), digest_size=8).digest())
    rank = {name: k for k, name in enumerate(names)}
    place = np.array([rank[scene] for scene in scenes], dtype=np.int64)
    sizes = np.bincount(place, minlength=len(names))
    # By the middle of each scene in the row of all episodes, so that blocks are about equally large.
    middles = (np.cumsum(sizes) - sizes / 2) / max(1, sizes.sum())
    block = np.floor(middles * count).astype(np.int64)
    found = [np.flatnonzero(block[place] == k) for k in range(count)] if len(place) else []
    return [indices for indices in found if len(indices)]


def progressive(scenes: Sequence[str], count: int = BLOCKS) -> Iterator[tuple[Indices, Indices]]:
    """(learned from, guessed) of each step."""
    parts = blocks(scenes, count)
    for k in range(1, len(parts)):
        yield np.concatenate(parts[:k]), parts[k]
