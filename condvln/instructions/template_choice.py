"""Choose the sentence template of a text, among those in which the program can be worded."""

from __future__ import annotations

from collections.abc import Sequence

from condvln.instructions.language import Language, Template
from condvln.instructions.naming import Naming
from condvln.instructions.sentences import LONGEST_SENTENCE
from condvln.seeding import Draws
from schemas.program import Condition, ObjectRef, Program, RoomRef

__all__ = ["TemplateChoice"]


class TemplateChoice:
    """Chooses a template for one program.

    naming : what the program's text names
    scoped : whether the text begins with its only room, so that no noun needs it: "in the bedroom, if the lamp …"
    """

    def __init__(self, program: Program, naming: Naming, words: Language, *, scoped: bool) -> None:
        self._program, self._naming, self._words, self._scoped = program, naming, words, scoped

    def draw(self, templates: Sequence[Template], draws: Draws) -> Template:
        """Return a template, drawn at random from those that read well; from the others if none does."""
        left = list(templates)
        kept: list[Template] = []
        sizes: tuple[list[int], list[int]] | None = None
        while left:
            template = left.pop(draws.index(len(left)) if len(left) > 1 else 0)
            if template.is_choosy and not self._is_sayable(template):
                continue
            if self._is_wearying(template) or self._asks_apart(template):
                kept.append(template)
            else:
                sizes = sizes or self._sizes()
                if not _is_long(template, *sizes):
                    return template
                kept.insert(0, template)
        return kept[0]

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
