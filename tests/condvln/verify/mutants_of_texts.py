"""Faults in the words of an instruction."""

from __future__ import annotations

import numpy as np
from mutation import Files, World, mutator, pick

from condvln.verify.text_reader import Unreadable, read
from condvln.verify.words import words
from schemas.program import Program


@mutator
def swap_words(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Two neighbouring words change places; sentences that come to mean the same are no faults."""
    text = files.manifest["instruction_text"].split()
    k = int(rng.integers(len(text) - 1))
    text[k], text[k + 1] = text[k + 1], text[k]
    return _say_if_other(files, " ".join(text))


@mutator
def swap_far_words(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"].split()
    one, other = rng.choice(len(text), 2, replace=False)
    text[one], text[other] = text[other], text[one]
    return _say_if_other(files, " ".join(text))


@mutator
def drop_a_word(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"].split()
    del text[rng.integers(len(text))]
    return _say_if_other(files, " ".join(text))


@mutator
def negate_a_clause(files: Files, rng: np.random.Generator, world: World) -> bool:
    text = files.manifest["instruction_text"]
    for affirmed, denied in (
        ("if there is a ", "if there is no "),
        ("if there's a ", "if there's no "),
        (" is near ", " isn't near "),
        (" it's near ", " it isn't near "),
        (" has a ", " has no "),
    ):
        if affirmed in text:
            return _say_if_other(files, text.replace(affirmed, denied, 1))
    return False


@mutator
def turn_definite(files: Files, rng: np.random.Generator, world: World) -> bool:
    """The program takes a thing for known that is not, or the other way round; the text says the same."""
    if not _turned(files, rng):
        return False
    files.word()
    return True


@mutator
def turn_definite_in_program(files: Files, rng: np.random.Generator, world: World) -> bool:
    """Only the program does; the text stays."""
    return _turned(files, rng)


def _turned(files: Files, rng: np.random.Generator) -> bool:
    relational = [condition for condition in files.conditions if condition["qualifier"] is not None]
    if not relational:
        return False
    condition = pick(rng, relational)
    condition["definite"] = not condition["definite"]
    return True


@mutator
def replace_a_noun_in_text(files: Files, rng: np.random.Generator, world: World) -> bool:
    program = Program.model_validate(files.manifest["program"])
    label = pick(rng, [leaf.goal.label for leaf in program.leaves])
    noun = words().nouns[label][0]
    other = pick(rng, sorted({n for n, _ in words().nouns.values()} - {noun}))
    return _say_if_other(files, files.manifest["instruction_text"].replace(f"the {noun}", f"the {other}"))


@mutator
def face_elsewhere(files: Files, rng: np.random.Generator, world: World) -> bool:
    head, _, rest = files.manifest["instruction_text"].partition(". ")
    for name in ("north-east", "north-west", "south-east", "south-west", "north", "south", "east", "west"):
        if head.endswith(f" {name}"):
            other = pick(rng, {"north", "east", "south", "west", "north-east"} - {name})
            files.say(f"{head.removesuffix(name)}{other}. {rest}")
            return True
    return False


@mutator
def drop_the_heading(files: Files, rng: np.random.Generator, world: World) -> bool:
    head, _, rest = files.manifest["instruction_text"].partition(". ")
    if "facing " not in head:
        return False
    files.say(rest)
    return True


def _say_if_other(files: Files, text: str) -> bool:
    before = files.manifest["instruction_text"]
    if text.lower() == before.lower():
        return False
    try:
        if read(text) == read(before):
            return False
    except Unreadable:
        pass
    files.say(text)
    return True
