"""Random generators named by what they are for: never by worker, rank, order or time."""

from __future__ import annotations

import hashlib

import numpy as np

__all__ = ["generator", "stable_hash"]


def stable_hash(*parts: object) -> int:
    """256-bit integer from the text of `parts`; equal on every machine, process and Python."""
    text = "\x1f".join(str(part) for part in parts)
    return int.from_bytes(hashlib.sha256(text.encode()).digest(), "big")


def generator(seed: int, *names: object) -> np.random.Generator:
    """The generator of one purpose (`names`, e.g. scene id and stage) under one dataset seed."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(stable_hash(seed, *names))))
