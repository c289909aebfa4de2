"""The reasons for which a draw of a program is rejected."""

from __future__ import annotations

from typing import Final

from condvln.instructions.degeneracy import REASONS as RULES

__all__ = ["REASONS", "GivenUp"]

REASONS: Final[dict[str, str]] = {
    "nothing_to_ask": "no nameable room has both true and false statements: its annotation is incomplete, "
    "it has too few objects, or they are not visible from where an agent can stand",
    "no_targets": "too few objects can be named, reached and distinguished",
    "no_waypoint": "no further stop is far enough from the leaf's other stops and the other leaves' goals",
    "one_first_stop": "more than half of the leaves begin with the same stop",
    "no_condition": "every statement of the wanted truth violates a rule",
    "composition_missed": "the draw does not have the composition that the cell asks for",
    "words_missed": "the text has fewer or more words than the cell asks for",
    "no_twin": "no condition that decides the gold leaf has a counterpart of the opposite truth",
    "duplicate": "the same program was drawn before",
    "label_over_cap": "every possible target label already has its share of the scene's leaves",
    **RULES,
}
"""All reasons that the program stage counts in the rejections table."""


class GivenUp(Exception):
    """A draw that can't be completed; `reason` is a key of `REASONS`."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
