"""Program → text. All wording comes from the language's data; the choices are seeded by the instruction's id."""

from __future__ import annotations

from collections import Counter
from typing import Final

from condvln.instructions.draws import Draws
from condvln.instructions.language import Language, Slot, language
from condvln.instructions.predicates import COMPASS
from condvln.seeding import generator, stable_hash
from schemas.config.constants import HEADING_TOLERANCE
from schemas.errors import UsageError
from schemas.program import Condition, Leaf, ObjectRef, Program, Qualifier, RoomRef

__all__ = [
    "HEADINGS",
    "heading_name",
    "names_compass",
    "preamble",
    "render",
    "render_moves",
    "with_preamble",
    "word_count",
]

HEADINGS: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
"""Names of the headings 0°, 45°, … clockwise from north."""

SCOPE_SHARE: Final = 0.8
"""Share of texts in one named room that say so once, at the start, rather than at every noun."""
ROOM_FIRST_SHARE: Final = 0.3
"""Share of conditions with a named room that open with it ("if the kitchen has a lamp")."""
SAME_ROOM_SHARE: Final = 0.6
"""Share of stops in the room of the stop before that say "in the same room"."""
SUCH_SHARE: Final = 0.9
"""Share of repeated mentions of a condition that say "such a lamp"."""
ANYWHERE_SHARE: Final = 0.5
"""Share of presence conditions without a room that end in a word like "anywhere"."""


def names_compass(program: Program) -> bool:
    """Whether the text of `program` uses compass words, so that it must open with the start heading."""
    qualifiers = [condition.qualifier for condition in program.conditions]
    qualifiers += [move.qualifier for leaf in program.leaves for move in leaf.moves]
    return any(qualifier is not None and qualifier.predicate in COMPASS for qualifier in qualifiers)


def heading_name(heading_degrees: float) -> str:
    """Name of a compass heading in degrees clockwise from north.

    Raises
    ------
    UsageError
        The heading is no multiple of 45°, so that no sentence could state it exactly.
    """
    steps = heading_degrees / 45.0
    if abs(steps - round(steps)) * 45.0 > HEADING_TOLERANCE:
        raise UsageError(
            f"a heading of {heading_degrees}° has no name", remedy="Take starts at multiples of 45° for such texts."
        )
    return HEADINGS[round(steps) % len(HEADINGS)]


def preamble(heading_degrees: float, choice: int = 0, code: str = "en") -> str:
    """ "You are facing north-east." in one of its phrasings."""
    words = language(code)
    phrases = words.slots["facing"].texts
    direction = words.directions[heading_name(heading_degrees)]
    return _sentences(words, f"{phrases[choice % len(phrases)]} {direction}.")


def with_preamble(text: str, heading_degrees: float, code: str = "en") -> str:
    """`text` after the sentence that states the start heading; the text itself chooses the phrasing."""
    return f"{preamble(heading_degrees, stable_hash('preamble', text), code)} {text}"


def render(program: Program, seed: int, instruction_id: str, code: str = "en") -> str:
    """One rendering of `program`, decided by (seed, instruction id, language)."""
    return _Renderer(language(code), Draws(generator(seed, "text", instruction_id, code))).program(program)


def word_count(program: Program, seed: int, instruction_id: str, *, preamble: bool) -> int:
    """Words of the published text of `program`, known before it is placed: every heading has a name of one word.

    preamble : whether texts that use compass words open with the start heading
    """
    text = render(program, seed, instruction_id)
    return len((with_preamble(text, 0.0) if preamble and names_compass(program) else text).split())


def render_moves(moves: tuple[ObjectRef, ...], seed: int, instruction_id: str, code: str = "en") -> str:
    """A bare sequence of moves as one sentence: what an oracle-linear twin says."""
    words = language(code)
    renderer = _Renderer(words, Draws(generator(seed, "text", instruction_id, code)))
    return _sentences(words, f"{renderer.moves(Leaf(moves=moves))}.")


