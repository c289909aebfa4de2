"""The bias gate on other people's files: can a guesser that sees only the text predict how a conditional episode ends?

Two questions are asked of each file. *Which clause*: if one clause of a text ends at the start (or on another floor)
and the other does not, the file's own path shows which clause was right; chance is a half. *Stays or goes*: of these
texts, and of conditional ones that could not be split, whether the path ends within `STAYS_WITHIN` of its start; chance
is the share of the more frequent answer. Guessers learn from other scenes only, as in the gate on exports.

Texts are read tolerantly, in English and Spanish: "if …, …; otherwise, …", the same with "then", "… if …, otherwise …"
and "check if …. If so, … . If not, …". A text with several conditions counts as conditional but is not split.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from condvln.bias.guessers import content_words
from condvln.bias.regression import NO_GUESS, progressive, regressed
from condvln.bias.report import BiasReport, Finding
from condvln.bias.significance import binomial_tail, holm, interval, p_by_scenes
from condvln.formats.json_document import MAX_COORDINATE, JsonNode
from condvln.language.report import words
from condvln.language.texts import instruction_items

__all__ = [
    "LEAST_GUESSES",
    "STAYS_WITHIN",
    "Clauses",
    "ForeignEpisode",
    "ForeignReport",
    "Motion",
    "is_conditional",
    "judge_files",
    "motion",
    "read_clauses",
    "read_foreign",
]

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


_STEP: Final = 0.25
"""Length of a forward action in metres."""
_FORWARD: Final = 1


@dataclass(frozen=True, slots=True)
class ForeignEpisode:
    """One instruction text of another project's file, with the scene and how far the episode's path leads (None if
    unknown).

    displacement : horizontal metres from its start to its end; rise : height in metres of the end above the start
    """

    episode_id: str
    scene: str
    text: str
    displacement: float | None = None
    rise: float | None = None


def read_foreign(path: str | os.PathLike[str]) -> Iterator[ForeignEpisode]:
    """Yield the episodes of another project's file in order, one for each instruction text.

    Raises
    ------
    InputError : the file does not exist, or it holds no instructions
    """
    for item, texts in instruction_items(Path(path)):
        yield from _episodes(item, texts)


def _episodes(item: JsonNode, texts: list[str]) -> Iterator[ForeignEpisode]:
    value = item.object().value
    scene = str(value.get("scene_id") or value.get("scan") or value.get("scene") or "")
    name = next((str(value[key]) for key in ("episode_id", "instruction_id", "path_id") if key in value), "")
    displacement, rise = _path(value)
    base = ForeignEpisode(name, PurePosixPath(scene).name.split(".")[0], "", displacement, rise)
    if "instructions" in item:
        for number, text in enumerate(texts):
            yield replace(base, episode_id=f"{name}_{number}", text=text)
        return
    (text,) = texts
    yield replace(base, text=text)
    own = value.get("navspace")
    variants = own.get("balance_variants") if isinstance(own, dict) else None
    for one in variants if isinstance(variants, list) else ():
        if isinstance(one, dict) and isinstance(one.get("instruction_text"), str):
            walked = _walked(one.get("actions"))
            yield replace(
                base,
                episode_id=str(one.get("id", name)),
                text=one["instruction_text"],
                displacement=0.0 if walked == 0.0 else displacement,
                rise=0.0 if walked == 0.0 else rise,
            )


def _path(value: dict[str, Any]) -> tuple[float | None, float | None]:
    """Return the displacement and the rise, in metres, of the path of an episode given as JSON; each is None if it is
    unknown.
    """
    points = value.get("reference_path")
    goals = value.get("goals")
    start = value.get("start_position")
    end = points[-1] if isinstance(points, list) and points else None
    if end is None and isinstance(goals, list) and goals and isinstance(goals[0], dict):
        end = goals[0].get("position")
    if _is_point(start) and _is_point(end):
        assert start is not None
        assert end is not None
        return math.hypot(end[0] - start[0], end[2] - start[2]), end[1] - start[1]
    walked = _walked(value.get("actions") or value.get("reference_actions"))
    if walked is not None:
        return walked, None
    viewpoints = value.get("path")
    if isinstance(viewpoints, list) and viewpoints:
        if len(viewpoints) == 1 or viewpoints[0] == viewpoints[-1]:
            return 0.0, 0.0
        distance = value.get("distance")
        return float(distance) if distance is not None and _is_metres(distance) else math.inf, None
    return None, None


def _walked(actions: object) -> float | None:
    if not isinstance(actions, list) or not actions:
        return None
    return _STEP * sum(action in (_FORWARD, "forward", "MOVE_FORWARD") for action in actions)


def _is_point(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_is_metres(x) for x in value)


def _is_metres(value: Any) -> bool:
    """Return whether a value is a number whose absolute value is at most MAX_COORDINATE. NaN, and whole numbers too
    large for a float, fail this comparison.
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE


