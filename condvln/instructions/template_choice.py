"""Choose the sentence template of a text, among those in which the program can be worded, by what the text names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter

from condvln.instructions.language import LONGEST_SENTENCE, Language, Template
from condvln.seeding import Draws
from schemas.program import Condition, ObjectRef, Program, RoomRef

__all__ = ["Naming", "TemplateChoice", "labels_of"]


@dataclass(frozen=True, slots=True)
class Naming:
    """The rooms and labels that a text names.

    rooms : the rooms
    shared : labels that are named in several rooms
    asked_once : labels that one condition asks about
    asked_only : those of them that are named nowhere else, so that their noun alone stands for the condition
    """

    rooms: tuple[RoomRef, ...] = ()
    shared: frozenset[str] = frozenset()
    asked_once: frozenset[str] = frozenset()
    asked_only: frozenset[str] = frozenset()

    @classmethod
    def of(cls, program: Program) -> Naming:
        """Return what the text of a program names."""
        moves = [move for leaf in program.leaves for move in leaf.moves]
        named_things: list[Condition | ObjectRef] = [*program.conditions, *moves]
        rooms = {named.room.room_id: named.room for named in named_things}
        asked = [condition.label for condition in program.conditions]
        once = frozenset([label for label in asked if asked.count(label) == 1])
        elsewhere: set[str] = set()
        for move in moves:
            elsewhere.update(labels_of(move))
        for condition in program.conditions:
            elsewhere.update(labels_of(condition)[1:])
        shared = _shared(named_things) if len(rooms) > 1 else frozenset()
        return cls(tuple(rooms.values()), shared, once, once - elsewhere)

    def is_shared(self, named: Condition | ObjectRef) -> bool:
        """Return whether objects with one of the labels of `named` are also named in another room, so that the room
        must be said.
        """
        return bool(self.shared) and not self.shared.isdisjoint(labels_of(named))

    def has_article(self, condition: Condition) -> bool:
        """Return whether a condition can be repeated by its noun alone, with the indefinite article."""
        return not condition.definite and condition.label in self.asked_only


def labels_of(named: Condition | ObjectRef) -> tuple[str, ...]:
    """Return the labels of an object and of its anchors."""
    return (named.label, *(named.qualifier.anchor_labels if named.qualifier is not None else ()))


def _shared(named_things: list[Condition | ObjectRef]) -> frozenset[str]:
    """Return the labels that are named in several rooms."""
    room_of: dict[str, str] = {}
    shared = set()
    for named in named_things:
        for label in labels_of(named):
            if room_of.setdefault(label, named.room.room_id) != named.room.room_id:
                shared.add(label)
    return frozenset(shared)


class TemplateChoice:
    """Chooses a template for one program.

    naming : what the program's text names
    scoped : whether the text begins with its only room, so that no noun needs it: "in the bedroom, if the lamp …"
    """

    def __init__(self, program: Program, naming: Naming, words: Language, *, scoped: bool) -> None:
        self._program, self._naming, self._words, self._scoped = program, naming, words, scoped

    def draw(self, templates: Sequence[Template], draws: Draws) -> Template:
        """Return a template, drawn at random from those that read well; if none does, from those with the least
        fault.
        """
        left, kept = list(templates), list[tuple[int, Template]]()
        sizes = self._sizes()
        while left:
            template = left.pop(draws.index(len(left)) if len(left) > 1 else 0)
            if template.is_choosy and not self._is_sayable(template):
                continue
            fault = 4 * (self._is_wearying(template) or self._asks_apart(template))
            fault += 2 * self._looks_afar(template) + _is_long(template, *sizes)
            if not fault:
                return template
            kept.append((fault, template))
        return min(kept, key=itemgetter(0))[1]

    def _is_sayable(self, template: Template) -> bool:
        """Return whether the leaf before the first condition has one stop, which is in another room, and the nouns of
        "neither a lamp nor a bed" can stand for their conditions.
        """
        program = self._program
        room = program.conditions[0].room
        for k in template.leading:
            first, *others = program.leaves[k].moves
            if others or (first.room.room_id == room.room_id and not self._elided(room)):
                return False
        return all(self._naming.has_article(program.conditions[k]) for k in template.paired)

    def _is_wearying(self, template: Template) -> bool:
        """Return whether a template states a condition with its relation three times."""
        again = template.restated
        return bool(again) and not all(self._naming.has_article(self._program.conditions[k]) for k in again)

    def _asks_apart(self, template: Template) -> bool:
        """Return whether a template asks questions like "is the lamp in the bedroom with the desk near the bed?", or
        any question in a text that begins with its room.
        """
        if self._scoped or not template.questions:
            return bool(template.questions)
        asked = [self._program.conditions[k] for k in template.questions]
        return any(condition.definite and condition.room.anchor_label is not None for condition in asked)

    def _looks_afar(self, template: Template) -> bool:
        """Return whether a template says "find the lamp in the kitchen" to somebody whom nothing has sent there."""
        if len(self._naming.rooms) < 2:
            return False
        led = self._program.last_leads
        return any(form == "see" and led[k] is None for k, form in template.stated.items())

    def _sizes(self) -> tuple[list[int], list[int]]:
        """Return the approximate numbers of words of the conditions and of the leaves."""
        conditions = [self._size(condition) + 3 for condition in self._program.conditions]
        return conditions, [sum([self._size(move) + 3 for move in leaf.moves]) for leaf in self._program.leaves]

    def _size(self, named: Condition | ObjectRef) -> int:
        """Return the approximate number of words that name a thing, besides its article and verb."""
        qualifier = named.qualifier
        words = named.label.count(" ") + (0 if self._elided(named.room) else 3)
        if qualifier is None:
            return words
        lying = 2 if self._words.lying and isinstance(named, ObjectRef) else 0
        return words + lying + 2 + sum(label.count(" ") + 2 for label in qualifier.anchor_labels)

    def _elided(self, room: RoomRef) -> bool:
        """Return whether nouns are said without this room."""
        return self._scoped or room.label not in self._words.rooms


def _is_long(template: Template, conditions: Sequence[int], leaves: Sequence[int]) -> bool:
    """Return whether some part of a template would be longer than a sentence should be, for conditions and leaves of
    these approximate numbers of words.
    """
    for words, slots in template.parts:
        for is_leaf, index, fixed in slots:
            words += fixed or (leaves if is_leaf else conditions)[index]
        if words > LONGEST_SENTENCE:
            return True
    return False
