"""Stage ``text``: writes the texts of a scene's episodes."""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter

import pyarrow as pa

from condvln.episodes.steps import published_texts
from condvln.episodes.table import (
    with_text,
)
from condvln.instructions import instruction_table
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
    version: int = 27
    tables: tuple[str, ...] = ("instructions", "episodes")
    reads: tuple[str, ...] | None = ("candidates", "placements", "unplaced", "rooms")

    def parameters(self, unit: Unit) -> JSON:
        return {
            "text": dump(self.text),
            "instructions": dump(self.wording),
            "episodes": {"max_steps": self.max_steps},
            "seed": self.seed,
        }

    def run(self, unit: Unit, upstream: Tables, shared: Tables) -> StageOutput:
        placements = upstream["placements"]
        candidates = upstream["candidates"]
        wanted = [*placements["instruction_id"].chunks, *upstream["unplaced"]["instruction_id"].chunks]
        names = pa.chunked_array(wanted, pa.string())
        programs = programs_of(candidates, names)
        groups = dict(zip(*(placements[c].to_pylist() for c in ("instruction_id", "group_id")), strict=True))
        rows = placements.select(["episode_id", "instruction_id", "start_heading_degrees"]).to_pylist()
        bodies, texts = published_texts(programs, rows, self.text, self.wording, self.seed)
        return StageOutput(
            tables={
                "instructions": instruction_table(
                    str(unit.payload["scene_id"]), sorted(programs.items(), key=itemgetter(0)), bodies, groups
                ),
                "episodes": with_text(placements, texts, self.max_steps, self.text.steps_per_word),
            }
        )
