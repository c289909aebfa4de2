"""Render a program as text. All wording comes from the language's data; choices are seeded by the instruction's id.

A text uses one voice and one phrase for each slot, so that it sounds like one person; only requests and answers take
turns. An object that is the only one of its label in its room is definite ("if the bike is near the sofa"). A room that
is named by an object in it ("the bedroom with the desk") is "that bedroom" from then on, and a stop in the room named
last is "there", in the same clause or in those after the condition that named it. A thing that the text has named with
its room is later named without it. A condition always names its room, unless it is repeated. If everything is in one
named room, the text names it once, at the beginning. A lead opens the text ("Go to the kitchen. If there's a lamp, …")
or is part of a request ("go to the kitchen and look for a lamp"); its condition does not name the room again.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import lru_cache
from itertools import accumulate
from typing import Final

from condvln.instructions.language import Voice, language, sentences
from condvln.instructions.predicates import COMPASS
from condvln.instructions.renderer import Renderer
from condvln.seeding import FewDraws, stable_hash
from schemas.config import WordingConfig
from schemas.config.constants import HEADING_TOLERANCE
from schemas.errors import UsageError
from schemas.program import ObjectRef, Program, RoomRef

__all__ = [
    "HEADINGS",
    "heading_name",
    "names_compass",
    "preamble",
    "render",
    "render_moves",
    "voice_of",
    "with_preamble",
    "word_count",
]

HEADINGS: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
"""Names of the headings 0°, 45°, … clockwise from north."""


def names_compass(program: Program) -> bool:
    """Return whether the text of `program` uses compass words, so that it must begin with the start heading."""
    qualifiers = [condition.qualifier for condition in program.conditions]
    qualifiers += [move.qualifier for leaf in program.leaves for move in leaf.moves]
    return any(qualifier is not None and qualifier.predicate in COMPASS for qualifier in qualifiers)


def heading_name(heading_degrees: float) -> str:
    """Return the name of a compass heading in degrees clockwise from north.

    Raises
    ------
    UsageError
        The heading is not a multiple of 45°, so that no sentence could state it exactly.
    """
    steps = heading_degrees / 45.0
    if abs(steps - round(steps)) * 45.0 > HEADING_TOLERANCE:
        raise UsageError(
            f"the heading {heading_degrees}° is not a multiple of 45°",
            remedy="Choose starts at multiples of 45° for texts with compass words",
        )
    return HEADINGS[round(steps) % len(HEADINGS)]


@lru_cache(maxsize=1024)
def voice_of(seed: int, instruction_id: str, wording: WordingConfig | str = "en") -> Voice:
    """Return the voice of an instruction, chosen from the allowed voices. If `wording` is only a language code, all
    voices of the language are allowed.
    """
    said = _wording(wording)
    voices, sums = _allowed(said)
    share = stable_hash("voice", seed, instruction_id, said.language) / 2**256
    return voices[min(bisect_right(sums, share * sums[-1]), len(sums) - 1)]


@lru_cache
def _allowed(said: WordingConfig) -> tuple[tuple[Voice, ...], tuple[float, ...]]:
    """Return the voices that the wording `said` allows, in the language's order, and their cumulative weights."""
    voices = tuple(voice for voice in language(said.language).voices if voice.name in said.voices)
    return voices, tuple(accumulate(voice.weight for voice in voices))


def _wording(wording: WordingConfig | str) -> WordingConfig:
    return _all_voices(wording) if isinstance(wording, str) else wording


@lru_cache
def _all_voices(code: str) -> WordingConfig:
    return WordingConfig.model_validate({"language": code})


def preamble(heading_degrees: float, voice: Voice, code: str = "en") -> str:
    """Return the sentence that states the start heading ("You're facing north-east.") in the words of a voice."""
    return _facing(voice.slots["facing"][0], heading_name(heading_degrees), code)


@lru_cache
def _facing(phrase: str, heading: str, code: str) -> str:
    words = language(code)
    return sentences(words, f"{phrase} {words.directions[heading]}.")


def with_preamble(
    text: str, heading_degrees: float, seed: int, instruction_id: str, wording: WordingConfig | str = "en"
) -> str:
    """Return `text` after the sentence that states the start heading, in the voice of the instruction."""
    voice = voice_of(seed, instruction_id, wording)
    return f"{preamble(heading_degrees, voice, _wording(wording).language)} {text}"


def render(program: Program, seed: int, instruction_id: str, wording: WordingConfig | str = "en") -> str:
    """Return the text of `program`, which is determined by `seed`, `instruction_id` and `wording`. If `wording` is only
    a language code, all voices of the language are allowed.

    If the length in `wording` is "short", the text uses the shortest phrases and templates of its voice.
    """
    said = _wording(wording)
    code = said.language
    words, voice = language(code), voice_of(seed, instruction_id, said)
    draws = FewDraws(seed, "text", instruction_id, code)
    return Renderer(words, voice, draws, short=said.length == "short").program(program)


def word_count(
    program: Program, seed: int, instruction_id: str, wording: WordingConfig | str = "en", *, preamble: bool
) -> int:
    """Return the number of words that the published text of `program` will have. The start heading need not be known,
    since the name of every heading is one word.

    preamble : whether texts that use compass words begin with the start heading
    """
    text = render(program, seed, instruction_id, wording)
    if preamble and names_compass(program):
        text = with_preamble(text, 0.0, seed, instruction_id, wording)
    return len(text.split())


def render_moves(
    moves: tuple[RoomRef | ObjectRef, ...], seed: int, instruction_id: str, wording: WordingConfig | str = "en"
) -> str:
    """Return a sequence of moves as one sentence: the text of an oracle-linear twin."""
    said = _wording(wording)
    words, voice = language(said.language), voice_of(seed, instruction_id, said)
    draws = FewDraws(seed, "text", instruction_id, said.language)
    return sentences(words, f"{Renderer(words, voice, draws, short=said.length == 'short').moves(moves)}.")
