"""Documents of a benchmark: the file that defines a version, the record of a build, and a leaderboard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from schemas.base import Document, Finite, VersionedDocument
from schemas.unit import Hash32, Hash64

__all__ = [
    "BenchmarkCell",
    "BenchmarkFile",
    "BenchmarkRecord",
    "BenchmarkScene",
    "BenchmarkSource",
    "BenchmarkStops",
    "Leaderboard",
    "LeaderboardRow",
    "MeasuredMean",
    "PairedDifference",
]

Count = Annotated[int, Field(ge=0)]


class BenchmarkFile(Document):
    """``configs/benchmark.yaml``: the content of one version of a benchmark."""

    benchmark: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=100)]
    version: str = Field(min_length=1, max_length=100)
    draft: bool
    """a draft may still change; results on a draft are not comparable with results on other versions"""
    run: Path
    """configuration of the run: sources, seeds, counts and splits; relative to this file"""
    floor: int = Field(ge=1)
    """minimum number of episodes in each cell split × source × category; smaller cells are reported"""
    instructions: Count
    """minimum number of instructions over all sources; a build with fewer reports the shortfall"""
    splits: tuple[Literal["train", "val_seen", "val_unseen", "test"], ...] = Field(
        ("train", "val_seen", "val_unseen", "test"), min_length=1
    )
    """splits in which every cell must reach the floor"""
    scenes: dict[str, Count] = Field(default_factory=dict)
    """number of scenes that the run takes of whole copies of the datasets, by family; a build with fewer says so"""


class BenchmarkCell(Document):
    """The number of episodes of one split, source and category, and the shortfall."""

    split: str
    source: str
    category: str
    episodes: Count
    shortfall: Count
    """number of episodes by which the cell is below the floor"""


class BenchmarkSource(Document):
    """The yield of the scenes of one family."""

    scenes: Count
    """number of scenes that were processed"""
    instructions: Count
    episodes: Count
    """number of episodes in all splits of the export"""


class BenchmarkStops(Document):
    """How many stops the leaves of one split have before their goal, among programs with equally many leaves."""

    split: str
    leaves: Annotated[int, Field(ge=2, description="number of leaves of the programs")]
    stops: tuple[Count, Count, Count]
    """number of leaves with no, one and two stops"""


class BenchmarkScene(Document):
    """The source and the result of one scene."""

    status: Literal["ok", "skipped", "quarantined"]
    reason: str = ""
    inputs: Hash32 | None
    """hash of the scene's source files, with their paths below the dataset"""
    tables: dict[str, Hash32]
    """hash of the scene's rows, by <stage>/<table>"""


class BenchmarkRecord(VersionedDocument):
    """``benchmark.json``: the record of one build. Equal sources and versions give equal bytes."""

    benchmark: str
    version: str
    draft: bool
    snapshot_id: Hash32
    export_digest: Hash64
    stages: dict[str, int]
    """versions of the code that decides rows: of each stage, of the priors, and of the choice of episodes (select)"""
    configuration: dict[str, Any]
    """configuration keys that affect rows; no paths of this machine"""
    instructions: Count
    episodes: dict[str, Count]
    sources: dict[str, BenchmarkSource]
    """yield of each family"""
    stops: list[BenchmarkStops]
    """stops before the goals of all leaves"""
    cells: list[BenchmarkCell]
    scenes: dict[str, BenchmarkScene]


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
