"""The canonical vocabulary of objects and rooms over all sources, read from the tables beside this module.

``labels.csv`` and ``rooms.csv`` hold one row per canonical label. ``raw_labels.csv`` and ``raw_rooms.csv`` map each
source's own label to a canonical one and name the list that the raw label comes from. A raw label with an empty
canonical label is deliberately unmapped; ``may_be`` then lists the canonical labels that the object could have. ``*``
means any label; an empty cell means none, for an object without a word in the vocabulary (a hammer) or a part of an
object (a door handle). An object whose raw label is in no list could have any label. Catch-all labels have ``may_be``
in ``labels.csv``.

``least`` and ``most`` are generous bounds in metres of the longest side of objects with a label. They only decide which
labels an unnamed object of known size can't have.

``containers.csv`` lists what can hold objects inside: ``shut`` where a door, lid or drawer may hide them, ``open``
where they stay visible, empty for a label that is an exception to its broader label. ``frames.csv`` lists open frames:
objects of legs, boards and rails, whose box is mostly air.
"""

from __future__ import annotations

import csv
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal, TypeVar, cast

__all__ = ["LabelEntry", "RoomEntry", "Vocabulary", "normalise"]

Kind = Literal["object", "structure", "catch_all"]
T = TypeVar("T")
ContainerKind = Literal["shut", "open"]

