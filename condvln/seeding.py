"""Random generators that depend only on a seed and a purpose, never on worker, rank, order or time. Single draws are
fast.
"""

from __future__ import annotations

import hashlib
import struct
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Draws", "FewDraws", "generator", "stable_hash"]

BLOCK: Final = 4096
"""Number of uniforms that `Draws` draws at once: one call into numpy costs as much as drawing a few hundred."""

FEW: Final = 32
"""Number of uniforms that `FewDraws` draws at once."""

_FEW_WORDS: Final = struct.Struct(f"<{FEW}Q")

T = TypeVar("T")


def stable_hash(*parts: object) -> int:
    """Return a 256-bit integer hash of the text of `parts`; equal on every machine, in every process and Python
    version.
    """
    return int.from_bytes(_digest(parts), "big")


def _text(parts: Sequence[object]) -> bytes:
    return "\x1f".join(map(str, parts)).encode()


def _digest(parts: Sequence[object]) -> bytes:
    return hashlib.sha256(_text(parts)).digest()


def generator(seed: int, *names: object) -> np.random.Generator:
    """Return the random generator for one purpose under a dataset seed. `names` identify the purpose, e.g. scene id and
    stage.
    """
    digest = _digest((seed, *names))
    # The words that NumPy makes of the integer `stable_hash`, which takes longer: lowest first, without highest zeros.
    words = np.frombuffer(digest, ">u4")[::-1].astype(np.uint32)
    entropy = words if words[-1] else int.from_bytes(digest, "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))


class Draws:
    """A stream of random choices that is fully determined by its generator."""

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._drawn: list[float] = []
        """Uniforms that were drawn ahead, the next one last."""

    def uniform(self) -> float:
        """Return a float in [0, 1)."""
        if not self._drawn:
            self._drawn = self._generator.random(BLOCK).tolist()
        return self._drawn.pop()

    def index(self, n: int) -> int:
        """Return a random index below `n`. All indices are equally likely, except for a negligible bias of n · 2⁻⁵³."""
        return int(self.uniform() * n)

    def choice(self, items: Sequence[T]) -> T:
        """Return one of `items`, each equally likely."""
        return items[self.index(len(items))]

    def cumulative(self, sums: Sequence[float]) -> int:
        """Return a random index, with probabilities in proportion to weights. `sums` are the running sums of the
        weights.
        """
        return bisect_right(sums, self.uniform() * sums[-1], 0, len(sums) - 1)

    def weighted(self, items: Sequence[T], weights: Sequence[float]) -> T:
        """Return one of `items`, drawn with probabilities in proportion to `weights`. At least one weight must be
        positive.
        """
        return items[self.cumulative(tuple(accumulate(weights)))]

    def sample(self, items: Sequence[T], k: int) -> list[T]:
        """Return the items at `k` different random positions of `items`, in random order."""
        pool = list(items)
        return [pool.pop(self.index(len(pool))) for _ in range(k)]


class FewDraws(Draws):
    """A stream of random choices for purposes that need few of them, such as one text. It is read from SHAKE-256 of the
    seed and the names of the purpose, which begins in a fraction of the time that a generator takes.
    """

    def __init__(self, seed: int, *names: object) -> None:
        self._hash = hashlib.shake_256(_text((seed, *names)))
        self._read = 0
        self._words: list[int] = []
        """What was taken ahead for single draws, the next one last."""

    def uniform(self) -> float:
        """Return a float in [0, 1)."""
        if not self._words:
            begin, self._read = self._read, self._read + FEW
            self._words = [*_FEW_WORDS.unpack_from(self._hash.digest(8 * self._read), 8 * begin)][::-1]
        return (self._words.pop() >> 11) * 2.0**-53

    def uniforms(self, n: int) -> NDArray[np.float64]:
        """Return `n` floats (n,) in [0, 1). The hash is computed from its beginning each time, so draw many at once."""
        begin, self._read = self._read, self._read + n
        words = np.frombuffer(self._hash.digest(8 * self._read), "<u8", offset=8 * begin)
        return np.asarray((words >> np.uint64(11)) * 2.0**-53)