STAYS_WITHIN: Final = 2.0
"""Largest horizontal distance in metres from start to end of a path that "stays"."""
FLOOR_HEIGHT: Final = 1.5
"""Least height difference in metres of a path that changes floor; below a third of it, it does not."""
LEAST_GUESSES: Final = 30
"""Smallest number of texts for which a question is tested."""
CLAUSE: Final = "which clause"
STAYS: Final = "stays or goes"
_WORDS_A_CLASS: Final = 5

Guesses = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _View:
    """What a guesser sees of a text, and the right answer. `scene` only says which texts share a scene."""

    scene: str
    text: str
    clauses: Clauses | None
    gold: int


@dataclass(frozen=True)
class FileCounts:
    """Numbers of texts in a file: all texts, those with a condition, those that could be split, and those whose path
    shows which clause was right. `mean_words` is the mean length of all texts.
    """

    texts: int
    conditional: int
    read: int
    decided: int
    scenes: int
    mean_words: float


@dataclass(frozen=True)
class ForeignReport:
    """The counts of texts in each file, by the file's path, and the results of all tests on all files."""

    files: Mapping[str, FileCounts]
    bias: BiasReport

    def document(self) -> dict[str, Any]:
        """The report as JSON."""
        return {
            "files": {name: {**vars(one), "mean_words": round(one.mean_words, 2)} for name, one in self.files.items()},
            **self.bias.document(),
        }


def judge_files(paths: Sequence[Path]) -> ForeignReport:
    """Run the gate on each file separately and return all results; the p-values of all tests are corrected together.

    Raises
    ------
    InputError : a file can't be read
    """
    files: dict[str, FileCounts] = {}
    findings: list[Finding] = []
    for path in paths:
        episodes = list(read_foreign(path))
        files[str(path)], views = _questions(episodes)
        name = path.name if len(paths) > 1 else ""
        for question, asked in views.items():
            findings += _findings(f"{name}: {question}" if name else question, asked, question == CLAUSE)
    corrected = holm([f.p for f in findings]) if findings else []
    judged = tuple(replace(f, p_holm=p) for f, p in zip(findings, corrected, strict=True))
    return ForeignReport(files, BiasReport(sum(one.conditional for one in files.values()), 0, judged, ()))


def _questions(episodes: Iterable[ForeignEpisode]) -> tuple[FileCounts, dict[str, list[_View]]]:
    views: dict[str, list[_View]] = {CLAUSE: [], STAYS: []}
    counts, scenes = Counter[str](), set()
    for episode in episodes:
        counts["texts"] += 1
        counts["words"] += len(words(episode.text))
        scenes.add(episode.scene)
        if not is_conditional(episode.text):
            continue
        counts["conditional"] += 1
        clauses = read_clauses(episode.text)
        counts["read"] += clauses is not None
        ends = _ends(clauses)
        clause = _clause(ends, episode)
        if clause is not None:
            counts["decided"] += 1
            views[CLAUSE].append(_View(episode.scene, episode.text, clauses, clause))
        if episode.displacement is not None and (clauses is None or "stays" in ends):
            stays = episode.displacement < STAYS_WITHIN
            views[STAYS].append(_View(episode.scene, episode.text, clauses, int(stays)))
    total = counts["texts"]
    found = FileCounts(
        total, counts["conditional"], counts["read"], counts["decided"], len(scenes), counts["words"] / max(1, total)
    )
    return found, views


def _ends(clauses: Clauses | None) -> tuple[Motion, ...]:
    """Return how far each of the two clauses leads, see `motion`; empty if the text does not have two clauses."""
    if clauses is None or not clauses.otherwise:
        return ()
    return motion(clauses.then, clauses), motion(clauses.otherwise, clauses)


def _clause(ends: tuple[Motion, ...], episode: ForeignEpisode) -> int | None:
    """Return 0 if the episode's path follows the first clause, 1 if it follows the "otherwise" clause, None if the path
    does not show which. `ends` says how far each of the two clauses leads; empty if there are not two.
    """
    if len(set(ends)) < 2 or episode.displacement is None:
        return None
    if "stays" in ends:
        at = ends.index("stays")
        return at if episode.displacement < STAYS_WITHIN else 1 - at
    if episode.rise is None or FLOOR_HEIGHT / 3 < abs(episode.rise) < FLOOR_HEIGHT:
        return None
    at = ends.index("changes floor")
    return at if abs(episode.rise) >= FLOOR_HEIGHT else 1 - at