SOURCE_OF_FAMILY: Final[Mapping[str, str]] = {
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
"""The list of raw labels of each family. A family without one is read by the canonical words alone."""

ANYTHING: Final = "*"
"""In a ``may_be`` cell: any label."""

OBJAVERSE: Final = "obja "
"""Prefixes of AI2-THOR's types of Objaverse assets, in normal form (``ObjaTrashCan``)."""

_CAMEL: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NUMBER: Final = re.compile(r" \d+$")


def normalise(raw: str) -> str:
    """Return a raw label in lower case with single spaces: ``ArmChair``, ``arm_chair`` and ``arm#chair`` give ``arm
    chair``.
    """
    return " ".join(re.sub(r"[_#\s]+", " ", _CAMEL.sub(" ", raw)).lower().split())


@dataclass(frozen=True, slots=True)
class LabelEntry:
    """One canonical label.

    synonyms : other words for the same object; they may be canonical labels where sources draw the line differently
    hypernyms : all broader labels, transitively; ``headboard`` has ``bed``, since a speaker may call one a bed
    may_be : for a catch-all label, the labels that such an object could have; ``*`` for any
    least, most : bounds of the longest side in metres
    """

    label: str
    noun: str
    plural: str
    article: Literal["a", "an"]
    kind: Kind
    in_text: bool
    synonyms: frozenset[str]
    hypernyms: frozenset[str]
    may_be: frozenset[str] = frozenset()
    least: float = 0.0
    most: float = math.inf

    @property
    def words(self) -> frozenset[str]:
        """The label, its noun and its synonyms."""
        return self.synonyms | {self.label, self.noun}


@dataclass(frozen=True, slots=True)
class RoomEntry:
    """One canonical room type; `synonyms` are other words and labels that a speaker might use for it.

    general : its noun ("room") fits rooms of every type
    """

    label: str
    noun: str
    article: Literal["a", "an"]
    fit_for_text: bool
    synonyms: frozenset[str]
    general: bool = False


class Vocabulary:
    """Canonical labels of objects and rooms, and the mapping from each source's raw labels to them."""

    __slots__ = (
        "_containers",
        "_entries",
        "_frames",
        "_label_of_word",
        "_listed",
        "_may_be",
        "_overlapping",
        "_overlapping_rooms",
        "_raw",
        "_raw_rooms",
        "_rooms",
    )

    def __init__(
        self,
        entries: Iterable[LabelEntry],
        rooms: Iterable[RoomEntry],
        raw_labels: Mapping[tuple[str, str], str],
        raw_rooms: Mapping[tuple[str, str], str],
        may_be: Mapping[tuple[str, str], frozenset[str]] | None = None,
        containers: Mapping[str, ContainerKind | Literal[""]] | None = None,
        frames: Iterable[str] = (),
    ) -> None:
        self._entries = {e.label: e for e in entries}
        self._rooms = {r.label: r for r in rooms}
        self._containers = dict(containers or {})
        self._frames = frozenset(frames)
        self._raw = _with_normalised_keys(raw_labels)
        self._listed: dict[str, dict[str, str]] = defaultdict(dict)
        for (source, raw), label in self._raw.items():
            self._listed[source][raw] = label
        self._raw_rooms = _with_normalised_keys(raw_rooms)
        self._may_be = _with_normalised_keys(may_be or {})
        # A word that names exactly one label means that label; a synonym shared by several labels means none of them.
        named: defaultdict[str, set[str]] = defaultdict(set)
        for entry in self._entries.values():
            for word in entry.words:
                named[word].add(entry.label)
        only = {word: min(labels) for word, labels in named.items() if len(labels) == 1}
        self._label_of_word = only | {label: label for label in self._entries}
        self._overlapping = _overlaps(self._entries)
        self._overlapping_rooms = {
            a.label: frozenset(
                b.label for b in self._rooms.values() if (a.synonyms | {a.label}) & (b.synonyms | {b.label})
            )
            for a in self._rooms.values()
        }

    @property
    def labels(self) -> tuple[str, ...]:
        """All canonical object labels, sorted."""
        return tuple(sorted(self._entries))

    @property
    def nameless(self) -> frozenset[str]:
        """Labels that do not name a single object: building parts and catch-alls."""
        return frozenset(entry.label for entry in self._entries.values() if entry.kind != "object")

    @property
    def room_labels(self) -> tuple[str, ...]:
        """All canonical room types, sorted."""
        return tuple(sorted(self._rooms))

    def canonical(self, raw: str, family: str) -> str:
        """Return the canonical label of `raw`, or `raw` normalised if there is none."""
        return self._mapped(raw, family) or normalise(raw)

    def is_mapped(self, raw: str, family: str) -> bool:
        """Whether `raw` has a canonical label."""
        return self._mapped(raw, family) is not None

    def _mapped(self, raw: str, family: str) -> str | None:
        source = SOURCE_OF_FAMILY.get(family, "")
        text = normalise(raw)
        for key in (raw, text):
            label = self._raw.get((source, key))
            if label is not None:
                return label or None
        if source == "ai2thor":
            text = text.removeprefix(OBJAVERSE)
        # Labels made by users, and copies numbered by their author ("table 2").
        return self._label_of_word.get(text) or self._label_of_word.get(_NUMBER.sub("", text))

    def is_vague(self, label: str, family: str) -> bool:
        """Return whether an object with the canonical label `label` could be anything. This holds for the label
        ``unknown`` and for types that are in none of the tables.
        """
        return ANYTHING in self._written_may_be(label, family)

    def may_be(self, label: str, family: str, longest: float | None = None) -> frozenset[str]:
        """Return the labels that an object annotated with `label` could have instead; empty if `label` is specific.

        Parameters
        ----------
        label : the result of `canonical` for the object's raw label
        longest : the object's longest side in metres if known; labels whose size bounds exclude this side are left out
        """
        written = self._written_may_be(label, family)
        if ANYTHING in written:
            written = frozenset(e.label for e in self._entries.values() if e.kind == "object")
        if longest is None:
            return written
        return frozenset(one for one in written if self._entries[one].least <= longest <= self._entries[one].most)

    def _written_may_be(self, label: str, family: str) -> frozenset[str]:
        entry = self._entries.get(label)
        if entry is not None:
            return entry.may_be
        return self._may_be.get((SOURCE_OF_FAMILY.get(family, ""), label), frozenset((ANYTHING,)))

    def entry(self, label: str) -> LabelEntry:
        """Return the entry of a canonical label.

        Raises
        ------
        KeyError
            `label` is not canonical; it came from an unmapped raw label.
        """
        return self._entries[label]

    def fit_for_text(self, label: str) -> bool:
        """Return whether text may name `label`: it is an object, neither structure nor catch-all, with a countable
        noun.
        """
        entry = self._entries.get(label)
        return entry is not None and entry.in_text

    def is_structure(self, label: str) -> bool:
        """Return whether `label` is a part of the building, such as a wall or floor."""
        entry = self._entries.get(label)
        return entry is not None and entry.kind == "structure"

    def container(self, label: str) -> ContainerKind | None:
        """Return how objects with `label` hold others: ``shut`` if they can be closed, ``open`` if they can't, None if
        they are no containers.

        An unlisted label takes the value of its alphabetically first listed hypernym.
        """
        entry = self._entries.get(label)
        names = [label, *sorted(() if entry is None else entry.hypernyms)]
        return next((self._containers[name] or None for name in names if name in self._containers), None)

    def is_frame(self, label: str) -> bool:
        """Return whether objects with `label` are open frames, whose box does not hide what is in or on the frame. It
        is enough that a hypernym of `label` is listed as a frame; a ``shut`` container is never a frame.
        """
        entry = self._entries.get(label)
        names = {label} if entry is None else {label, *entry.hypernyms}
        return bool(names & self._frames) and self.container(label) != "shut"

    def overlapping(self, label: str) -> frozenset[str]:
        """Return the canonical labels that a speaker might mean by a word for `label`: itself, synonyms, hypernyms,
        hyponyms.

        The relation is symmetric. An unmapped label overlaps with itself only.
        """
        return self._overlapping.get(label, frozenset({label}))

    def room_type(self, raw: str, family: str) -> str:
        """Return the canonical room type of `raw`, or `raw` normalised if there is none.

        Matterport3D's one-letter labels are case-sensitive (``s`` stairs, ``S`` spa) and are looked up unchanged.
        """
        source = SOURCE_OF_FAMILY.get(family, "")
        text = normalise(raw)
        for key in (raw, text):
            label = self._raw_rooms.get((source, key))
            if label is not None:
                return label
        if text in self._rooms:
            return text
        named = [r.label for r in self._rooms.values() if text in r.synonyms]
        return named[0] if len(named) == 1 else text

    def room(self, label: str) -> RoomEntry:
        """Return the entry of a room type; for an unknown type, an entry that is not fit for text."""
        known = self._rooms.get(label)
        if known is not None:
            return known
        article: Literal["a", "an"] = "an" if label[:1] in "aeiou" else "a"
        return RoomEntry(label=label, noun=label, article=article, fit_for_text=False, synonyms=frozenset())

    def overlapping_rooms(self, label: str) -> frozenset[str]:
        """Return the room types that a speaker might mean by a word for `label`, itself included. The relation is
        symmetric.
        """
        return self._overlapping_rooms.get(label, frozenset({label}))

    def might_mean_room(self, label: str, other: str) -> bool:
        """Return whether a word for room type `label` might mean a room of type `other`, which may be an unknown type.

        "The room" may mean any room; "the kitchen" never means a room of unknown type.
        """
        return other in self.overlapping_rooms(label) or self.room(label).general

    def raw_labels(self, family: str) -> Mapping[str, str]:
        """Return each raw label listed for `family`'s source with its canonical label ('' means listed as unmapped)."""
        return self._listed.get(SOURCE_OF_FAMILY.get(family, ""), {})

    @classmethod
    def load(cls) -> Vocabulary:
        """Read the vocabulary from the tables of this package."""
        parents = {row["label"]: _several(row["hypernyms"]) for row in _rows("labels.csv")}
        entries = [
            LabelEntry(
                label=row["label"],
                noun=row["noun"],
                plural=row["plural"],
                article=cast(Literal["a", "an"], row["article"]),
                kind=cast(Kind, row["kind"]),
                in_text=row["in_text"] == "yes",
                synonyms=_several(row["synonyms"]),
                hypernyms=_ancestors(row["label"], parents),
                may_be=_several(row["may_be"]),
                least=float(row["least"] or 0.0),
                most=float(row["most"] or math.inf),
            )
            for row in _rows("labels.csv")
        ]
        rooms = [
            RoomEntry(
                label=row["label"],
                noun=row["noun"],
                article=cast(Literal["a", "an"], row["article"]),
                fit_for_text=row["in_text"] == "yes",
                synonyms=_several(row["synonyms"]),
                general=row["general"] == "yes",
            )
            for row in _rows("rooms.csv")
        ]
        listed = _rows("raw_labels.csv")
        raw = {(row["source"], row["raw_label"]): row["label"] for row in listed}
        may_be = {(row["source"], row["raw_label"]): _several(row["may_be"]) for row in listed if not row["label"]}
        raw_rooms = {(row["source"], row["raw_label"]): row["label"] for row in _rows("raw_rooms.csv")}
        containers = {row["label"]: cast(ContainerKind | Literal[""], row["kind"]) for row in _rows("containers.csv")}
        frames = [row["label"] for row in _rows("frames.csv")]
        return cls(entries, rooms, raw, raw_rooms, may_be, containers, frames)


def _rows(name: str) -> list[dict[str, str]]:
    text = files("condvln.labels").joinpath(name).read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def _several(cell: str) -> frozenset[str]:
    return frozenset(filter(None, cell.split(";")))


def _with_normalised_keys(raw: Mapping[tuple[str, str], T]) -> dict[tuple[str, str], T]:
    """Return `raw` with an additional entry for the normal form of each key, unless this form is already a key."""
    keys: dict[tuple[str, str], T] = {}
    for (source, text), label in raw.items():
        if len(text) > 1:  # for a one-letter label, case carries the meaning
            keys.setdefault((source, normalise(text)), label)
    return {**keys, **raw}


def _ancestors(label: str, parents: Mapping[str, frozenset[str]]) -> frozenset[str]:
    seen: set[str] = set()
    ahead = list(parents[label])
    while ahead:
        parent = ahead.pop()
        if parent not in seen:
            seen.add(parent)
            ahead.extend(parents[parent])
    return frozenset(seen)


def _overlaps(entries: Mapping[str, LabelEntry]) -> dict[str, frozenset[str]]:
    """Return, for each label, its hypernyms, its hyponyms and the labels that share a word with it."""
    sharing: defaultdict[str, set[str]] = defaultdict(set)
    for entry in entries.values():
        for word in entry.words:
            sharing[word].add(entry.label)
    found: dict[str, set[str]] = {label: {label} for label in entries}
    for entry in entries.values():
        for word in entry.words:
            found[entry.label] |= sharing[word]
        found[entry.label] |= entry.hypernyms
        for parent in entry.hypernyms:
            found[parent].add(entry.label)
    return {label: frozenset(labels) for label, labels in found.items()}
