"""The meaning of words, read from the vocabulary's tables with code that is independent of the generator's.

The tables are shared with the generator; its code is not, so that a fault in it is detected.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import combinations
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    # Only since Python 3.11.
    from importlib.resources.abc import Traversable  # novm

__all__ = ["Bounds", "Words", "folded", "package_data", "words"]

SOURCE_OF_FAMILY: Final = {
    "replicacad": "replicacad",
    "procthor": "ai2thor",
    "ithor": "ai2thor",
    "robothor": "ai2thor",
    "ai2thor-hab": "ai2thor",
    "mp3d": "mp3d",
    "gibson": "gibson",
    "hm3d": "hm3d",
    "hssd": "hssd",
}
"""The list of raw labels used by a family's scenes."""

ANY: Final = "*"
"""In the tables: an object that may be anything."""

_OBJAVERSE: Final = "obja "
"""Prefix of AI2-THOR's types of Objaverse assets."""

Bounds: TypeAlias = Mapping[str, float]
"""Bounds of a box, by the names of the columns of ``sizes.csv``; "upright" is the least ratio of height and length."""

SMALL: Final = (0.2, 0.12, "")
"""Sides in metres of an object of which nothing is known, and that it does not lie flat."""
_UNBOUNDED: Final = {"least": "0", "most": "inf", "thickness": "inf", "low": "0", "high": "inf", "ratio": "inf"}
"""The bounds of empty cells."""