def _findings(question: str, views: Sequence[_View], of_clauses: bool) -> Iterator[Finding]:
    if len(views) < LEAST_GUESSES:
        return
    gold = np.array([view.gold for view in views])
    scene = np.unique([view.scene for view in views], return_inverse=True)[1]
    rules = _RULES if of_clauses else {}
    guesses = {name: np.array([rule(v) for v in views], dtype=np.int64) for name, rule in rules.items()}
    guesses["majority"] = _majority(views)
    for name, features in _FEATURES.items():
        guesses[name] = regressed(views, features)
    for name, guess in guesses.items():
        inside = guess != NO_GUESS
        if inside.sum() < LEAST_GUESSES:
            continue
        right, own = guess[inside] == gold[inside], scene[inside]
        share = float(gold[inside].mean())
        # A text does not reveal which answer is more frequent overall, so that is the chance level; for two clauses it
        # is a half.
        chance = 0.5 if of_clauses else max(share, 1.0 - share)
        low, high = interval(right, own)
        tail = binomial_tail(int(right.sum()), {chance: len(right)})
        yield Finding(
            guesser=name,
            source=question,
            category="all",
            episodes=len(right),
            scenes=len(np.unique(own)),
            accuracy=float(right.mean()),
            chance=chance,
            low=low,
            high=high,
            p=max(tail, p_by_scenes(right - chance, own)),
        )


def _majority(views: Sequence[_View]) -> Guesses:
    guesses = np.full(len(views), NO_GUESS, dtype=np.int64)
    for learned, guessed in progressive([view.scene for view in views]):
        guesses[guessed] = int(2 * sum(views[k].gold for k in learned) > len(learned))
    return guesses


def _stays(view: _View) -> int:
    """Return the index of the clause whose route ends at the start position; 0 if none does."""
    ends = _ends(view.clauses)
    return ends.index("stays") if "stays" in ends else 0


def _longest(view: _View) -> int:
    assert view.clauses is not None
    return int(len(view.clauses.otherwise.split()) > len(view.clauses.then.split()))


_RULES: Final[Mapping[str, Callable[[_View], int]]] = {
    "always then": lambda view: 0,
    "always otherwise": lambda view: 1,
    "the clause that stays": _stays,
    "the clause that goes": lambda view: 1 - _stays(view),
    "longer clause": _longest,
    "shorter clause": lambda view: 1 - _longest(view),
}


def _parts(view: _View) -> tuple[tuple[str, str], ...]:
    found = view.clauses
    if found is None:
        return (("text", view.text.lower()),)
    return ("asks", found.condition), ("then", found.then), ("otherwise", found.otherwise)


def _bag(view: _View) -> Iterator[str]:
    """Yield the words and word pairs of the whole text."""
    said = words(view.text)
    yield from said
    yield from (f"{one} {other}" for one, other in pairwise(said))


def _asked(view: _View) -> Iterator[str]:
    """Yield the words of the condition."""
    for name, text in _parts(view):
        if name != "otherwise" and name != "then":
            yield from words(text)


def _in_place(view: _View) -> Iterator[str]:
    """Yield each word of a text, marked with the clause in which the word occurs."""
    for name, text in _parts(view):
        yield from (f"{name} {word}" for word in words(text))


def _form(view: _View) -> Iterator[str]:
    """Yield the pairs of consecutive words in each part of a text. Nouns of objects and rooms are replaced by "_", and
    each pair is marked with the part's name.
    """
    content = content_words()
    for name, text in _parts(view):
        said = [word if word not in content else "_" for word in words(text)]
        yield from (f"{name} {one} {other}" for one, other in pairwise(said))


def _length(view: _View) -> Iterator[str]:
    """Yield the lengths of the text and its clauses."""
    yield f"{len(words(view.text)) // _WORDS_A_CLASS} fives"
    for name, text in _parts(view):
        yield f"{name} {len(words(text)) // _WORDS_A_CLASS} fives"


_FEATURES: Final[Mapping[str, Callable[[_View], Iterable[str]]]] = {
    "what is asked": _asked,
    "form of the text": _form,
    "length": _length,
    "bag of words": _bag,
    "words in place": _in_place,
}
