"""Documents of a benchmark: the index of a pack, and a leaderboard."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from schemas.base import Document, Finite, VersionedDocument
from schemas.config import Family
from schemas.unit import Hash32, Hash64

__all__ = [
    "BenchmarkPack",
    "Leaderboard",
    "LeaderboardRow",
    "MeasuredMean",
    "PackedFile",
    "PackedInput",
    "PackedSource",
    "PairedDifference",
]

Count = Annotated[int, Field(ge=0)]


def _inside(path: str) -> str:
    """Return the path if it leads to one file below whatever folder it is put behind."""
    if not path.isprintable() or re.search(r"\\|^[A-Za-z]:", path) or {"", ".", ".."} & {*path.split("/")}:
        raise ValueError("not a plain path below a folder")
    return path


RelativePath = Annotated[str, Field(max_length=1000), AfterValidator(_inside)]
"""A path below a folder, '/'-separated."""


class PackedFile(Document):
    """One file of the export. A ``.gz`` file stands in the pack without its compression, which repeats poorly."""

    path: RelativePath
    bytes: Count
    """size of the export's file"""
    sha256: Hash64
    """of the export's file"""
    level: Annotated[int, Field(ge=0, le=9)] | None = None
    """zlib level with which the stored content is compressed again; null: stored as it is"""
    content: tuple[Count, Hash64] | None = None
    """size and SHA-256 of the content without compression, where there is a level"""
    stored: bool = True
    """false: a navmesh whose scene's terms forbid to pass it on; it is built again from the user's copy"""


class PackedInput(Document):
    """A file of a dataset, or an entry of one, on which scenes rest."""

    path: RelativePath
    """path below the dataset's folder where the export was made"""
    entry: str | None = None
    """one entry of the file, such as the number of a line; null: the whole file"""
    bytes: Count
    sha256: Hash64


class PackedSource(Document):
    """The scenes of one family."""

    inputs: list[PackedInput]
    """sorted by path and entry"""
    shared: list[PackedInput]
    """whole files of which ``inputs`` names entries"""
    scenes: dict[str, list[Count]]
    """for each scene the places in ``inputs`` of all that it rests on"""

    @model_validator(mode="after")
    def _within(self) -> PackedSource:
        if any(place >= len(self.inputs) for places in self.scenes.values() for place in places):
            raise ValueError("a scene rests on an input that is not listed")
        return self


class BenchmarkPack(Document):
    """``benchmark.json``: the index of a pack, and of the export that is unpacked from it."""

    format: Literal[1]
    """format of the pack, the only version that its readers ask for"""
    benchmark: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    version: str = Field(min_length=1, max_length=100)
    draft: bool
    """a draft may still change: results on it are not published"""
    snapshot_id: Hash32
    episodes: dict[str, Count]
    """number of episodes of each split"""
    sources: dict[Family, PackedSource]
    """the scenes, by family"""
    files: list[PackedFile]
    """all files of the export, in the order of the pack"""


class MeasuredMean(Document):
    """A mean and its 95 % confidence interval over scenes; an undefined value is null."""

    mean: Finite | None
    low: Finite | None
    high: Finite | None
    n: Count


class PairedDifference(Document):
    """The success of a leaderboard row minus the success of the row above it, with the p-value of a paired permutation
    test by scene.
    """

    above: str
    difference: Finite
    p_value: Finite
    scenes: Count


class LeaderboardRow(Document):
    """One agent and its scores."""

    agent: str
    kind: Literal["reference", "submission"]
    predictions_sha256: Hash64 | None
    """SHA-256 of the file; null for reference agents, which are walked again"""
    episodes: Count
    missing: Count
    measures: dict[str, MeasuredMean]
    notes: tuple[str, ...] = ()
    """what was left out or changed when the agent's file was read"""
    against_above: PairedDifference | None
    """difference from the row above; null in the first row"""


class Leaderboard(VersionedDocument):
    """The agents on one split of one version, the best first."""

    benchmark: str
    version: str
    draft: bool
    snapshot_id: Hash32
    split: str
    seed: int
    """seed of the random reference agents and of the confidence intervals"""
    rows: list[LeaderboardRow]
