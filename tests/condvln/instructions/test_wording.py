"""Phrases read well in whatever sentence they land; each rule here was broken once."""

from __future__ import annotations

import re
from itertools import product

import pytest

from condvln.instructions import instruction_id, render
from condvln.instructions.language import LANGUAGES, language


@pytest.mark.parametrize("code", LANGUAGES)
def test_a_condition_is_opened_in_one_way_throughout(sampled, code: str) -> None:
    """ "Provided that …, and if …" reads as two kinds of condition; "if …, and if …" is fine."""
    words = language(code)
    openers = words.slots["if"].texts
    joints = {
        (joint.split(" ", 1)[1], joint)
        for slot in ("and", "but")
        for joint in words.slots[slot].texts
        if " " in joint and joint.split(" ", 1)[1] in openers
    }
    assert joints or code != "en"
    met = 0
    for scene, _, _, programs in sampled:
        for program in programs:
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program), code).lower()
            for opener, joint in joints:
                for found in re.finditer(rf"(?<!, )\b{joint}\b", text):
                    met += 1
                    clause = re.split(r"[.:;] ", text[: found.start()])[-1]
                    opened = [x for x in openers if re.search(rf"(?:^|, ){x} ", clause)]
                    assert opened == [opener], text
    assert met > 3 or not joints


@pytest.mark.parametrize("code", LANGUAGES)
def test_here_is_not_said_of_a_room_that_was_named(sampled, code: str) -> None:
    """ "This is all about the kitchen. If there is a lamp here, …": an agent in the hallway looks around there."""
    slots, met = language(code).slots, 0
    scoped, here = ("|".join(map(re.escape, slots[slot].texts)) for slot in ("scope", "anywhere"))
    for scene, _, _, programs in sampled:
        for program in programs:
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program), code).lower()
            if re.match(rf"(?:{scoped})\b", text):
                met += 1
                assert not re.search(rf" (?:{here})[.,:;]", text), text
    assert met > 10


@pytest.mark.parametrize("code", LANGUAGES)
def test_the_room_said_once_claims_no_existence(code: str) -> None:
    """ "Everything named here is in the kitchen" would say that the kettle asked for is there."""
    for phrase in language(code).slots["scope"].texts:
        assert not re.search(r"\b(?:is|are|está|están)(?: all)? (?:in|en)$|\btodo en$", phrase), phrase


def test_no_verb_meets_itself() -> None:
    """ "You find a lamp found in the kitchen", "if it turns out that the kitchen turns out to have"."""
    slots = language("en").slots
    predicates = [text for phrases in language("en").predicates.values() for text in phrases.texts]
    stems = re.compile(r"f(?:i|ou)nd|turns? out|happens?|mention|situat|locat")
    after = [*slots["in"].texts, *predicates]
    for first, second in [
        *product((*slots["exists"].texts, *slots["absent"].texts), after),
        *product(slots["if"].texts, (*slots["has"].texts, *slots["lacks"].texts)),
    ]:
        repeated = {*stems.findall(first.replace("found", "find"))} & {*stems.findall(second.replace("found", "find"))}
        assert not repeated, (first, second)


def test_spanish_denials_need_no_subjunctive() -> None:
    """ "No hay ninguna silla que está cerca" is no Spanish ("que esté" is): what may follow a denial has no verb."""
    words = language("es")
    after = [*words.slots["in"].texts, *(text for phrases in words.predicates.values() for text in phrases.texts)]
    for phrase in after:
        assert not re.match(r"que\b", phrase), phrase


def test_spanish_joints_go_with_denials_too() -> None:
    """ "Y también no hay" is no Spanish ("y tampoco hay" is)."""
    assert not any("también" in phrase for phrase in language("es").slots["and"].texts)
    assert not any(phrase.startswith("sí ") for phrase in language("es").slots["again"].texts), "si sí hay"


@pytest.mark.parametrize("code", LANGUAGES)
def test_no_noun_swallows_what_follows_a_shorter_one(code: str) -> None:
    """ "Armario bajo" (base cabinet) and "armario" with "bajo el televisor" (under the television) read alike."""
    words = language(code)
    slots = ("in", "same", "with", "anywhere", "then", "finally", "and", "but")
    after = [text for slot in slots for text in words.slots[slot].texts]
    after += [text for phrases in words.predicates.values() for text in phrases.texts]
    for nouns in (words.nouns, words.rooms):
        texts = [noun.text for noun in nouns.values()]
        for short, long in product(texts, texts):
            if long.startswith(f"{short} "):
                taken = [x for x in after if f"{short} {x.strip(', ')} ".startswith(f"{long} ")]
                assert not taken, (short, long, taken)
