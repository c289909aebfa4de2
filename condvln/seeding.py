"""Random generators named by what they are for, never by worker, rank, order or time; and fast single choices."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Final, TypeVar

import numpy as np

__all__ = ["Draws", "generator", "stable_hash"]

BLOCK: Final = 4096
"""Uniforms drawn at once; a call into numpy costs as much as drawing some hundred of them."""

T = TypeVar("T")


def stable_hash(*parts: object) -> int:
    """256-bit integer from the text of `parts`; equal on every machine, process and Python."""
    text = "\x1f".join(str(part) for part in parts)
    return int.from_bytes(hashlib.sha256(text.encode()).digest(), "big")


def generator(seed: int, *names: object) -> np.random.Generator:
    """The generator of one purpose (`names`, e.g. scene id and stage) under one dataset seed."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(stable_hash(seed, *names))))


class Draws:
    """A stream of choices, fully decided by its generator."""

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._block: list[float] = []

    def uniform(self) -> float:
        """A float in [0, 1)."""
        if not self._block:
            self._block = self._generator.random(BLOCK).tolist()
        return self._block.pop()

    def index(self, n: int) -> int:
        """A uniform index below `n`; the bias of n · 2⁻⁵³ is beyond notice."""
        return int(self.uniform() * n)

    def choice(self, items: Sequence[T]) -> T:
        """One of `items`, each equally likely."""
        return items[self.index(len(items))]

    def cumulative(self, sums: Sequence[float]) -> int:
        """An index drawn by weights given as their running sums."""
        return min(bisect_right(sums, self.uniform() * sums[-1]), len(sums) - 1)

    def weighted(self, items: Sequence[T], weights: Sequence[float]) -> T:
        """One of `items` by `weights`; at least one weight is positive."""
        return items[self.cumulative(tuple(accumulate(weights)))]

    def sample(self, items: Sequence[T], k: int) -> list[T]:
        """`k` different positions of `items`, in random order."""
        pool = list(items)
        return [pool.pop(self.index(len(pool))) for _ in range(k)]
