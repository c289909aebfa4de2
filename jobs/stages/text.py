"""Stage ``text``: writes the texts of a scene's episodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.steps import published_texts
from condvln.episodes.table import (
    with_text,
)
from condvln.instructions import instructions_with_text
from factory.stage import Stage, StageOutput
from factory.unit import Unit
from jobs.stages.inputs import Tables, dump, programs_of
from schemas.canonical import JSON
from schemas.config import (
    StepBudget,
    TextConfig,
    WordingConfig,
)

__all__ = ["TextStage"]


@dataclass
class TextStage(Stage):
    """Placed programs → instructions and episodes with their text, as they are published."""

    text: TextConfig
    wording: WordingConfig
    max_steps: StepBudget
    seed: int
    name: str = "text"
    version: int = 28
    tables: tuple[str, ...] = ("instructions", "episodes")
    reads: tuple[str, ...] | None = ("programs", "placements", "unplaced", "rooms")

    @cached_property
    def _parameters(self) -> JSON:
        """What `parameters` returns: one object for all units, whose hash is cached."""
        return {
            "text": dump(self.text),
            "instructions": dump(self.wording),
            "episodes": {"max_steps": self.max_steps},
            "seed": self.seed,
        }

    def parameters(self, unit: Unit) -> JSON:
        return self._parameters

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        placements, table = upstream["placements"], upstream["programs"]
        wanted = [*placements["instruction_id"].chunks, *upstream["unplaced"]["instruction_id"].chunks]
        names = pa.chunked_array(wanted, pa.string())
        programs = programs_of(table, names)
        groups = dict(zip(*(placements[c].to_pylist() for c in ("instruction_id", "group_id")), strict=True))
        rows = placements.select(["episode_id", "instruction_id", "start_heading_degrees"]).to_pylist()
        bodies, texts = published_texts(programs, rows, self.text, self.wording, self.seed)
        published = table.filter(pc.is_in(table["instruction_id"], value_set=names))
        return StageOutput(
            tables={
                "instructions": instructions_with_text(published, bodies, groups),
                "episodes": with_text(placements, texts, self.max_steps, self.text.steps_per_word),
            }
        )
