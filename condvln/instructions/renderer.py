"""Choose the words of one text, phrase by phrase from left to right, from a voice and a template of the language."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Final, Literal

from condvln.instructions.language import Form, Language, Noun, Slot, Template, Voice, sentences
from condvln.instructions.template_choice import Naming, TemplateChoice, labels_of
from condvln.instructions.text_reading import Mention, within_reach
from condvln.seeding import Draws
from schemas.program import (
    BEARINGS,
    SUPERLATIVES,
    Category,
    Condition,
    ObjectRef,
    Predicate,
    Program,
    Qualifier,
    RoomRef,
)

__all__ = ["Renderer"]

LOOK_AT_SHARE: Final = 0.5
"""Share of requests about a definite object that say "find the lamp. If it's near the bed, …"."""
CHECK_SHARE: Final = 0.4
"""Share of requests to look for something that name the room first ("check the kitchen for a lamp")."""
LOOK_SHARE: Final = 0.4
"""Share of the other requests about an indefinite object that say "look for", not "see if there is"."""
RESTATE_SHARE: Final = 0.5
"""Share of answers before another claim that repeat the noun: "if there's a lamp and also a bed", not "if there is one
and there's also a bed"."""
ONCE_SHARE: Final = 0.4
"""Share of leads at the beginning of a request that say "once you're in the kitchen, look for a lamp"."""
HAS_SHARE: Final = 0.35
"""Share of texts that say "the kitchen has a lamp", not "there's a lamp in the kitchen"."""
COMPOUND_SHARE: Final = 0.6
"""Share of texts that say "the kitchen sink", not "the sink in the kitchen"."""
_JOINED: Final = ("joined", "not_joined")
"""Forms of a condition behind another one, after "and" or "but"."""
_PREPOSITIONS: Final = {"": "in", "_of": "of", "_anchor": "of_anchor"}
"""Slot of the preposition before a room: of what is there, of what belongs there, behind the anchor of a stop."""


@dataclass(slots=True)
class Heard:
    """What a listener has heard of a text so far. The next phrase depends on it."""

    room: str | None = None
    """id of the room that was named last, which "there" means"""
    room_asked: str | None = None
    """id of the room of the last question; a definite object in it needs no room"""
    asked: set[int] = field(default_factory=set)
    """conditions that were named"""
    asked_by: Literal["", "exists", "look"] = ""
    """whether the last question was "there is …" or "look for …", so that "there is" or "you find one" answers it"""
    looked_at: int | None = None
    """condition whose object one was told to find, so that "it's …" answers it"""
    answer: tuple[str, int] = "", 0
    """the last short answer, and how many requests came before it"""
    denied: int | None = None
    """condition that was denied last: "if so" would agree with the denial"""
    denied_behind: tuple[int, str] = -1, ""
    """condition that was denied behind a short answer, and this answer"""
    requests: int = 0
    """number of requests such as "see if …" """
    request: str = ""
    """how the last request began, "look" or "look_at" """
    beside: bool = False
    """whether the condition that is being worded is in the room of the last question"""
    existential: bool | None = None
    """whether the last clause said that something is there or that it is not; None if it said neither"""
    clause_room: str | None = None
    """id of the room of the last clause"""
    also: str | None = None
    """slot of a claim behind another one, such as "there's also …" """
    gapped: bool = False
    """whether the last clause left out the words that it shares with the one before"""
    there: bool = False
    """whether the last stop said "there" """


