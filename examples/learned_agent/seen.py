"""What the agent sees and remembers, as numbers: the words of the instruction, and the things seen so far."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache

import numpy as np
from space import SPACE, Space

from condvln.labels import vocabulary
from condvln.sensors import TextObservation

LABELS = ("", "<visited>", "<bump>", "<edge>", *sorted(vocabulary.labels))
NOUNS = ("", "", "", "", *(vocabulary.entry(label).noun for label in LABELS[4:]))
"""The word of each label in texts."""
ROOMS = ("", *sorted(vocabulary.room_labels))
LABEL_NUMBER = {name: k for k, name in enumerate(LABELS)}
ROOM_NUMBER = {name: k for k, name in enumerate(ROOMS)}
VISITED, BUMP, EDGE = 1, 2, 3

KEPT = 16
"""Number of remembered things in a frame; those that the text mentions come first, then those in view."""
FEATURES = 14
OWN = 5 + SPACE
SAME = 1.5
"""Metres between two sightings of one label that count as one thing."""
START = 4
"""Last action before the first one."""

_WORD = re.compile(r"[a-z0-9]+(?:'[a-z]+)?|[.,;:?]")


def words_of(text: str) -> list[str]:
    """Return the words and stops of a text in lower case."""
    return _WORD.findall(text.lower())


@cache
def _names() -> dict[str, list[tuple[tuple[str, ...], int, int]]]:
    """Return by first word: all words of a name, its label's number and its room's number, the longest name first."""
    found: dict[tuple[str, ...], list[int]] = {}
    for number, noun in enumerate(NOUNS[4:], 4):
        found.setdefault(tuple(words_of(noun)), [0, 0])[0] = number
    for number, room in enumerate(ROOMS[1:], 1):
        found.setdefault(tuple(words_of(room)), [0, 0])[1] = number
    by_first: dict[str, list[tuple[tuple[str, ...], int, int]]] = {}
    for words, (label, room) in sorted(found.items(), key=lambda one: -len(one[0])):
        by_first.setdefault(words[0], []).append((words, label, room))
    return by_first


@dataclass(frozen=True, eq=False)
class Text:
    """An instruction; for each word, the label and the room that it is part of the name of (0 for none)."""

    words: list[str]
    label: np.ndarray
    room: np.ndarray

    @classmethod
    def of(cls, text: str) -> Text:
        """Read a text; of two names that begin at a word, the longer one counts."""
        words = words_of(text)
        label, room = np.zeros((2, len(words)), np.int64)
        at = 0
        while at < len(words):
            for name, of_label, of_room in _names().get(words[at], ()):
                if tuple(words[at : at + len(name)]) == name:
                    label[at : at + len(name)], room[at : at + len(name)] = of_label, of_room
                    at += len(name) - 1
                    break
            at += 1
        return cls(words, label, room)


@dataclass(frozen=True, eq=False)
class Frame:
    """What the network gets at one step.

    label, room : (KEPT,) of the things; features : (KEPT, FEATURES); own : (OWN,) of the agent; place : its room and
    last action
    """

    label: np.ndarray
    room: np.ndarray
    features: np.ndarray
    own: np.ndarray
    place: tuple[int, int]


class Memory:
    """The things seen so far in an episode, the places visited, and where the agent bumped into something.

    It knows what the text sensor and the scanner say and the agent's own pose, and nothing else.
    """

    def __init__(self, text: Text) -> None:
        self._labels, self._rooms = set(text.label[text.label > 0].tolist()), set(text.room[text.room > 0].tolist())
        self._things: list[list[float]] = []  # label, room, x, z, step of the last sighting
        self._space = Space()
        self._step = 0
        self._heading: float | None = None

    def see(
        self, seen: TextObservation, scanned: np.ndarray, place: np.ndarray, heading: float, collided: bool, last: int
    ) -> Frame:
        """Add what is seen from a pose after an action, and return the frame."""
        x, z, here = float(place[0]), float(place[2]), ROOM_NUMBER.get(seen.room or "", 0)
        if self._heading is None:
            self._heading = heading
        for thing in seen.things:
            angle = heading - math.radians(thing.bearing)
            there = x - math.sin(angle) * thing.distance, z - math.cos(angle) * thing.distance
            self._add(LABEL_NUMBER[thing.label], ROOM_NUMBER.get(thing.room or "", 0), *there, SAME)
        self._add(VISITED, here, x, z, 1.0)
        if collided:
            self._add(BUMP, 0, x - math.sin(heading) * 0.3, z - math.cos(heading) * 0.3, 0.2)
        turned = heading - self._heading
        own = [math.sin(turned), math.cos(turned), self._step / 100, collided, len(self._things) / 20]
        around = self._space.see(scanned, x, z, heading, collided)
        frame = self._frame(x, z, heading, here)
        self._step += 1
        return Frame(*frame, np.array([*own, *around], np.float32), (here, last))

    def _add(self, label: int, room: int, x: float, z: float, same: float) -> None:
        near, best = None, same
        for known in self._things:
            if known[0] == label and known[1] == room:
                apart = math.hypot(known[2] - x, known[3] - z)
                if apart <= best:
                    near, best = known, apart
        if near is None:
            self._things.append([label, room, x, z, self._step])
        else:
            # A place visited keeps its position, so that the trail has one every metre.
            near[2:] = [near[2], near[3], self._step] if label == VISITED else [x, z, self._step]

    def _edges(self) -> list[list[float]]:
        """Return where the known free space ends, as things of the room of the nearest thing."""
        found: list[list[float]] = []
        for x, z in self._space.edges():
            near = min(self._things, key=lambda one: math.hypot(one[2] - x, one[3] - z))
            room = near[1] if math.hypot(near[2] - x, near[3] - z) < 2.5 else 0
            found.append([EDGE, room, x, z, self._step])
        return found

    def _frame(self, x: float, z: float, heading: float, here: int) -> tuple[np.ndarray, ...]:
        all_of = np.array([*self._things, *self._edges()])
        label, room = all_of[:, 0].astype(np.int64), all_of[:, 1].astype(np.int64)
        across, along = all_of[:, 2] - x, all_of[:, 3] - z
        sine, cosine = math.sin(heading), math.cos(heading)
        right, ahead = across * cosine - along * sine, -across * sine - along * cosine
        far = np.maximum(np.hypot(right, ahead), 1e-3)
        age = self._step - all_of[:, 4]
        is_thing = label > EDGE
        named = is_thing & np.isin(label, [*self._labels])
        rank = 4.0 * named + 2.0 * (is_thing & (age == 0)) + 1.0 * np.isin(room, [*self._rooms]) + 1.5 * ~is_thing
        rank[~is_thing & (far > 4)] = 0
        rank[label == EDGE] = 3.5
        order = np.lexsort((age, far, -rank))[:KEPT]
        way, way_x, way_z = self._space.ways(all_of[:, 2], all_of[:, 3])
        gap = np.full(len(label), 9.0)
        mentioned = np.flatnonzero(named)
        if len(mentioned) > 1:
            places = all_of[mentioned, 2:4]
            between = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
            between[label[mentioned][:, None] == label[mentioned][None]] = 9.0
            gap[mentioned] = between.min(axis=1)
        columns = [right / far, ahead / far, np.minimum(far, 10) / 5, np.exp(-far), np.exp(-far / 3), age == 0]
        columns += [np.minimum(age, 60) / 60, np.exp(-gap), (room == here) & (room > 0), named]
        columns += [np.minimum(way, 15) / 5, np.exp(-way)]
        columns += [way_x * cosine - way_z * sine, -way_x * sine - way_z * cosine]
        features = np.stack(columns, axis=1)
        out_label, out_room = np.zeros((2, KEPT), np.int64)
        out = np.zeros((KEPT, FEATURES), np.float32)
        count = len(order)
        out_label[:count], out_room[:count], out[:count] = label[order], room[order], features[order]
        return out_label, out_room, out
