"""Stage ``counts``: what a scene adds to the priors, and their sums over all scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import pyarrow as pa

from condvln.instructions import LabelPriors
from factory.stage import Aggregate, Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, dump
from schemas.canonical import JSON
from schemas.config import SamplingConfig, Thresholds

__all__ = ["CountStage", "PriorsAggregate"]


COUNTING: Final = 16
"""Version of how statements are counted, in a scene and over all scenes."""


@dataclass
class CountStage(Stage):
    """Rooms and objects → for each type of room, how many rooms of the scene hold a label, and how often a statement
    (such as "a pillow near the bed") is true. Workers count; the driver only adds.
    """

    thresholds: Thresholds
    anchor_size: float
    name: str = "counts"
    version: int = COUNTING
    tables: tuple[str, ...] = ("counts",)
    reads: tuple[str, ...] | None = ("rooms", "objects")

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        return {"thresholds": dump(self.thresholds), "sampling": {"anchor_size": self.anchor_size}}

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        found = LabelPriors.of_tables(upstream["rooms"], upstream["objects"], self.thresholds, self.anchor_size)
        return StageOutput(tables={"counts": found.rows()})


@dataclass
class PriorsAggregate(Aggregate):
    """Sums of what is counted in each scene, over all scenes of all sources, and the weights of statements that these
    make even.
    """

    thresholds: Thresholds
    sampling: SamplingConfig
    directions: str
    name: str = "priors"
    version: int = COUNTING
    after: str = "counts"
    tables: tuple[str, ...] = ("counts",)

    def parameters(self) -> JSON:
        sampling = dump(self.sampling)
        read = {key: sampling[key] for key in ("anchor_size", "plausible_share", "presence_share", "predicates")}
        return {
            "thresholds": dump(self.thresholds),
            "sampling": read,
            "instructions": {"directions": self.directions},
        }

    def build(self, tables: Iterator[tuple[str, Tables]]) -> pa.Table:
        scenes = ((unit.partition("/")[0], LabelPriors.from_table(one["counts"])) for unit, one in tables)
        return LabelPriors.of_corpus(scenes, self.sampling, self.directions).table()
