"""Why a draw is given up."""

from __future__ import annotations

from typing import Final

from condvln.instructions.degeneracy import REASONS as RULES

__all__ = ["REASONS", "GivenUp"]

REASONS: Final[dict[str, str]] = {
    "nothing_to_ask": "no room that can be named has statements of both truths: it is not annotated completely, "
    "too bare, or what is in it can't be seen from where an agent can stand",
    "no_targets": "too few objects that can be named, stood at and told apart in place",
    "no_waypoint": "no further stop lies apart from the leaf's other stops and the other leaves' goals",
    "no_condition": "no statement of the wanted truth is left that breaks no rule",
    "composition_missed": "the draw is not of the composition asked for",
    "words_missed": "the text has fewer or more words than the cell asks for",
    "no_twin": "no condition that decides the gold leaf has a counterpart of the opposite truth",
    "duplicate": "the same program was drawn before",
    "label_over_cap": "every label that could be a target has its share of the scene's leaves",
    **RULES,
}
"""Every reason counted in the rejections table by this stage."""


class GivenUp(Exception):
    """A draw that leads nowhere; `reason` is a key of `REASONS`."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)
