"""Instructions: from the relation graph to typed conditional programs and text, and from text back to its meaning."""

from condvln.instructions.parsing import parse
from condvln.instructions.priors import LabelPriors, PriorBits
from condvln.instructions.programs import (
    instruction_id,
    instruction_table,
    instructions_with_text,
    oracle_linear,
    program_key,
    programs_from_table,
)
from condvln.instructions.rendering import names_compass, render, render_moves, voice_of, with_preamble
from condvln.instructions.sampling import ProgramSampler, counterfactual_group, group_id
from condvln.instructions.stops import Stops, apart_by_centres
from condvln.instructions.text_reading import Reading, reading_of

__all__ = [
    "LabelPriors",
    "PriorBits",
    "ProgramSampler",
    "Reading",
    "Stops",
    "apart_by_centres",
    "counterfactual_group",
    "group_id",
    "instruction_id",
    "instruction_table",
    "instructions_with_text",
    "names_compass",
    "oracle_linear",
    "parse",
    "program_key",
    "programs_from_table",
    "reading_of",
    "render",
    "render_moves",
    "voice_of",
    "with_preamble",
]
