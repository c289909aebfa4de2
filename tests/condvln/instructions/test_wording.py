"""Phrases read well in whatever sentence they land; each rule here was broken once."""

from __future__ import annotations

import re
from itertools import product

import pytest

from condvln.instructions import instruction_id, render, voice_of
from condvln.instructions.language import LANGUAGES, language
from condvln.instructions.predicates import ASKED


@pytest.mark.parametrize("code", LANGUAGES)
def test_a_text_is_in_one_voice(sampled, code: str) -> None:
    """Its verbs of motion, two at most, are those of the voice alone."""
    words = language(code)
    verbs = {verb for voice in words.voices for verb in voice.slots["go"]}
    for scene, _, _, programs in sampled:
        for program in programs:
            name = instruction_id(scene.family, scene.scene_id, program)
            text = words.expanded(render(program, 0, name, code).lower())
            own = set(voice_of(0, name, code).slots["go"])
            said = {verb for verb in verbs if re.search(rf"(?:^|[,:.] ){verb}\b", text)}
            assert 1 <= len(said) <= 2, text
            assert said <= own, text


def test_spanish_denials_need_no_subjunctive() -> None:
    """ "No hay ninguna silla que está cerca" is not Spanish ("que esté" is): what may follow a denial has no verb."""
    words = language("es")
    after = [*words.slots["in"], *(text for predicate in ASKED for text in words.predicates[predicate])]
    for phrase in after:
        assert not re.match(r"que\b", phrase), phrase


def test_spanish_answers_agree_with_what_was_asked(sampled) -> None:
    """ "Mira si hay una silla. Si hay alguna, …": the answer has the gender of the thing asked about last."""
    words = language("es")
    kinds = {noun.text: noun.kind for _, noun in words.nouns_of_all_rooms}
    met = set()
    for scene, _, _, programs in sampled:
        for program in programs:
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program), "es").lower()
            nouns = "|".join(sorted(map(re.escape, kinds), key=len, reverse=True))
            for found in re.finditer(r"si (?:(?:hay algun|no hay ningun)([oa])|(?:no )?l([oa]) hay)(?=[,;:.])", text):
                asked = re.findall(rf"\b(?:una?|ningun[ao]|ningún) ({nouns})(?![\w-])", text[: found.start()])
                ending = found[1] or found[2]
                met.add(ending)
                assert ending == {"m": "o", "f": "a"}[kinds[asked[-1]]], text
    assert met == {"o", "a"}


def test_an_elliptic_answer_follows_a_question_with_its_verb(sampled) -> None:
    """ "Look for a chair. If there is, …" and "the kitchen has a chair. If there is, …" lack a word."""
    clauses = re.compile(
        r"there(?:'s| is) (?:an?|no)|is there an?|\b(?:look|check [^.:]*) for an?|(?:ha[sv]e?|has no) an?"
    )
    met = 0
    for scene, _, _, programs in sampled:
        for program in programs[::3]:
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program)).lower()
            for found in re.finditer(r"if (?:there is|there isn't|there is not),", text):
                asked = [m[0] for m in clauses.finditer(text[: found.start()])][-1]
                assert "there" in asked, text
                met += 1
    assert met > 50


def test_only_a_question_is_answered_by_so_or_not(sampled) -> None:
    """ "Check the kitchen for a lamp. If so, …": a request to look for a thing has no yes or no."""
    met = 0
    for scene, _, _, programs in sampled:
        for program in programs:
            text = render(program, 0, instruction_id(scene.family, scene.scene_id, program)).lower()
            assert not re.search(r"check [^.:;]*? for an? [^.:;]*[.:;] if (?:so|not),", text), text
            met += "if so," in text
    assert met > 100


@pytest.mark.parametrize("code", LANGUAGES)
def test_one_condition_has_one_relation_word(sampled, code: str) -> None:
    """ "If there's no rug by the sofa … If there's a rug next to the sofa" sounds like two questions."""
    near = "|".join(map(re.escape, language(code).predicates["near"]))
    met = 0
    for scene, _, _, programs in sampled:
        for program in (p for p in programs if p.category == "nested_chain"):
            qualifier = program.conditions[0].qualifier
            if qualifier is None or qualifier.predicate != "near":
                continue
            words = language(code)
            text = words.expanded(
                render(program, 0, instruction_id(scene.family, scene.scene_id, program), code).lower()
            )
            anchor = re.escape(words.definite(words.nouns[qualifier.anchor_labels[0]]).lower())
            label = re.escape(words.nouns[program.conditions[0].label].text.lower())
            said = re.findall(rf"\b{label}\b[^,.:;?]*?\b({near}) {anchor}\b", text)
            met += len(said) >= 2
            assert len(set(said)) <= 1, text
    assert met


@pytest.mark.parametrize("code", LANGUAGES)
def test_no_noun_swallows_what_follows_a_shorter_one(code: str) -> None:
    """ "Armario bajo" (base cabinet) and "armario" with "bajo el televisor" (under the television) read alike."""
    words = language(code)
    after = [text for slot in ("in", "of", "there", "with", "then", "second", "last") for text in words.slots[slot]]
    after += [text for phrases in words.predicates.values() for text in phrases]
    for nouns in (words.nouns, words.rooms):
        texts = [noun.text for noun in nouns.values()]
        for short, long in product(texts, texts):
            if long.startswith(f"{short} "):
                taken = [x for x in after if f"{short} {x.strip(', ')} ".startswith(f"{long} ")]
                assert not taken, (short, long, taken)
