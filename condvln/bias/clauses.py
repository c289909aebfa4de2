"""Read other people's conditional texts tolerantly: find the condition, and what to do if it is true or false.

English and Spanish. It reads "if …, …; otherwise, …", the same with "then", "… if …, otherwise …" and "check if ….
If so, … . If not, …". A text with several conditions counts as conditional but is not split.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["Clauses", "Motion", "is_conditional", "motion", "read_clauses"]

Motion = Literal["stays", "changes floor", "walks"]
"""Where a clause ends: at its start, on another floor, or elsewhere."""

_IF: Final = re.compile(
    r"(?<!as )(?<!even )\b(?:if|unless|in case|provided that)\b(?! so\b| not\b| yes\b| no\b)"
    r"|\bwhen there(?:'s| is| are)\b|\bsi\b(?! no\b)"
)
_ELSE: Final = re.compile(r"\b(?:otherwise|or else|if not|if no|else|de lo contrario|en caso contrario|si no)\b[,:]?")
_SO: Final = re.compile(r"\b(?:if so|if yes|then|en ese caso)\b[,:]?")
_START: Final = re.compile(r"^\W*(?:start(?:ing)? )?(?:from|in|at) (?:the |your )?([a-z][a-z ]*?),")
_WALK: Final = re.compile(
    r"\b(?:walk|go|head|leave|exit|enter|turn|find|move|proceed|continue|climb|cross|pass|take|make|step|follow|run|keep|"
    r"ve|camina|sal|entra|gira|sube|baja|busca)(?:ing|s)?\b"
)
_REST: Final = re.compile(r"\b(?:stay|remain|stop|wait|stand|halt|quédate|para|detente|espera)\b")
_NO_MOVE: Final = re.compile(r"\b(?:do not|don't|no need to) (?:move|go|walk)\b|\bno te muevas\b")
_HERE: Final = re.compile(
    r"\b(?:where you are|here|still|put|in place|right there|starting (?:point|position|place)|donde estás|aquí)\b"
)
_IN_ROOM: Final = re.compile(r"\b(?:stop|stay|remain|wait) in (?:the|your|this|that|el|la)(?! (?:middle|front)\b)")
_ALONE: Final = re.compile(r"\W*(?:just |simply |then )*(?:stay|remain|stop|wait|quédate|para)\b\W*")
_BACK: Final = re.compile(r"\b(?:return|go back|come back|vuelve)\b.*\b(?:start|starting|started|began|inicio)\b")
_FLOOR: Final = re.compile(
    r"\b(?:upstairs|downstairs|(?:up|down|climb) (?:the |a |that )?(?:stairs?|stairway|staircase|steps|flight)"
    r"|(?:go|going|head|walk) (?:up|down) (?:them|to the (?:next|upper|lower|first|second) floor)"
    r"|(?:sube|baja) (?:por )?las escaleras)\b"
)


@dataclass(frozen=True, slots=True)
class Clauses:
    """A text with one condition, split into lower-case parts.

    before : the part ahead of the condition; start : the room of the start, empty if not stated
    then, otherwise : what to do; `otherwise` is empty if not stated
    """

    before: str
    condition: str
    then: str
    otherwise: str
    start: str


def is_conditional(text: str) -> bool:
    """Return whether the text contains a condition."""
    return _IF.search(text.lower()) is not None


def read_clauses(text: str) -> Clauses | None:
    """Return the parts of a text with exactly one condition; None if the text has no condition or several, or can't be
    split.
    """
    low = " ".join(text.lower().split())
    asked = list(_IF.finditer(low))
    if len(asked) != 1 or len(_ELSE.findall(low)) > 1:
        return None
    (found,) = asked
    before, after = low[: found.start()], low[found.end() :]
    other = _ELSE.search(after)
    main, otherwise = (after, "") if other is None else (after[: other.start()], after[other.end() :])
    condition, then = _parted(main)
    if not then:  # "go to the sofa if there is a lamp"
        before, then = _last_sentence(before)
    if not condition or not then:
        return None
    start = _START.match(low)
    return Clauses(before, condition, then, _trimmed(otherwise), "" if start is None else start[1])


def motion(clause: str, clauses: Clauses) -> Motion:
    """Return how far `clause`, a part of the text `clauses`, leads the walker: "stays", "walks" or "changes floor"."""
    if _NO_MOVE.search(clause) or _BACK.search(clause) or _returns(clause, clauses.start):
        return "stays"
    ahead = _WALK.search(_START.sub("", clauses.before))  # the shared beginning leads away from the start
    resting = not ahead and not _WALK.search(clause) and _REST.search(clause)
    if resting and (_HERE.search(clause) or _IN_ROOM.search(clause) or _ALONE.fullmatch(clause)):
        return "stays"
    return "changes floor" if _FLOOR.search(clause) else "walks"


def _returns(clause: str, start: str) -> bool:
    """Return whether a clause leads back to the room in which the walk starts, `start`; False if `start` is empty."""
    back = rf"\b(?:return|go back|head back|come back)\b.* (?:the |your )?{re.escape(start)}\b"
    return bool(start) and re.search(back, clause) is not None


def _parted(main: str) -> tuple[str, str]:
    """Split `main`, the part of a text from its condition on, into the condition and the rest, which may be empty."""
    so = _SO.search(main)
    comma = main.find(",")
    stop = re.search(r"[.;:] ", main)
    if so is not None and (comma < 0 or so.start() <= comma + 2 or (stop is not None and stop.start() < comma)):
        return _trimmed(main[: so.start()]), _trimmed(main[so.end() :])
    if comma >= 0:
        return _trimmed(main[:comma]), _trimmed(main[comma + 1 :])
    return _trimmed(main), ""


def _last_sentence(text: str) -> tuple[str, str]:
    at = max(text.rfind(mark) for mark in ".!?;") + 1
    return text[:at], _trimmed(text[at:])


def _trimmed(text: str) -> str:
    return text.strip(" ,;:.")
