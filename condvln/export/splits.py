"""Assign each scene to exactly one group of splits: {train, val_seen}, {val_unseen} or {test}.

Families with official lists keep to them, so that pretrained agents have not seen our test scenes. All other scenes are
assigned by the hash of their own id, so that adding a scene moves no other.

Episodes are counted and scored by classes of observability, route length and text length.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from fnmatch import fnmatchcase
from functools import cache
from itertools import pairwise
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from condvln.sources.family import FAMILIES, SplitGroup
from schemas.config import SplitsConfig
from schemas.errors import ConfigError

__all__ = [
    "GROUPS",
    "OBSERVED",
    "ROUTE_BOUNDS",
    "SHAPE_AXES",
    "SPLITS",
    "WORD_BOUNDS",
    "Group",
    "Split",
    "fractions",
    "hash_fraction",
    "observability_class",
    "oddness_class",
    "route_class",
    "scene_group",
    "words_class",
]

SHAPE_AXES: Final = (
    *("category", "depth", "chain", "composition", "oddness", "observability", "moves", "leads", "route", "words"),
)
"""What episodes are counted and scored by, besides their scene."""

ROUTE_BOUNDS: Final = (5, 10, 20)
"""Route lengths in metres at which the next class begins; single rooms seldom reach the second."""

WORD_BOUNDS: Final = (40, 80, 120)
"""Numbers of words at which the next class begins."""

ODDNESS_BOUNDS: Final = (1, 3, 6, 11)
"""Oddness at which the next class begins; the first class is 0 alone."""

OBSERVED: Final = {
    "O0f": "all evidence is in the first view",
    "O0": "all evidence is seen from the start by turning",
    "O1": "evidence is seen on the way that all leaves share",
    "O2": "evidence is seen after a detour only",
}
"""Classes of observability. Columns and cells know no O0f apart: there O0 is both."""


def observability_class(observability: str | None, evidence_in_view: bool | None) -> str | None:
    """Return O0f if all evidence is in the first view, else O0, O1 or O2; None if unknown."""
    return "O0f" if observability == "O0" and evidence_in_view else observability


def route_class(route_length: float) -> str:
    """Return the class of a gold route's length in metres, such as ``05–10 m``; sorting classes as text keeps their
    order.
    """
    return f"{_between(route_length, ROUTE_BOUNDS, 2)} m"


def oddness_class(oddness: int | None) -> str | None:
    """Return the class of an instruction's oddness, such as ``01–02``; sorting classes as text keeps their order."""
    return None if oddness is None else _between(oddness, ODDNESS_BOUNDS, 2, last=1)


def words_class(words: int) -> str:
    """Return the class of a text's number of words, such as ``040–079``; sorting classes as text keeps their order."""
    return _between(words, WORD_BOUNDS, 3, last=1)


def _between(value: float, bounds: tuple[int, ...], digits: int, last: int = 0) -> str:
    return _classes(bounds, digits, last)[bisect_right(bounds, value)]


@cache
def _classes(bounds: tuple[int, ...], digits: int, last: int) -> list[str]:
    """Return the names of all classes that begin at 0 and at `bounds`."""
    ends = [(f"{low:0{digits}}", f"{high - last:0{digits}}") for low, high in pairwise((0, *bounds))]
    return [*(low if low == high else f"{low}–{high}" for low, high in ends), f"{bounds[-1]:0{digits}}+"]


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
