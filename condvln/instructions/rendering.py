"""Render a program as text. All wording comes from the language's data; choices are seeded by the instruction's id.

A text uses one voice and one phrase for each slot, so that it sounds like one person. An object that is the only one of
its label in its room is definite ("if the bike is near the sofa"). A room that is named by an object in it ("the
bedroom with the desk") is named in short from then on, and a stop in the room named last is "there", in the same clause
or in the one after the condition that named it. A condition always names its room, unless it is repeated. If everything
is in one named room, the text names it once, at the beginning.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from functools import lru_cache
from itertools import accumulate
from typing import Final

from condvln.instructions.language import Language, Noun, Slot, Template, Voice, language
from condvln.instructions.predicates import COMPASS
from condvln.seeding import Draws, generator, stable_hash
from schemas.config import WordingConfig
from schemas.config.constants import HEADING_TOLERANCE
from schemas.errors import UsageError
from schemas.program import BEARINGS, SUPERLATIVES, Condition, Leaf, ObjectRef, Predicate, Program, Qualifier, RoomRef

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

LONGEST_SENTENCE: Final = 25
"""Number of words above which a sentence is split at its colon or semicolon."""
CHECK_SHARE: Final = 0.6
"""Share of requests to look for something that name the room first ("check the kitchen for a lamp")."""


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


@lru_cache
def _wording(wording: WordingConfig | str) -> WordingConfig:
    return WordingConfig.model_validate({"language": wording}) if isinstance(wording, str) else wording


def preamble(heading_degrees: float, voice: Voice, code: str = "en") -> str:
    """Return the sentence that states the start heading ("You're facing north-east.") in the words of a voice."""
    words = language(code)
    return _sentences(words, f"{voice.slots['facing'][0]} {words.directions[heading_name(heading_degrees)]}.")


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
    draws = Draws(generator(seed, "text", instruction_id, code))
    return _Renderer(words, voice, draws, short=said.length == "short").program(program)


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
    moves: tuple[ObjectRef, ...], seed: int, instruction_id: str, wording: WordingConfig | str = "en"
) -> str:
    """Return a sequence of moves as one sentence: the text of an oracle-linear twin."""
    code = _wording(wording).language
    words = language(code)
    draws = Draws(generator(seed, "text", instruction_id, code))
    short = _wording(wording).length == "short"
    renderer = _Renderer(words, voice_of(seed, instruction_id, wording), draws, short=short)
    return _sentences(words, f"{renderer.moves(Leaf(moves=moves))}.")


_PREPOSITIONS: Final = {"": "in", "_of": "of", "_anchor": "of_anchor"}
"""Slot of the preposition before a room: of what is there, of what belongs there, behind the anchor of a stop."""


class _Renderer:
    """Renders one text from left to right; each chosen phrase is kept for the rest of the text.

    short : of phrases with the same meaning, use one with the fewest words
    """

    def __init__(self, words: Language, voice: Voice, draws: Draws, *, short: bool = False) -> None:
        self.words, self.voice, self.draws, self.short = words, voice, draws, short
        self.scope: RoomRef | None = None
        self.last_room: RoomRef | None = None
        self._chosen: dict[str, str] = {}
        self._relations: dict[Predicate, str] = {}
        self._asked: set[int] = set()
        self._room_asked: str | None = None
        self._is_beside = False
        self._answered = ""
        self._requests = 0
        self._is_room_first = False
        self._shared: set[str] = set()
        self._asked_by_exists = False
        self._types: Counter[str] = Counter()
        self._introduced: set[RoomRef] = set()
        self._bearing: int | None = None
        self._whether: frozenset[int] = frozenset()

    def program(self, program: Program) -> str:
        rooms = _rooms(program)
        self._types = Counter(room.label for room in rooms)
        if len(rooms) > 1:
            self._shared = _shared(program)
        opening = self._scope(rooms)
        templates = (self.voice.short_templates if self.short else self.voice.templates)[program.category]
        template = self.draws.choice(_sayable(templates, program) if not self.short else templates)
        self._whether = template.whether
        texts = [piece if isinstance(piece, str) else self._slot(piece, program) for piece in template.pieces]
        body = "".join(texts)
        if self._is_room_first:
            body = body.replace(" , ", ", ")
        return _sentences(self.words, f"{opening}{body[:1].lower()}{body[1:]}" if opening else body)

    def _phrase(self, slot: str) -> str:
        """Return the phrase that this text uses for a slot."""
        found = self._chosen.get(slot)
        if found is None:
            found = self._chosen[slot] = self._choice(self.voice.slots[slot])
        return found

    def _choice(self, phrases: tuple[str, ...]) -> str:
        phrases = _shortest(phrases) if self.short else phrases
        return self.draws.choice(phrases) if len(phrases) > 1 else phrases[0]

    def _chance(self, share: float) -> bool:
        return self.draws.uniform() < share

    def _scope(self, rooms: set[RoomRef]) -> str:
        """Return the words that place the whole text in one room, which then need not be named again; empty if there
        are several rooms or the room has no name.
        """
        room = next(iter(rooms))
        if len(rooms) > 1 or room.label not in self.words.rooms:
            return ""
        text = f"{self._phrase('scope')} {self._room(room)}, "
        self.scope = room
        return text

    def _elided(self, room: RoomRef) -> bool:
        """Return whether nouns are said without their room. This is so if `room` has no name, or if the whole text is
        about one room.
        """
        return self.scope is not None or room.label not in self.words.rooms

    def _slot(self, slot: Slot, program: Program) -> str:
        if slot.form == "leaf":
            before = set(self._introduced)
            said = self.moves(program.leaves[slot.index])
            self._answered = ""
            # "there" would not be understood as a room of another branch, though that one was named last.
            self.last_room, self._introduced = None, before
            return said
        condition = program.conditions[slot.index]
        form = slot.form
        if form in ("yes", "no"):
            answer = self.words.answered(self._answer(form, condition), self._noun(condition))
            if answer != self._answered:
                self._answered = answer
                return answer
            # "If it is, see if … If it is, …": the second could be confused with the first.
            form = "again" if form == "yes" else "not_again"
        asserted = form in ("asserted", "again")
        again = slot.index in self._asked
        self._asked.add(slot.index)
        self._is_beside = not again and self._is_in_room_asked(condition)
        self._room_asked = condition.room.room_id
        if again and not self._is_shared(condition):
            full = condition.qualifier is not None and not self._elided(condition.room)
            if full or form in ("again", "not_again"):
                return self._again(condition, "_again" if slot.form == "again" else "" if asserted else "_not")
        if form == "question":
            return self._question(condition)
        if form == "see":
            return self._see(condition, whether=slot.index in self._whether)
        return self._clause(condition, asserted=asserted)

    def _is_in_room_asked(self, condition: Condition) -> bool:
        """Return whether a condition is about a definite object ("the lamp") in the room of the last question. This
        room then need not be named again.
        """
        beside = condition.definite and self._room_asked == condition.room.room_id
        return beside and not self._is_shared(condition)

    def _is_shared(self, named: Condition | ObjectRef) -> bool:
        """Return whether the text also names objects with one of the labels of `named` in another room, so that the
        room must be named.
        """
        return bool(self._shared) and not self._shared.isdisjoint(_labels(named))

    def _answer(self, form: str, condition: Condition) -> str:
        """Return the short answer that stands for a condition, such as "there is" or "it isn't". An answer that repeats
        "there is" is used only after a question with these words.
        """
        slot = f"{form}_{'it' if condition.definite else 'one'}"
        answer = self._phrase(slot)
        if answer in self.words.elliptic and not self._asked_by_exists:
            answer = next(phrase for phrase in self.voice.slots[slot] if phrase not in self.words.elliptic)
        return answer

    # -- conditions ----------------------------------------------------------------------------------------------------

    def _clause(self, condition: Condition, *, asserted: bool) -> str:
        if condition.definite:
            verb = self._phrase("is" if asserted else "is_not")
            if self._is_set_apart(condition.room) and not self._is_beside:
                # "The lamp in the bedroom that has the desk is near …" sounds as if the desk were.
                self._is_room_first = True
                place = f", {self._phrase('in')} {self._room(condition.room)}, "
                return f"{place}{self.words.definite(self._noun(condition))} {verb}{self._relation(condition)}"
            return f"{self._subject(condition)} {verb}{self._relation(condition)}"
        self._asked_by_exists = True
        there = self._filled("exists" if asserted else "absent", condition)
        if self.words.room_first and not self._elided(condition.room):
            return f"{self._phrase('in')} {self._room(condition.room)} {there}{self._relation(condition)}"
        return f"{there}{self._relation(condition)}{self._where(condition.room, named=True)}"

    def _again(self, condition: Condition, kind: str) -> str:
        """Return the words that repeat an earlier condition, without its room. The next stop then does not use "there",
        since other rooms were named in between.

        kind : "" if it holds, "_not" if it doesn't, "_again" if it holds after a leaf for the case that it doesn't
        """
        self.last_room, self._asked_by_exists = None, True
        if condition.definite:
            return (
                f"{self.words.definite(self._noun(condition))} {self._phrase(f'is{kind}')}{self._relation(condition)}"
            )
        return f"{self._filled('absent' if kind == '_not' else f'exists{kind}', condition)}{self._relation(condition)}"

    def _question(self, condition: Condition) -> str:
        if condition.definite:
            return f"{self._phrase('asks_is')} {self._subject(condition)}{self._relation(condition)}?"
        self._asked_by_exists = True
        where = self._where(condition.room, named=True)
        return f"{self._filled('is_there', condition)}{self._relation(condition)}{where}?"

    def _see(self, condition: Condition, *, whether: bool) -> str:
        plain = not condition.definite and condition.qualifier is None and condition.room.anchor_label is None
        plain = plain and not self.words.room_first and not whether
        if not plain or self._elided(condition.room) or not self._chance(CHECK_SHARE):
            return f"{self._request()} {self._clause(condition, asserted=True)}"
        self._asked_by_exists = False
        room = self._room(condition.room)
        return f"{self._phrase('check')} {room} {self._filled('for', condition)}{self._relation(condition)}"

    def _request(self) -> str:
        """Return the phrase of the next request, such as "see if" or "check whether". The phrases of the voice take
        turns.
        """
        phrases = _shortest(self.voice.slots["see"]) if self.short else self.voice.slots["see"]
        first = phrases.index(self._phrase("see"))
        self._requests += 1
        return phrases[(first + self._requests - 1) % len(phrases)]

    def _noun(self, named: Condition | ObjectRef) -> Noun:
        return self.words.noun(named.label, named.room.label)

    def _filled(self, slot: str, condition: Condition) -> str:
        return self.words.filled(self._phrase(slot), self._noun(condition))

    def _subject(self, condition: Condition) -> str:
        where = "" if self._is_beside else self._where(condition.room, "_of", named=True)
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
        return f" {relation} {f' {self.words.both} '.join(anchors)}"

    def _lying(self) -> str:
        """Return the words between the noun of a stop and the relation after it, such as "que está". They are the same
        throughout a text.
        """
        found = self._chosen.get("lying")
        if found is None:
            found = self._chosen["lying"] = self._choice(self.words.lying)
        return found

    def _at_start(self, bearing: Predicate, of_stop: bool) -> str:
        """Return the phrase of an egocentric direction, such as "on your left as you start". A text uses the same form
        throughout.
        """
        phrases = (self.words.bearing_stops if of_stop else self.words.bearings)[bearing]
        if self._bearing is None:
            self._bearing = self.draws.index(len(phrases))
        return phrases[self._bearing]

    # -- places --------------------------------------------------------------------------------------------------------

    def moves(self, leaf: Leaf) -> str:
        """Return the stops of one leaf as one imperative."""
        stops = leaf.moves
        texts = [f"{self._phrase('go')} {self._stop(stops[0])}"]
        for k, stop in enumerate(stops[1:], start=1):
            joint = "second" if len(stops) == 2 else "last" if k == len(stops) - 1 else "then"
            # After a stop with an egocentric direction, no room was named.
            same_room = stop.room == stops[k - 1].room and not stops[k - 1].is_bearing and not self._is_shared(stop)
            texts.append(f"{self._phrase(joint)} {self._stop(stop, same_room=same_room)}")
        return "".join(texts)

    def _stop(self, ref: ObjectRef, *, same_room: bool = False) -> str:
        """Return the words for a stop; its room is left out if the stop before it is in the same room."""
        named = self._noun(ref)
        noun, kind = self.words.definite(named), "_of"
        if ref.qualifier is not None and ref.qualifier.predicate in SUPERLATIVES:
            noun = self.words.compared(ref.qualifier.predicate, named)
        elif ref.qualifier is not None:
            # After a relation no "there"; "of the bedroom" goes with the anchor, which is in the same room.
            kind = "_anchor"
        if ref.is_bearing:
            # It is in the room of the start, which is not named; "there" would refer to that room next.
            self.last_room = None
            return f"{noun}{self._relation(ref)}"
        relation = self._relation(ref)
        if relation and self.words.lying:
            relation = f" {self._lying()}{relation}"
        if same_room:
            there = (
                " " + self._phrase("there")
                if self.voice.slots["there"] and not self._elided(ref.room) and kind == "_of"
                else ""
            )
            return f"{noun}{relation}{there}"
        return f"{noun}{relation}{self._where(ref.room, kind)}"

    def _where(self, room: RoomRef, kind: str = "", *, named: bool = False) -> str:
        """Return the room as a place ("in the bedroom"); with `kind` "_of" as the owner ("del dormitorio").

        A condition is said with its room: after "the plant near the table", "a chair there" could mean near the table.
        """
        if self._elided(room):
            return ""
        if kind == "_of" and not named and self.voice.slots["there"] and room == self.last_room:
            return f" {self._phrase('there')}"
        return f" {self._phrase(_PREPOSITIONS[kind])} {self._room(room)}"

    def _is_set_apart(self, room: RoomRef) -> bool:
        """Whether a room has to be named by an object in it, as in "the bedroom with the desk"."""
        known = room.anchor_label is None or (room in self._introduced and self._types[room.label] == 1)
        return not known and not self._elided(room)

    def _room(self, room: RoomRef) -> str:
        self.last_room = room
        noun = self.words.rooms[room.label]
        phrase = self.words.definite(noun)
        if room.anchor_label is None:
            return phrase
        if not self._is_set_apart(room):
            return phrase
        self._introduced.add(room)
        return f"{phrase} {self._phrase('with')} {self.words.definite(self.words.noun(room.anchor_label, room.label))}"


def _labels(named: Condition | ObjectRef) -> tuple[str, ...]:
    """Return the labels of an object and of its anchors."""
    return (named.label, *(named.qualifier.anchor_labels if named.qualifier is not None else ()))


def _shared(program: Program) -> set[str]:
    """The labels that a text names in several rooms."""
    room_of: dict[str, str] = {}
    shared = set()
    named_things: list[Condition | ObjectRef] = [*program.conditions]
    named_things += [move for leaf in program.leaves for move in leaf.moves]
    for named in named_things:
        for label in _labels(named):
            if room_of.setdefault(label, named.room.room_id) != named.room.room_id:
                shared.add(label)
    return shared


def _sayable(templates: tuple[Template, ...], program: Program) -> tuple[Template, ...]:
    """Return the templates without questions like "is the lamp in the bedroom with the desk near the bed?". If no
    template is without them, return all templates.
    """
    long = {k for k, c in enumerate(program.conditions) if c.definite and c.room.anchor_label is not None}
    if not long:
        return templates
    return tuple(template for template in templates if not template.questions & long) or templates


def _rooms(program: Program) -> set[RoomRef]:
    """Return the rooms that a text names."""
    return {c.room for c in program.conditions} | {move.room for leaf in program.leaves for move in leaf.moves}


def _sentences(words: Language, text: str) -> str:
    """Return `text` with words contracted where the language does so, long sentences split, and each sentence
    capitalised.
    """
    text = words.contracted(text)
    if ";" in text or ":" in text:
        text = ". ".join(_split(sentence) for sentence in text.split(". "))
    for mark in (". ", "? "):
        text = mark.join(_capital(part) for part in text.split(mark))
    return text


@lru_cache
def _shortest(phrases: tuple[str, ...]) -> tuple[str, ...]:
    """Return the phrases with the fewest words."""
    least = min(phrase.count(" ") for phrase in phrases)
    return tuple(phrase for phrase in phrases if phrase.count(" ") == least)


def _split(sentence: str) -> str:
    """Return a long sentence split at its colon, then at its semicolons. A numbered list is not split."""
    if sentence.count(" ") >= LONGEST_SENTENCE and "(" not in sentence:
        first, _, rest = sentence.partition(": ")
        sentence = f"{first}. {rest}" if rest else sentence
        if max(part.count(" ") for part in sentence.split(". ")) >= LONGEST_SENTENCE:
            sentence = sentence.replace("; ", ". ")
    return sentence


def _capital(sentence: str) -> str:
    """Return a sentence with its first letter capitalised, also after Spanish's opening mark."""
    at = 1 if sentence.startswith("¿") else 0
    return sentence[:at] + sentence[at : at + 1].upper() + sentence[at + 1 :]
