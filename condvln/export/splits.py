"""Assign each scene to exactly one group of splits: {train, val_seen}, {val_unseen} or {test}.

Families with official lists keep to them, so that pretrained agents have not seen our test scenes. All other scenes are
assigned by the hash of their own id, so that adding a scene moves no other.
"""

from __future__ import annotations

import hashlib
from fnmatch import fnmatchcase
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from condvln.sources.family import FAMILIES, SplitGroup
from schemas.config import SplitsConfig
from schemas.errors import ConfigError

__all__ = ["GROUPS", "SPLITS", "Group", "Split", "fractions", "hash_fraction", "scene_group"]

Split = Literal["train", "val_seen", "val_unseen", "test"]
SPLITS: Final[tuple[Split, ...]] = ("train", "val_seen", "val_unseen", "test")

Group = SplitGroup

GROUPS: Final[tuple[Group, ...]] = ("train", "val_unseen", "test")


def scene_group(family: str, scene_id: str, config: SplitsConfig) -> Group:
    """Return the group of a scene: the group that the configuration names, else the one in the official list, else one
    by the hash of the scene's name.

    Raises
    ------
    ConfigError : the configuration puts the scene into two groups
    """
    configured = _configured(family, scene_id, config)
    if configured is not None:
        return configured
    official = FAMILIES[family].official_split(scene_id) if family in FAMILIES else None
    if official is not None:
        return official
    at = hash_fraction(config.seed, family, scene_id)
    bounds = (config.fractions[0], config.fractions[0] + config.fractions[1])
    return GROUPS[0] if at < bounds[0] else GROUPS[1] if at < bounds[1] else GROUPS[2]


def fractions(hashes: npt.NDArray[np.uint64], seed: int, purpose: str) -> npt.NDArray[np.float64]:
    """Return, for each of the 64-bit `hashes`, a number in [0, 1) that depends only on the hash, ``seed`` and
    ``purpose``.

    The mixer is SplitMix64's finaliser (Steele, Lea and Flood 2014).
    """
    salt = hashlib.blake2b(f"{seed}\0{purpose}".encode(), digest_size=8).digest()
    mixed = hashes ^ np.uint64(int.from_bytes(salt, "big"))
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    mixed ^= mixed >> np.uint64(31)
    found: npt.NDArray[np.float64] = (mixed >> np.uint64(11)).astype(np.float64) / 2.0**53
    return found


def hash_fraction(seed: int, *names: str) -> float:
    """Return a number in [0, 1) that depends only on ``seed`` and ``names``."""
    text = "\0".join((str(seed), *names)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big") / 2.0**64


def _configured(family: str, scene_id: str, config: SplitsConfig) -> Group | None:
    name = f"{family}/{scene_id}"
    found = [g for g in GROUPS if any(fnmatchcase(name, pattern) for pattern in config.scenes.get(g, ()))]
    if len(found) > 1:
        raise ConfigError(
            f"the patterns put {name} in {found[0]} and in {found[1]}",
            place="splits.scenes",
            remedy="Narrow one of the patterns: splits share no scene.",
        )
    return found[0] if found else None