_BORDERS: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[_#\s]+")
_COPY_NUMBER: Final = re.compile(r"\s\d+$")


def package_data(*parts: str) -> Traversable:
    """Return the file or folder ``condvln/<parts…>``. The path is built from folders, so that no module on the way is
    imported.
    """
    found: Traversable = files("condvln")
    for part in parts:
        found = found / part
    return found


def folded(raw: str) -> str:
    """Return a raw label as lower-case words: ``ArmChair``, ``arm_chair`` and ``arm#chair`` give ``arm chair``."""
    return " ".join(_BORDERS.sub(" ", raw).lower().split())


@dataclass(frozen=True, eq=False)
class Words:
    """The vocabulary, as the verifier reads it.

    confusable : by label of an object, the labels that a speaker might mean by a word for it, itself included
    confusable_rooms : the same of room types
    nouns, rooms : (noun, its article) of the labels and room types that text may name
    structure : labels of walls, floors and the like
    objects : all other labels but the catch-alls, each with the bounds of its longest side in metres
    containers : kind by label: ``shut`` (a door or lid may hide the contents) or ``open``
    frames : labels of open frames, which one can see through
    roles : labels that are fixed or portable, by the name of the role
    fixtures : by room type ("" for all), the labels that nearly every such room has, and whether a room without one is
        taken to be annotated in part
    sizes : by label, the bounds of an object's box for which a scan's label is trusted
    """

    confusable: Mapping[str, frozenset[str]]
    confusable_rooms: Mapping[str, frozenset[str]]
    nouns: Mapping[str, tuple[str, str]]
    rooms: Mapping[str, tuple[str, str]]
    structure: frozenset[str]
    objects: Mapping[str, tuple[float, float]]
    _general_rooms: frozenset[str]
    _vague: Mapping[str, frozenset[str]]
    _unnamed: Mapping[tuple[str, str], frozenset[str]]
    containers: Mapping[str, str]
    frames: frozenset[str]
    roles: Mapping[str, frozenset[str]]
    fixtures: Mapping[str, Mapping[str, bool]]
    _usual: Mapping[str, tuple[float, float, str]]
    sizes: Mapping[str, Bounds]
    _called: Mapping[str, tuple[tuple[str, bool], ...]]
    _labels: Mapping[tuple[str, str], str]
    _room_types: Mapping[tuple[str, str], str]
    _contents: tuple[tuple[str, str, int, str], ...]
    _by_word: Mapping[str, str]
    _room_by_word: Mapping[str, str]

    def meant_by(self, label: str) -> frozenset[str]:
        """Return the labels that a word for `label` might mean."""
        return self.confusable.get(label, frozenset((label,)))

    def rooms_meant_by(self, label: str) -> frozenset[str]:
        """Return the room types that a word for `label` might mean."""
        return self.confusable_rooms.get(label, frozenset((label,)))

    def any_room(self, label: str) -> bool:
        """Return whether the noun of the room type `label`, such as "room", might mean a room of any type."""
        return label in self._general_rooms

    def may_be(self, label: str, family: str, side: float | None) -> tuple[frozenset[str], bool]:
        """Return the other labels that an object with this label may have, and whether nothing but the object's size
        limits what the object may be.

        side : its longest side in metres
        """
        if label in self.confusable:
            written = self._vague.get(label, frozenset())
        else:
            written = self._unnamed.get((SOURCE_OF_FAMILY.get(family, ""), label), frozenset((ANY,)))
        found = frozenset(self.objects) if ANY in written else written
        if side is not None:
            found = frozenset(one for one in found if self.objects[one][0] <= side <= self.objects[one][1])
        return found, ANY in written

    def usual(self, label: str) -> tuple[float, float, str]:
        """Return the longer and the shorter side in metres of what one sees of a usual object with a label, and on what
        it lies flat, if it does ("floor" or "table"); those of a small one if nothing is known of the label.
        """
        return self._usual.get(label, SMALL)

    def also_called(self, label: str, *, low: bool) -> frozenset[str]:
        """Return the other labels that some people would use for an object with this label.

        low : the object is no taller than its footprint is long
        """
        return frozenset(other for other, only_low in self._called.get(label, ()) if low or not only_low)

    def label(self, raw: str, family: str, model: str = "") -> str:
        """Return the canonical label for `raw`, a label as the source writes it; the words of `raw` if the tables don't
        list it.

        model : the object's model name; if the tables list it, it takes precedence over `raw`, since some sources label
            a model wrongly
        """
        if (SOURCE_OF_FAMILY.get(family, ""), model) in self._labels:
            raw = model
        return _listed(self._labels, raw, family) or self._said(raw, family)

    def _said(self, raw: str, family: str) -> str:
        text = folded(raw)
        if SOURCE_OF_FAMILY.get(family) == "ai2thor" and text.startswith(_OBJAVERSE):
            named = text[len(_OBJAVERSE) :]
            return self._by_word.get(named) or self._by_word.get(_COPY_NUMBER.sub("", named)) or text
        return self._by_word.get(text) or self._by_word.get(_COPY_NUMBER.sub("", text)) or text

    def room_type(self, raw: str, family: str) -> str:
        """Return the canonical room type for a room type as the source names it."""
        listed = _listed(self._room_types, raw, family)
        return listed if listed is not None else self._room_by_word.get(folded(raw), folded(raw))

    def shown_types(self, things: Sequence[str], around: Set[str] | None = None) -> frozenset[str]:
        """Return the room types that show in the labels `things` of what a room holds.

        around : types of the scene's rooms, for the types that show only beside a room of another type; None for all
            other types
        """
        return frozenset(
            to
            for to, label, least, beside in self._contents
            if things.count(label) >= least and (beside in around if around is not None else not beside)
        )


@cache
def words() -> Words:
    """Return the vocabulary, read from the package's tables once per process."""
    labels = {row["label"]: row for row in _rows("labels.csv")}
    said = {label: {label, row["noun"], *filter(None, row["synonyms"].split(";"))} for label, row in labels.items()}
    rooms = {row["label"]: row for row in _rows("rooms.csv")}
    room_words = {label: {label, *filter(None, row["synonyms"].split(";"))} for label, row in rooms.items()}
    confusable = _sharing(said)
    for label in labels:
        for broader in _broader(label, labels):
            confusable[label].add(broader)
            confusable[broader].add(label)
    return Words(
        confusable={label: frozenset(others) for label, others in confusable.items()},
        confusable_rooms={label: frozenset(others) for label, others in _sharing(room_words).items()},
        nouns={x: (row["noun"], row["article"]) for x, row in labels.items() if row["in_text"] == "yes"},
        rooms={x: (row["noun"], row["article"]) for x, row in rooms.items() if row["in_text"] == "yes"},
        structure=frozenset(label for label, row in labels.items() if row["kind"] == "structure"),
        objects={
            label: (float(row["least"] or 0), float(row["most"] or "inf"))
            for label, row in labels.items()
            if row["kind"] == "object"
        },
        _general_rooms=frozenset(label for label, row in rooms.items() if row["general"] == "yes"),
        _vague={label: _cell(row["may_be"]) for label, row in labels.items() if row["may_be"]},
        _unnamed={
            (row["source"], folded(row["raw_label"])): _cell(row["may_be"])
            for row in _rows("raw_labels.csv")
            if not row["label"]
        },
        containers=_containers(labels),
        frames=_frames(labels),
        roles=_roles(),
        fixtures=_fixtures(),
        _called=_called(),
        _usual={x["label"]: (float(x["long"]), float(x["short"]), x["flat"]) for x in _rows("usual.csv")},
        sizes={row["label"]: _bounds(row) for row in _rows("sizes.csv")},
        _labels=_raw_table("raw_labels.csv"),
        _room_types=_raw_table("raw_rooms.csv"),
        _contents=tuple(
            (row["room_type"], row["label"], int(row["least"]), row["beside"]) for row in _rows("room_contents.csv")
        ),
        _by_word=_unambiguous(said),
        _room_by_word=_unambiguous(room_words),
    )


def _bounds(row: Mapping[str, str]) -> Bounds:
    found = {name: float(row[name] or none) for name, none in _UNBOUNDED.items()}
    return {**found, "upright": float(row["upright"] == "yes")}


def _fixtures() -> dict[str, dict[str, bool]]:
    found: dict[str, dict[str, bool]] = {}
    for row in _rows("fixtures.csv"):
        found.setdefault(row["room_type"], {})[row["label"]] = row["required"] == "yes"
    return found


def _called() -> dict[str, tuple[tuple[str, bool], ...]]:
    found: dict[str, list[tuple[str, bool]]] = {}
    for row in _rows("confusion.csv"):
        found.setdefault(row["other"], []).append((row["label"], row["low"] == "yes"))
    return {other: tuple(labels) for other, labels in found.items()}


def _roles() -> dict[str, frozenset[str]]:
    found: dict[str, set[str]] = {}
    for row in _rows("roles.csv"):
        found.setdefault(row["role"], set()).add(row["label"])
    return {role: frozenset(labels) for role, labels in found.items()}


def _rows(name: str) -> Iterator[dict[str, str]]:
    return csv.DictReader(package_data("labels", name).read_text(encoding="utf-8").splitlines())


def _cell(text: str) -> frozenset[str]:
    return frozenset(filter(None, text.split(";")))


def _raw_table(name: str) -> dict[tuple[str, str], str]:
    """Return the canonical label of each (source, raw label). The folded form of each raw label is also a key, unless
    it has an entry of its own.
    """
    listed = {(row["source"], row["raw_label"]): row["label"] for row in _rows(name)}
    # Matterport3D's one-letter labels are case-sensitive, and so have no folded form.
    other = {(source, folded(raw)): label for (source, raw), label in reversed(listed.items()) if len(raw) > 1}
    return other | listed


def _containers(labels: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the kind of container of each label: the listed kind, else the kind of the first broader label that is
    listed.
    """
    listed = {row["label"]: row["kind"] for row in _rows("containers.csv")}
    found = {}
    for label in labels:
        known = [name for name in (label, *sorted(_broader(label, labels))) if name in listed]
        if known and listed[known[0]]:
            found[label] = listed[known[0]]
    return found


def _frames(labels: Mapping[str, Mapping[str, str]]) -> frozenset[str]:
    """Return the labels listed as frames, and all narrower labels. Labels of objects that can be shut are left out."""
    listed = {row["label"] for row in _rows("frames.csv")}
    shut = {label for label, kind in _containers(labels).items() if kind == "shut"}
    return frozenset(label for label in labels if listed & {label, *_broader(label, labels)}) - shut


def _listed(table: Mapping[tuple[str, str], str], raw: str, family: str) -> str | None:
    """Return the label that `table` lists for a raw label; None if the table does not list the raw label. An empty
    entry means that the raw label is deliberately unmapped; then the folded raw label is returned.
    """
    source = SOURCE_OF_FAMILY.get(family, "")
    exact = table.get((source, raw))
    if exact is not None:
        return exact or folded(raw)
    found = table.get((source, folded(raw)))
    return found if found is None else found or folded(raw)


def _sharing(said: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return for each label all labels that share a word with it, including itself."""
    found = {label: {label} for label in said}
    of_word: dict[str, set[str]] = {}
    for label, own in said.items():
        for word in own:
            of_word.setdefault(word, set()).add(label)
    for sharers in of_word.values():
        for one, other in combinations(sharers, 2):
            found[one].add(other)
            found[other].add(one)
    return found


def _unambiguous(said: Mapping[str, set[str]]) -> dict[str, str]:
    """Return the label that each word stands for. A label's own name always stands for it; another word counts only if
    a single label has it.
    """
    holders: dict[str, list[str]] = {}
    for label, own in said.items():
        for word in own:
            holders.setdefault(word, []).append(label)
    only = {word: labels[0] for word, labels in holders.items() if len(labels) == 1}
    return only | {label: label for label in said}


def _broader(label: str, labels: Mapping[str, Mapping[str, str]]) -> set[str]:
    """Return all labels that `label` is a kind of."""
    found: set[str] = set()
    ahead = [label]
    while ahead:
        above = [x for x in labels[ahead.pop()]["hypernyms"].split(";") if x and x not in found]
        found.update(above)
        ahead.extend(above)
    return found
