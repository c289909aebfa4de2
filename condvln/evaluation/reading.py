"""What all readers of agents' files share: the rules of reading, the names of episodes, and how entries that are
repeated or unfinished are treated.

A rule that leaves something out adds a sentence to the reader's `notes`, so that nothing is dropped without a word.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

from condvln.formats.json_entries import entries, head, json_lines, parsed
from schemas.errors import FormatError, TruncatedError, UsageError

__all__ = [
    "Duplicates",
    "ReadRules",
    "episode_name",
    "named_entries",
    "records",
    "unfinished",
    "without_duplicates",
    "without_summaries",
]

Duplicates = Literal["refuse", "keep-last"]

_WHOLE: Final = re.compile(r"(-?\d+)\.0+(_\d+)?")
_PARTIAL_REMEDY: Final = "If the run was killed while it wrote, --allow-partial leaves the unfinished entry out"
Item = TypeVar("Item")


@dataclass(frozen=True)
class ReadRules:
    """How files of predictions and results are read.

    Attributes
    ----------
    assume_stop : the last pose of a VLN-CE path that has no STOP counts as STOP, whatever its ``stop`` says
    duplicates : an episode that a file has twice is an error, or its last entry counts
    allow_partial : leave out an entry at the end of the file that is cut off
    """

    assume_stop: bool = False
    duplicates: Duplicates = "refuse"
    allow_partial: bool = False

    def __post_init__(self) -> None:
        if self.duplicates not in get_args(Duplicates):
            raise UsageError(f"--duplicates {self.duplicates!r}", remedy="Say refuse or keep-last.")


def episode_name(value: Any) -> str | None:
    """Return an episode's id as text: 474, 474.0, "474" and "474.0" are all "474", since tables of numbers turn whole
    numbers into floats, and "474.0_1" is "474_1". None if the value is not an id.
    """
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    if isinstance(value, str):
        whole = _WHOLE.fullmatch(value)
        return whole[1] + (whole[2] or "") if whole else value
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else None


def without_duplicates(
    items: Iterable[Item], name: Callable[[Item], str], path: Path, rules: ReadRules, notes: list[str], what: str
) -> Iterator[Item]:
    """Yield the items, of which no two have the same name. With ``keep-last``, only the last of them is yielded, in the
    place of the first.

    what : the kind of the items, in messages

    Raises
    ------
    FormatError : a name is repeated, and the rules refuse that
    """
    if rules.duplicates == "keep-last":
        kept: dict[str, Item] = {}
        count = 0
        for item in items:
            kept[name(item)] = item
            count += 1
        if count > len(kept):
            notes.append(f"{count - len(kept)} {what} of episodes that the file has again later were left out")
        yield from kept.values()
        return
    seen: set[str] = set()
    for item in items:
        key = name(item)
        if key in seen:
            raise FormatError(
                f"the file has two {what} of this episode",
                where=path,
                place=f"episode {key}",
                remedy="Keep one of the two; if a run was started again, --duplicates keep-last keeps the last",
            )
        seen.add(key)
        yield item


def named_entries(path: Path, rules: ReadRules, notes: list[str]) -> Iterator[tuple[str | None, str]]:
    """Yield (key, text) of each entry of an object or array, as `condvln.formats.json_entries.entries` does.

    Raises
    ------
    FormatError : the file is malformed, or ends early and the rules refuse that
    """
    yield from _to_the_end(entries(path), rules, notes)


def _to_the_end(items: Iterator[Item], rules: ReadRules, notes: list[str]) -> Iterator[Item]:
    """Yield the entries or lines of a file up to its end, or up to the place where it is cut off."""
    count = 0
    try:
        for item in items:
            yield item
            count += 1
    except TruncatedError as error:
        if not rules.allow_partial:
            raise unfinished(error) from error
        notes.append(f"{error.what}: {count} entries were read, and what follows them was left out")


def records(path: Path, rules: ReadRules, notes: list[str]) -> Iterator[tuple[str, object]]:
    """Yield (place, value) of each element of an array or of each line; numbers that are not finite are kept.

    Raises
    ------
    FormatError : as `named_entries`
    """
    if head(path, 1) == b"[":
        for number, (_, data) in enumerate(named_entries(path, rules, notes)):
            place = f"entry {number}"
            yield place, parsed(data, path, place, nonfinite=True)
        return
    broken: FormatError | None = None
    for number, line in _to_the_end(json_lines(path), rules, notes):
        if broken is not None:
            raise broken
        place = f"line {number}"
        try:
            value = parsed(line, path, place, nonfinite=True)
        except FormatError as error:
            broken = error
            continue
        yield place, value
    if broken is not None:
        if not rules.allow_partial:
            raise unfinished(broken) from broken
        notes.append(f"the last line can't be read and was left out ({broken.place}: {broken.what})")


def without_summaries(
    items: Iterable[tuple[str, object]], keys: Sequence[str], notes: list[str]
) -> Iterator[tuple[str, object]]:
    """Yield (place, value) of all items but objects that have none of the keys of an episode's entry, such as the means
    over all episodes that StreamVLN writes.
    """
    summaries = 0
    for place, value in items:
        if isinstance(value, dict) and value and not any(key in value for key in keys):
            summaries += 1
        else:
            yield place, value
    if summaries:
        notes.append(f"{summaries} entries without {keys[0]}, such as a summary of all episodes, were left out")


def unfinished(error: FormatError) -> FormatError:
    """Return an error of an entry that can't be read, with the option that leaves an unfinished entry out."""
    return FormatError(error.what, where=error.where, place=error.place, remedy=_PARTIAL_REMEDY)