class _Renderer:
    def __init__(self, words: Language, draws: Draws) -> None:
        self.words, self.draws = words, draws
        self.scope: RoomRef | None = None
        self.named: set[Condition] = set()
        self.suchable: set[str] = set()

    def program(self, program: Program) -> str:
        scope = self._scope(program)
        # One word for "if" throughout: "if …, but supposing …" reads as two kinds of condition.
        opener = self._pick("if")
        self.named = set()
        labels = Counter(condition.label for condition in program.conditions)
        self.suchable = {label for label, count in labels.items() if count == 1}
        texts = []
        for piece in self.draws.choice(self.words.templates[program.category]):
            if isinstance(piece, str):
                texts.append(piece)
            elif piece.kind == "leaf":
                texts.append(self.moves(program.leaves[piece.leaf]))
            elif piece.kind in ("guard", "check"):
                texts.append(self._clause(piece, opener, program))
            else:
                texts.append(self._pick(piece.kind))
        return _sentences(self.words, scope + "".join(texts))

    def _pick(self, slot: str) -> str:
        phrases = self.words.slots[slot]
        return phrases.texts[self.draws.cumulative(phrases.sums)]

    def _chance(self, share: float) -> bool:
        return self.draws.uniform() < share

    def _scope(self, program: Program) -> str:
        """The sentence that puts everything into one room, where there is one; it then need not be named again."""
        rooms = {c.room for c in program.conditions} | {m.room for leaf in program.leaves for m in leaf.moves}
        if len(rooms) > 1 or any(map(self._elided, rooms)) or not self._chance(SCOPE_SHARE):
            return ""
        (self.scope,) = rooms
        return f"{self._pick('scope')} {self._room(self.scope)}. "

    def _elided(self, room: RoomRef) -> bool:
        """Whether nouns are said without their room: it has no name, or is everything's."""
        return room == self.scope or room.label not in self.words.rooms

    def _clause(self, slot: Slot, opener: str, program: Program) -> str:
        literals = [self._literal(program.conditions[index], asserted) for index, asserted in slot.literals]
        if slot.kind == "check":
            return f"{self._pick('check')} {literals[0]}"
        return f"{opener} " + (f" {self._joint(slot.joint, opener)} " if slot.joint else "").join(literals)

    def _joint(self, slot: str, opener: str) -> str:
        """A phrase that joins two literals; one that opens anew ("and if") only does so as the first was opened."""
        phrase = self._pick(slot)
        joint, _, again = phrase.partition(" ")
        return joint if again != opener and again in self.words.slots["if"].texts else phrase

    def _literal(self, condition: Condition, asserted: bool) -> str:
        noun = self.words.nouns[condition.label]
        if condition in self.named and condition.label in self.suchable and self._chance(SUCH_SHARE):
            return self.words.filled(self._pick("again" if asserted else "never"), noun)
        self.named.add(condition)
        qualifier = self._qualifier(condition.qualifier)
        elided = self._elided(condition.room)
        if not elided and self._chance(ROOM_FIRST_SHARE):
            verb = self._pick("has" if asserted else "lacks")
            return f"{self._room(condition.room)} {self.words.filled(verb, noun)}{qualifier}"
        there_is = self.words.filled(self._pick("exists" if asserted else "absent"), noun)
        where = ""
        if not elided:
            where = f" {self._pick('in')} {self._room(condition.room)}"
        elif not qualifier and self.scope is None and self._chance(ANYWHERE_SHARE):
            # Once a room is named for all, "here" could be taken for where the agent stands.
            where = f" {self._pick('anywhere')}"
        return f"{there_is}{qualifier}{where}"

    def moves(self, leaf: Leaf) -> str:
        """The stops of one leaf as one imperative."""
        stops = leaf.moves
        texts = [f"{self._pick('go' if len(stops) == 1 else 'first')} {self._object(stops[0], None)}"]
        for k, stop in enumerate(stops[1:], start=1):
            joint = self._pick("finally" if k == len(stops) - 1 else "then")
            texts.append(f"{joint} {self._object(stop, stops[k - 1])}")
        return "".join(texts)

    def _object(self, ref: ObjectRef, before: ObjectRef | None) -> str:
        phrase = self.words.definite(self.words.nouns[ref.label]) + self._qualifier(ref.qualifier)
        if self._elided(ref.room):
            return phrase
        if before is not None and before.room == ref.room and self._chance(SAME_ROOM_SHARE):
            return f"{phrase} {self._pick('same')}"
        return f"{phrase} {self._pick('in')} {self._room(ref.room)}"

    def _qualifier(self, qualifier: Qualifier | None) -> str:
        if qualifier is None:
            return ""
        phrases = self.words.predicates[qualifier.predicate]
        relation = phrases.texts[self.draws.cumulative(phrases.sums)]
        return f" {relation} {self.words.definite(self.words.nouns[qualifier.anchor_label])}"

    def _room(self, room: RoomRef) -> str:
        phrase = self.words.definite(self.words.rooms[room.label])
        if room.anchor_label is None:
            return phrase
        return f"{phrase} {self._pick('with')} {self.words.definite(self.words.nouns[room.anchor_label])}"


def _sentences(words: Language, text: str) -> str:
    """Contractions made, and a capital at the start of each sentence."""
    return ". ".join(part[:1].upper() + part[1:] for part in words.contracted(text).split(". "))
