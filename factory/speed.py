"""How fast this machine is beside the one that estimates are measured on: a short probe of numpy and plain Python."""

from __future__ import annotations

import functools
import time
from typing import Final

import numpy as np

__all__ = ["REFERENCE_PROBE_SECONDS", "probe", "slowness"]

REFERENCE_PROBE_SECONDS: Final = 0.037
"""CPU seconds of ``probe`` on the reference machine. Estimates of units are in CPU seconds of that machine, so this is
measured together with them (``python -m benchmarks costs``)."""

_ROUNDS: Final = 4
"""Rounds of the probe; the quickest counts, since whatever disturbs one makes it longer."""


def probe() -> float:
    """CPU seconds of a fixed piece of work: half of it numpy on small arrays, half plain Python. Takes under 0.2 s."""
    return min(_round() for _ in range(_ROUNDS))


@functools.cache
def slowness() -> float:
    """CPU seconds that this machine takes for one CPU second of the reference machine; probed once a process."""
    return probe() / REFERENCE_PROBE_SECONDS


def _round() -> float:
    began = time.process_time()
    # Small arrays, as rooms and paths are: the time goes into calls as much as into arithmetic.
    points = np.arange(900, dtype=np.float64).reshape(300, 3) % 7.0
    total = 0.0
    for at in range(12):
        gaps = points[:, None, :] - points[None, :, :] + at
        total += float(np.sqrt((gaps * gaps).sum(axis=2)).min())
    # Dictionaries, strings and tuples, as the sampling of programs is.
    seen: dict[tuple[str, int], list[int]] = {}
    for at in range(20_000):
        seen.setdefault((f"label {at % 97}", at % 13), []).append(at)
    total += sum(len(values) for values in seen.values())
    assert total > 0
    return time.process_time() - began