class Renderer:
    """Renders one text from left to right; each chosen phrase is kept for the rest of the text.

    short : of phrases with the same meaning, use one with the fewest words
    """

    def __init__(self, words: Language, voice: Voice, draws: Draws, *, short: bool = False) -> None:
        self.words, self.voice, self.draws, self.short = words, voice, draws, short
        self.naming = Naming()
        self.scope: RoomRef | None = None
        self._leads: dict[int, RoomRef] = {}
        self._led_to: frozenset[int] = frozenset()  # conditions in whose room one is by a lead
        self._inside: str | None = None  # the room of the condition that is being worded, if one is there by a lead
        self.heard = Heard()
        self._chosen: dict[str, str] = {}
        self._turns: dict[str, int] = {}
        self._relations: dict[Predicate, str] = {}
        self._bearing: int | None = None
        self._has: bool | None = None
        self._introduced: dict[str, Mention] = {}
        self._room_of: dict[str, str] = {}
        self._found: set[str] = set()
        self._template = Template((), frozenset())
        self._category: Category = "simple"
        self._here = Mention(Slot("leaf", 0), 0)
        self._joined_next: Form | None = None
        self._compounds = False

    def program(self, program: Program) -> str:
        naming = self.naming = Naming.of(program)
        self._category = program.category
        self._compounds = bool(self.words.compounds[0]) and self._chance(COMPOUND_SHARE)
        self._leads = {branch.condition: branch.lead for branch in program.branches if branch.lead is not None}
        self._led_to = frozenset(k for k, lead in enumerate(program.last_leads) if lead is not None)
        opening = "" if 0 in self._leads else self._scope(naming.rooms)
        templates = self._templates(program)
        scoped = bool(opening) or (0 in self._leads and len(naming.rooms) == 1)
        choice = TemplateChoice(program, naming, self.words, scoped=scoped)
        self._template = self.draws.choice(templates) if self.short else choice.draw(templates, self.draws)
        if 0 in self._leads and self._template.stated[0] != "see":
            self._here = Mention(Slot("see", 0), 0)
            opening = f"{self._in_turn('go', self._usable('go'))} {self._led(0)}. "
        body = self._filled_in(self._template, program).replace(" , ", ", ")
        return sentences(self.words, f"{opening}{body[:1].lower()}{body[1:]}" if opening else body)

    def _templates(self, program: Program) -> Sequence[Template]:
        """Return the templates of this text's voice that have a place for the program's leads; of all voices if the
        voice has none.
        """
        own = (self.voice.short_templates if self.short else self.voice.templates)[program.category]
        led = [k in self._leads for k in range(len(program.conditions))]
        fit = [template for template in own if template.allows(led)]
        if all(template.is_choosy for template in fit):
            others = self.words.templates[program.category]
            fit += [template for template in others if template.allows(led) and not template.is_choosy]
        return fit

    def _led(self, index: int) -> str:
        """Return the room of the lead to a condition, which then does not name it, as a text with no other room."""
        lead = self._leads.pop(index)
        said = self._room(lead)
        self._inside = lead.room_id
        self.scope = lead if len(self.naming.rooms) == 1 else None
        return said

    def _lead(self, index: int) -> str:
        """Return the words of a lead before a request to look: "go to the kitchen and ", "once you're in the kitchen,";
        empty if the condition has no lead.
        """
        if index not in self._leads:
            return ""
        if isinstance(self._template.pieces[0], Slot) and not index and self._chance(ONCE_SHARE):
            return f"{self._phrase('once')} {self._led(index)}, "
        go = self._in_turn("go", self._usable("go"))
        return f"{go} {self._led(index)} {self.words.connectives['and'][0]} "

    def _filled_in(self, template: Template, program: Program) -> str:
        texts: list[str] = []
        ends = (*template.pieces, "", "")
        for k, piece in enumerate(template.pieces):
            if isinstance(piece, str):
                texts.append(piece)
                continue
            after = ends[k + 2]
            self._joined_next = after.form if isinstance(after, Slot) and after.form in _JOINED else None
            self.heard.gapped = False
            self._here = Mention(piece, template.steps[k])
            said = self._slot(piece, program)
            self._inside = None
            if self.heard.gapped:
                texts[-1] = texts[-1].removeprefix(",")  # "if there's a lamp but no bed"
            texts.append(said)
        return "".join(texts)

    def _phrase(self, slot: str) -> str:
        """Return the phrase that this text uses for a slot."""
        found = self._chosen.get(slot)
        if found is None:
            found = self._chosen[slot] = self._choice(self.voice.slots[slot])
        return found

    def _choice(self, phrases: tuple[str, ...]) -> str:
        phrases = _shortest(phrases) if self.short else phrases
        return self.draws.choice(phrases) if len(phrases) > 1 else phrases[0]

    def _usable(self, slot: str) -> tuple[str, ...]:
        """Return the phrases of a slot; of a short text, those with the fewest words."""
        return _shortest(self.voice.slots[slot]) if self.short else self.voice.slots[slot]

    def _chance(self, share: float) -> bool:
        return self.draws.uniform() < share

    def _scope(self, rooms: Sequence[RoomRef]) -> str:
        """Return the words that place the whole text in one room, which then need not be named again; empty if there
        are several rooms or the room has no name.
        """
        room = rooms[0]
        if len(rooms) > 1 or room.label not in self.words.rooms:
            return ""
        text = f"{self._phrase('scope')} {self._room(room)}, "
        self.scope = room
        return text

    def _elided(self, room: RoomRef) -> bool:
        """Return whether nouns are said without their room. This is so if `room` has no name, if the whole text is
        about one room, or if a lead has sent one there.
        """
        return self.scope is not None or room.room_id == self._inside or room.label not in self.words.rooms

    def _slot(self, slot: Slot, program: Program) -> str:
        if slot.form == "leaf":
            leaf, room = program.leaves[slot.index], self.heard.room
            said = self.moves(leaf.moves, bare=slot.bare)
            self.heard.answer, self.heard.clause_room = ("", 0), None
            if any(move.is_bearing or move.room.room_id != room for move in leaf.moves):
                # "there" would not be understood as a room of another branch, though that one was named last; nor is
                # the next question about the room of the question before these stops.
                self.heard.room = self.heard.room_asked = None
            return said
        condition = program.conditions[slot.index]
        form: str = slot.form
        if form == "neither":
            self.heard.answer, self.heard.room_asked, self.heard.room = ("", 0), None, None
            other = program.conditions[slot.other]
            return f"{self._filled('neither_a', condition)} {self._filled('nor_a', other)}"
        if form in ("yes", "no") and slot.index == self.heard.looked_at:
            self.heard.looked_at, self.heard.answer = None, ("", 0)
            self.heard.denied = None if form == "yes" else slot.index
            return f"{self._phrase('it_is' if form == 'yes' else 'it_is_not')}{self._relation(condition)}"
        if form == "yes" and self._is_doubtful(condition, slot.index):
            form = "again"
        restatable = form == "yes" and self._joined_next and not self.short and self.naming.has_article(condition)
        if restatable and self._chance(RESTATE_SHARE):
            # "If there's a lamp and also a bed, …": other words came after the question.
            said = self._again(condition, asserted=True)
            self.heard.answer, self.heard.also = (said, self.heard.requests), "also_a"
            return said
        if form in ("yes", "no"):
            answer = self.words.answered(self._answer(form, condition, slot.index), self._noun(condition))
            if (answer, self.heard.requests - 1) != self.heard.answer:
                self.heard.answer = answer, self.heard.requests
                self.heard.existential, self.heard.clause_room = None, None
                self.heard.also = "there_also" if form == "yes" and not condition.definite else None
                return answer
            # "If it is, see if … If it is, …": the second could be confused with the first.
            form = "again" if form == "yes" else "not_again"
        asserted = form in ("asserted", "joined", "again")
        if form in ("denied", "not_joined", "not_again"):
            self.heard.denied = slot.index
            self.heard.denied_behind = (slot.index if self.heard.answer[0] else -1, self.heard.answer[0])
        again = slot.index in self.heard.asked
        self.heard.asked.add(slot.index)
        if not again and slot.index in self._led_to - self._leads.keys() and not self.naming.is_shared(condition):
            self._inside = condition.room.room_id
        self.heard.beside = not again and self._is_in_room_asked(condition)
        joined = form in _JOINED
        # "If there's a bed in the bedroom and a bath in the bathroom, find the lamp": in which room?
        is_second_room = joined and self.heard.room_asked != condition.room.room_id
        self.heard.room_asked = None if is_second_room else condition.room.room_id
        if again and not self.naming.is_shared(condition):
            # "But if there's no bowl, …" is enough where one bowl was asked about.
            full = condition.qualifier is not None or condition.label in self.naming.asked_once
            full = full and not (self._elided(condition.room) and condition.label not in self.naming.asked_only)
            if full or form in ("again", "not_again"):
                self.heard.room_asked = None
                return self._again(condition, asserted=asserted, joined=joined)
        if form == "question":
            return self._question(condition)
        if form == "see":
            return f"{self._lead(slot.index)}{self._see(condition, slot.index)}"
        return self._clause(condition, asserted=asserted, joined=joined)

    def _is_doubtful(self, condition: Condition, index: int) -> bool:
        """Return whether the answer "there is one" or "it is" could mean either of two things that were named together:
        "if there is one but no rug, …; if there is one, …".
        """
        denied, answer_before = self.heard.denied_behind
        return index == denied and (not condition.definite or answer_before in self.voice.slots["yes_it"])

    def _is_in_room_asked(self, condition: Condition) -> bool:
        """Return whether a condition is about a definite object ("the lamp") in the room of the last question. This
        room then need not be named again.
        """
        beside = condition.definite and self.heard.room_asked == condition.room.room_id
        return beside and not self.naming.is_shared(condition)

    def _answer(self, form: str, condition: Condition, index: int) -> str:
        """Return the short answer that stands for a condition, such as "there is" or "it isn't". An answer that repeats
        "there is" is used only after a question with these words, and "you find one" after "look for" only. An answer
        that would agree with a denial is not used after one.
        """
        slot = f"{form}_{'it' if condition.definite else 'one'}"
        phrases = self.voice.slots[slot]
        if len(phrases) == 1:
            return phrases[0]
        if self._joined_next and self.voice.slots["also"]:
            return phrases[0]  # "if there is one but no lamp", not "if there is but no lamp"
        if self.heard.asked_by != "exists" and not condition.definite:
            phrases = tuple(phrase for phrase in phrases if phrase not in self.words.elliptic)
        if self.words.found and not condition.definite:
            sought = self.heard.asked_by == "look"
            phrases = tuple(phrase for phrase in phrases if (phrase in self.words.found) == sought) or phrases
        if self.heard.denied == index:
            phrases = tuple(phrase for phrase in phrases if phrase not in self.words.connectives["so"])
        phrases = _shortest(phrases) if self.short else phrases
        before = self.heard.answer[0]
        if before and len(phrases) > 1:
            phrases = tuple(
                phrase for phrase in phrases if self.words.answered(phrase, self._noun(condition)) != before
            )
        return self._in_turn(slot, phrases)

    def _in_turn(self, slot: str, phrases: tuple[str, ...]) -> str:
        """Return the next of the `phrases` of a slot. The first phrase that a text uses is drawn at random; afterwards
        the phrases follow in their order.
        """
        if slot not in self._turns:
            self._turns[slot] = self.draws.index(len(phrases)) if len(phrases) > 1 else 0
        self._turns[slot] += 1
        return phrases[(self._turns[slot] - 1) % len(phrases)]

    # -- conditions ----------------------------------------------------------------------------------------------------

    def _clause(self, condition: Condition, *, asserted: bool, joined: bool = False) -> str:
        """Return a condition as a clause, asserted or denied.

        joined : whether the clause is behind another one, so that words which both have may be left out
        """
        gapped = joined and self._may_be_gapped(condition, asserted)
        too, self.heard.also = self.heard.also if joined and asserted else None, None
        beside = joined and self.heard.clause_room == condition.room.room_id and bool(self.voice.slots["same_place"])
        # "Si en la cocina hay un plato y en el dormitorio hay una cama": the room comes first.
        room_first = self._names_room_first(condition)
        gapped = gapped and (beside or not room_first or self._elided(condition.room))
        self.heard.existential = None if condition.definite else asserted
        self.heard.clause_room = condition.room.room_id
        if condition.definite:
            verb = self._phrase("is" if asserted else "is_not")
            if self._is_set_apart(condition.room) and not self.heard.beside:
                # "The lamp in the bedroom that has the desk is near …" sounds as if the desk were.
                place = f", {self._phrase('in')} {self._room(condition.room)}, "
                said = f"{place}{self.words.definite(self._noun(condition))} {verb}{self._relation(condition)}"
                self._know(condition)
                return said
            said = f"{self._subject(condition)} {verb}{self._relation(condition)}"
            self._know(condition)
            return said
        self.heard.asked_by = "exists"
        self._know(condition)
        if too is None and not gapped and not beside and self._says_has(condition):
            self.heard.existential, self.heard.asked_by = None, ""
            said = f"{self._room(condition.room)} {self._filled('has' if asserted else 'has_no', condition)}"
            return f"{said}{self._relation(condition)}"
        if too is not None:
            there = self._filled(too, condition)
        else:
            there = self._there_is(condition, asserted=asserted, gapped=gapped)
        if beside and not self._elided(condition.room):
            return f"{there}{self._relation(condition)} {self._phrase('same_place')}"
        if room_first and not self._elided(condition.room):
            return f"{self._phrase('in')} {self._room(condition.room)} {there}{self._relation(condition)}"
        return f"{there}{self._relation(condition)}{self._where(condition.room, named=True)}"

    def _may_be_gapped(self, condition: Condition, asserted: bool) -> bool:
        """Return whether a claim behind another one may leave out "there's", as in "there's a lamp and a bed"."""
        return not condition.definite and self.heard.existential in ((True,) if asserted else (True, False))

    def _names_room_first(self, condition: Condition) -> bool:
        """Return whether a claim begins with its room, as in "en la cocina hay una lámpara"."""
        if self.words.room_first and condition.qualifier is None and condition.room.anchor_label is None:
            return not self._prefers_has()
        return self.words.room_first

    def _says_has(self, condition: Condition) -> bool:
        """Return whether a claim is worded as "the kitchen has a lamp"."""
        if not self.voice.slots["has"] or condition.room.anchor_label is not None or self._elided(condition.room):
            return False
        return self._prefers_has()

    def _prefers_has(self) -> bool:
        """Return whether this text says "the kitchen has a lamp", or in Spanish "hay una lámpara en la cocina"."""
        if self._has is None:
            self._has = self._chance(HAS_SHARE)
        return self._has

    def _there_is(self, condition: Condition, *, asserted: bool, gapped: bool, kind: str = "") -> str:
        """Return "there's a lamp", or "a lamp" (`gapped`) behind another clause with "there's"."""
        slot = "also" if asserted else "nor"
        if gapped and self.voice.slots[slot]:
            self.heard.gapped = True
            return self._filled(slot, condition)
        return self._filled(f"{'exists' if asserted else 'absent'}{kind}", condition)

    def _again(self, condition: Condition, *, asserted: bool, joined: bool = False) -> str:
        """Return the words that repeat an earlier condition, without its room. The next stop then does not use "there",
        since other rooms were named in between.
        """
        self.heard.room, self.heard.asked_by = None, "exists"
        gapped = joined and self._may_be_gapped(condition, asserted)
        self.heard.existential, self.heard.clause_room = None if condition.definite else asserted, None
        if condition.definite:
            verb = self._phrase("is" if asserted else "is_not")
            return f"{self.words.definite(self._noun(condition))} {verb}{self._relation(condition)}"
        relation = "" if condition.label in self.naming.asked_only else self._relation(condition)
        kind = "" if asserted or relation else "_again"
        there = self._there_is(condition, asserted=asserted, gapped=gapped, kind=kind)
        return f"{there}{relation}"

    def _question(self, condition: Condition) -> str:
        self._know(condition)
        if condition.definite:
            return f"{self._phrase('asks_is')} {self._subject(condition)}{self._relation(condition)}?"
        self.heard.asked_by = "exists"
        where = self._where(condition.room, named=True)
        return f"{self._filled('is_there', condition)}{self._relation(condition)}{where}?"

    def _see(self, condition: Condition, index: int) -> str:
        self.heard.requests += 1
        # Two requests in a row that begin with "look for" or "find" sound like a machine.
        before, self.heard.request = self.heard.request, ""
        if condition.definite:
            # "If it is, find the plant": not "if it is, see if the plant …", with "it is" again as the answer.
            again = len(self.voice.slots["yes_it"]) == 1 and self.heard.answer[0] in self.voice.slots["yes_it"]
            again = again and self._template.answered.get(index) == "yes"
            sayable = index in self._template.answered and not self._is_set_apart(condition.room)
            if sayable and (again or (before != "look_at" and self._chance(LOOK_AT_SHARE))):
                self.heard.looked_at, self.heard.request = index, "look_at"
                subject = self._subject(condition)
                self._know(condition)
                return f"{self._phrase('look_at')} {subject}"
            return f"{self._request()} {self._clause(condition, asserted=True)}"
        if index in self._template.whether:
            return f"{self._request()} {self._clause(condition, asserted=True)}"
        plain = condition.qualifier is None and condition.room.anchor_label is None
        plain = plain and not self.words.room_first and not self._elided(condition.room)
        if plain and self._chance(CHECK_SHARE):
            self.heard.asked_by = ""
            return f"{self._phrase('check')} {self._room(condition.room)} {self._filled('for', condition)}"
        sayable = before != "look" and not (self.words.found and self.heard.answer[0])
        if sayable and self._chance(LOOK_SHARE):
            self.heard.asked_by = self.heard.request = "look"
            self._know(condition)
            where = self._where(condition.room, named=True)
            return f"{self._filled('look', condition)}{self._relation(condition)}{where}"
        return f"{self._request()} {self._clause(condition, asserted=True)}"

    def _request(self) -> str:
        """Return the phrase of the next request, such as "see if" or "check whether"."""
        return self._in_turn("see", self._usable("see"))

    def _know(self, named: Condition | ObjectRef) -> None:
        """Record that the text has now named the objects of a phrase with their room, so that it can later name them
        without the room.
        """
        if self._elided(named.room) or self.naming.is_shared(named):
            return
        if isinstance(named, ObjectRef) or named.definite:
            self._room_of[named.label] = named.room.room_id
            self._found.add(named.label)
        for label in named.qualifier.anchor_labels if named.qualifier is not None else ():
            self._room_of[label] = named.room.room_id

    def _noun(self, named: Condition | ObjectRef) -> Noun:
        return self.words.noun(named.label, named.room.label)

    def _filled(self, slot: str, condition: Condition) -> str:
        return self.words.filled(self._phrase(slot), self._noun(condition))

    def _compound(self, named: Condition | ObjectRef) -> str | None:
        """Return a compound like "the kitchen sink" for an object; None if this text does not use compounds, or the
        compound of this object would be unusual or unclear.
        """
        labels, rooms = self.words.compounds
        if not self._compounds or named.label not in labels or named.room.label not in rooms:
            return None
        room, noun = self.words.rooms[named.room.label], self._noun(named)
        if named.room.anchor_label is not None or f"{room.text} {noun.text}" in self.words.noun_texts:
            return None
        self.heard.room = named.room.room_id
        return self.words.compound(noun, room)

    def _subject(self, condition: Condition) -> str:
        compound = None if self.heard.beside or self._elided(condition.room) else self._compound(condition)
        if compound is not None:
            return compound
        where = "" if self.heard.beside else self._where(condition.room, "_of", named=True)
        return f"{self.words.definite(self._noun(condition))}{where}"

    def _relation(self, named: Condition | ObjectRef) -> str:
        qualifier: Qualifier | None = named.qualifier
        if qualifier is None:
            return ""
        if qualifier.predicate in SUPERLATIVES:
            return ""
        if qualifier.predicate in BEARINGS:
            return f" {self._at_start(qualifier.predicate, isinstance(named, ObjectRef))}"
        relation = self._relations.get(qualifier.predicate)
        if relation is None:
            phrases = self.words.predicates[qualifier.predicate]
            relation = phrases[0] if len(phrases) == 1 else self._choice(phrases)
            self._relations[qualifier.predicate] = relation
        anchors = [self.words.definite(self.words.noun(label, named.room.label)) for label in qualifier.anchor_labels]
        relation = self.words.agreeing(relation, self._noun(named))
        return f" {relation} {f' {self.words.both} '.join(anchors)}"

    def _at_start(self, bearing: Predicate, of_stop: bool) -> str:
        """Return the phrase of an egocentric direction, such as "on your left as you start". A text uses the same form
        throughout.
        """
        phrases = (self.words.bearing_stops if of_stop else self.words.bearings)[bearing]
        if self._bearing is None:
            self._bearing = self.draws.index(len(phrases))
        return phrases[self._bearing]

    # -- places --------------------------------------------------------------------------------------------------------

    def moves(self, stops: Sequence[RoomRef | ObjectRef], *, bare: bool = False) -> str:
        """Return the stops of one leaf as one imperative; with `bare` without its verb, as in "to the lamp"."""
        self.heard.there = False
        verb = self._phrase("to") if bare else self._in_turn("go", self._usable("go"))
        texts = [f"{verb} {self._stop(stops[0])}"]
        for k, (before, stop) in enumerate(pairwise(stops), start=1):
            joint = "second" if len(stops) == 2 else "last" if k == len(stops) - 1 else "then"
            # After a stop with an egocentric direction, or one that is known from before, no room was named.
            same_room = isinstance(stop, ObjectRef) and not self.naming.is_shared(stop)
            same_room = same_room and _room_of(stop).room_id == _room_of(before).room_id == self.heard.room
            texts.append(f"{self._phrase(joint)} {self._stop(stop, behind=True, same_room=same_room)}")
        return "".join(texts)

    def _stop(self, ref: RoomRef | ObjectRef, *, behind: bool = False, same_room: bool = False) -> str:
        """Return the words for a stop; its room is left out if the stop before it is in the same room.

        behind : whether it comes after another stop
        """
        if isinstance(ref, RoomRef):
            return self._room(ref)
        named = self._noun(ref)
        noun, kind, own_room = self.words.definite(named), "_of", False
        if ref.qualifier is not None and ref.qualifier.predicate in SUPERLATIVES:
            noun = self.words.compared(ref.qualifier.predicate, named)
        elif ref.qualifier is not None:
            # After a relation no "there"; "of the bedroom" goes with the anchor, which is in the same room.
            kind = "_anchor"
            # "La planta del salón que está cerca del sofá".
            own_room = self.words.room_first and not self._is_set_apart(ref.room)
        relation = self._relation(ref)
        if ref.is_bearing:
            # It is in the room of the start, which is not named; "there" would refer to that room next.
            self.heard.room = None
            return f"{noun}{relation}"
        if relation and self.words.lying and ref.qualifier and ref.qualifier.predicate not in self.words.unlinked:
            relation = f" {self.words.lying}{relation}"
        elided, known = self._elided(ref.room), not behind and self._is_known(ref)
        if same_room:
            there = " " + self._phrase("there") if self.voice.slots["there"] and not elided and kind == "_of" else ""
            # "the sink there and then to the toilet there" says it twice
            there, self.heard.there = "" if self.heard.there else there, bool(there)
            return f"{noun}{relation}{there}"
        if known:
            self.heard.room = None
            return f"{noun}{relation}"
        if ref.qualifier is None and not elided and ref.room.room_id != self.heard.room:
            noun_and_room = self._compound(ref)
            if noun_and_room is not None:
                return noun_and_room
        if own_room:
            return f"{noun}{self._where(ref.room, '_of')}{relation}"
        return f"{noun}{relation}{self._where(ref.room, kind)}"

    def _is_known(self, ref: ObjectRef) -> bool:
        """Return whether a listener already knows the room of a stop, since the text has named the stop's object, or
        all its anchors, with the room.
        """
        if self.naming.is_shared(ref) or (not labels_of(ref)[1:] and ref.label not in self._found):
            return False
        return all(self._room_of.get(label) == ref.room.room_id for label in labels_of(ref)[1:] or labels_of(ref))

    def _where(self, room: RoomRef, kind: str = "", *, named: bool = False) -> str:
        """Return the room as a place ("in the bedroom"); with `kind` "_of" as the owner ("del dormitorio").

        A condition is said with its room: after "the plant near the table", "a chair there" could mean near the table.
        """
        if self._elided(room):
            return ""
        if kind in ("_of", "_anchor") and not named and self.voice.slots["there"] and room.room_id == self.heard.room:
            self.heard.there = True
            return f" {self._phrase('there')}"
        return f" {self._phrase(_PREPOSITIONS[kind])} {self._room(room)}"

    def _is_set_apart(self, room: RoomRef) -> bool:
        """Whether a room has to be named by an object in it, as in "the bedroom with the desk"."""
        return room.anchor_label is not None and not self._is_introduced(room) and not self._elided(room)

    def _is_introduced(self, room: RoomRef) -> bool:
        """Whether "that bedroom" can only mean this room, which was named by an object in it shortly before, on the way
        to the leaf or condition that is being worded.
        """
        named = self._introduced.get(room.room_id)
        return (
            named is not None
            and sum(room.label == other.label for other in self.naming.rooms) == 1
            and within_reach(self._category, named, self._here)
        )

    def _room(self, room: RoomRef) -> str:
        self.heard.room = room.room_id
        noun = self.words.rooms[room.label]
        phrase = self.words.definite(noun)
        if room.anchor_label is None or self._elided(room):
            return phrase
        is_known = self._is_introduced(room)
        self._introduced[room.room_id] = self._here
        if is_known:
            return self.words.that(noun)
        return f"{phrase} {self._phrase('with')} {self.words.definite(self.words.noun(room.anchor_label, room.label))}"


def _room_of(stop: RoomRef | ObjectRef) -> RoomRef:
    return stop if isinstance(stop, RoomRef) else stop.room


@lru_cache
def _shortest(phrases: tuple[str, ...]) -> tuple[str, ...]:
    """Return the phrases with the fewest words."""
    least = min(phrase.count(" ") for phrase in phrases)
    return tuple(phrase for phrase in phrases if phrase.count(" ") == least)
