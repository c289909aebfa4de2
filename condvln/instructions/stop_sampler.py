"""The rooms and the stops of programs: which objects leaves lead to, and by which other objects.

A set of targets is an integer: bit k is 1 if target k is in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import accumulate
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.instructions.conflicts import members
from condvln.instructions.degeneracy import GivenUp
from condvln.instructions.stops import Targets
from condvln.seeding import Draws
from schemas.config.constants import MOST_ROOMS, PLAIN_ROOM_WEIGHT
from schemas.episode import Composition

__all__ = ["ROOM_SPANS", "LabelWeights", "StopSampler"]

ROOM_SPANS: Final[Mapping[Composition, tuple[int, int]]] = {"C0": (1, 1), "C1": (2, 2), "C2": (3, MOST_ROOMS)}
"""Least and most rooms of a program, by its composition."""

SEARCHED: Final = 500
"""Number of targets searched to find out whether a program fits, after which it counts as fitting."""

REJECTIONS: Final = 2
"""Number of labels drawn without checking before the remaining ones are counted; both give the same distribution."""


class LabelWeights:
    """Labels with the weights with which they are drawn. `members` are the targets of each label."""

    def __init__(self, weights: Mapping[str, float], members: Mapping[object, int]) -> None:
        self.labels, self.weights = [*weights], [*weights.values()]
        self.sums = [*accumulate(self.weights)]
        self.members = [members[label] for label in weights]
        self.targets = sum(self.members)


class StopSampler:
    """Draws the rooms and stops of programs of one scene.

    The rooms of a program have different types: a listener would confuse "the bedroom with the desk" and "the bedroom
    with the plant", and a text with only one bedroom needs no distinguishing object. Rooms that are named by their
    label alone are preferred. Goals have different labels and are pairwise apart, and so are the stops of a leaf;
    rarely used labels are preferred as goals. No word names stops in two rooms.

    Parameters
    ----------
    types : type of each room that has a name, by room id
    plain : ids of the rooms that are named by their label alone
    asked : ids of the rooms about which conditions can be asked
    is_left_by : whether a room can still be asked about, by its id, if a text has a stop, by its room id and label

    Attributes
    ----------
    targets : the targets, by their numbers
    weights : weight of each label of a target
    kinds : number of types of rooms
    plain : the targets with a name without a compass word
    """

    def __init__(
        self,
        found: Targets,
        types: Mapping[str, str],
        plain: Collection[str],
        asked: Sequence[str],
        is_left_by: Callable[[str, tuple[str, str]], bool],
    ) -> None:
        self.targets, self._types, self._plain, self._asked = found.targets, types, frozenset(plain), asked
        self.weights: dict[str, float] = {}
        for target in found.targets:
            self.weights[target.label] = max(target.weight, self.weights.get(target.label, 0.0))
        self.kinds = len(set(types.values()))
        self._apart, self._alike = _sets(found.apart), _sets(found.alike)
        self._of_label = self._grouped(target.label for target in found.targets)
        self._of_object = self._grouped(target.object_id for target in found.targets)
        self._clear = self._grouped(target.clear for target in found.targets).get(True, 0)
        self.plain = self._grouped(target.plain for target in found.targets).get(True, 0)
        self._held = dict.fromkeys(types, 0) | self._grouped(target.room_id for target in found.targets)
        kinds = [*dict.fromkeys(types.values())]
        self._by_type = sorted(types, key=lambda room_id: kinds.index(types[room_id]))
        self._spoiling = {room_id: self._spoilers(room_id, is_left_by) for room_id in types}
        self._waypoints = LabelWeights(self.weights, self._of_label)
        self._answers: dict[tuple[int, int, int, int], bool] = {}
        self._known_roomy: dict[tuple[int, int], list[str]] = {}

    def _grouped(self, keys: Iterable[object]) -> dict[object, int]:
        """Return the set of the targets with each key; `keys` has the key of each target."""
        found: dict[object, int] = {}
        for k, key in enumerate(keys):
            found[key] = found.get(key, 0) | 1 << k
        return found

    def _spoilers(self, room_id: str, is_left_by: Callable[[str, tuple[str, str]], bool]) -> int:
        """Return the targets that leave nothing to ask about a room: all, if nothing is asked about it in any case."""
        leaves = cache(partial(is_left_by, room_id))
        spoils = (room_id not in self._asked or not leaves((t.room_id, t.label)) for t in self.targets)
        return self._grouped(spoils).get(True, 0)

    def fits(self, leaves: int) -> bool:
        """Return whether the scene has targets for so many leaves."""
        everything = (1 << len(self.targets)) - 1
        return self._fit(everything, everything, leaves, 0)

    def roomy(self, leaves: int, waypoints: int = 0) -> list[str]:
        """Return the rooms about which conditions can be asked and that have targets for so many leaves, and then for
        so many waypoints of one leaf.
        """
        key = (leaves, waypoints)
        if key not in self._known_roomy:
            self._known_roomy[key] = [
                room_id
                for room_id in self._asked
                if self._fit(self._held[room_id], self._held[room_id], leaves, 0)
                and self._fit(self._held[room_id], self._held[room_id], leaves, waypoints)
            ]
        return self._known_roomy[key]

    def impossible(self, composition: Composition | None, moves: Sequence[int]) -> str | None:
        """Return the reason why no program of a composition has leaves with these numbers of moves; None if there may
        be one.
        """
        if composition is None or self.kinds < ROOM_SPANS[composition][0]:
            return "no_targets"
        if composition == "C0" and not self.roomy(len(moves), max(moves) - 1):
            return "no_waypoint" if self.roomy(len(moves)) else "no_targets"
        return None

    def goal_weights(self, used: Counter[str], cap: float) -> LabelWeights:
        """Return the labels that may be goals. A label is drawn more often the less it was `used`, and not at all once
        it is a goal `cap` times.
        """
        weights = {x: weight / (1 + used[x]) for x, weight in self.weights.items() if used[x] + 1 <= cap}
        return LabelWeights(weights, self._of_label)

    def draw_rooms(
        self, composition: Composition, moves: Sequence[int], draws: Draws, asked: Collection[str] | None = None
    ) -> tuple[list[str], int]:
        """Return the ids of the rooms of a program, and the targets there that leave something to ask. The first room
        is one of `asked`.

        Raises
        ------
        GivenUp : the draw can't be completed
        """
        rooms, held = self._rooms(composition, moves, draws, asked)
        spoilers = held
        for room_id in rooms:
            spoilers &= self._spoiling[room_id]
        return rooms, held & ~spoilers

    def _rooms(
        self, composition: Composition, moves: Sequence[int], draws: Draws, asked: Collection[str] | None
    ) -> tuple[list[str], int]:
        """Return rooms of different types that together have targets for all stops, and these targets.

        Conditions can be asked about the first room. The others are named by their label alone if enough such rooms are
        left, so that a text hardly ever has two rooms like "the bedroom with the piano".
        """
        (least, most), n, waypoints = ROOM_SPANS[composition], len(moves), max(moves) - 1
        first = self._asked if most > 1 else self.roomy(n, waypoints)
        if asked is not None:
            first = [room_id for room_id in first if room_id in asked]
            if not first:
                raise GivenUp("no_condition")
        weights = [PLAIN_ROOM_WEIGHT if room_id in self._plain else 1.0 for room_id in first]
        rooms = [draws.weighted(first, weights)]
        held = self._held[rooms[0]]
        while len(rooms) < most:
            kinds = {self._types[room_id] for room_id in rooms}
            ahead = [room_id for room_id in self._by_type if self._types[room_id] not in kinds]
            enough = len(rooms) >= least and self._plain.isdisjoint(ahead) and self._fit(held, held, n, waypoints)
            if not ahead or enough:
                break
            if len(rooms) == most - 1:
                joined = ((room_id, held | self._held[room_id]) for room_id in ahead)
                ahead = [room_id for room_id, both in joined if self._fit(both, both, n, waypoints)]
                if not ahead:
                    raise GivenUp("no_waypoint" if waypoints else "no_targets")
            rooms.append(draws.choice([room_id for room_id in ahead if room_id in self._plain] or ahead))
            held |= self._held[rooms[-1]]
        return rooms, held

    def draw_goals(
        self, n: int, waypoints: int, held: int, weights: LabelWeights, draws: Draws, wishes: Sequence[int] = ()
    ) -> list[int]:
        """Return one goal for each of `n` leaves. They have different labels and are pairwise apart, and enough targets
        are left for the waypoints of the longest leaf.

        wishes : the targets that are wished as the goal of each leaf, which others replace where none of them is left

        Raises
        ------
        GivenUp : the draw can't be completed
        """
        unused, free = held & weights.targets, held
        if not self._fit(unused, unused, n, 0):
            raise GivenUp("label_over_cap" if self._fit(held, held, n, 0) else "no_targets")
        if not self._fit(unused, free, n, waypoints):
            raise GivenUp("no_waypoint")
        goals: dict[int, int] = {}
        # First the leaves with the fewest wishes that are left, then those without.
        wished = sorted((k for k, wish in enumerate(wishes) if wish), key=lambda k: (wishes[k] & unused).bit_count())
        for leaf, wish in [*((k, wishes[k]) for k in wished), *((k, -1) for k in range(n))]:
            if leaf in goals:
                continue
            allowed = unused & wish
            while (target := self._preferred(allowed, weights, draws)) is not None:
                rest, spare = self._beside(unused, target), free & self._apart[target]
                if self._fit(rest, spare, n - len(goals) - 1, waypoints):
                    goals[leaf], unused, free = target, rest, spare
                    break
                allowed &= ~(1 << target)
            if target is None and wish == -1:  # all were tried, so that no search is needed to know it
                self._answers[unused, free if waypoints else 0, n - len(goals), waypoints] = False
                raise GivenUp("no_waypoint" if waypoints else "no_targets")
        return [goals[leaf] for leaf in range(n)]

    def draw_leaves(self, moves: Sequence[int], goals: Sequence[int], held: int, draws: Draws) -> list[list[int]]:
        """Return the stops of all leaves. Some leaves may begin with the same stop if no other stop is left, but never
        more than half of them.

        Raises
        ------
        GivenUp : the draw can't be completed
        """
        for goal in goals:
            held &= self._apart[goal]
        leaves: list[list[int]] = []
        firsts = 0
        for goal, count in zip(goals, moves, strict=True):
            leaf = self._leaf(goal, count, held, firsts, draws)
            firsts |= 1 << leaf[0]
            for waypoint in leaf[:-1]:
                held &= ~self._alike[waypoint]
            leaves.append(leaf)
        if max(Counter(leaf[0] for leaf in leaves).values()) > (len(leaves) + 1) // 2:
            raise GivenUp("one_first_stop")
        return leaves

    def named(self, leaves: Iterable[Iterable[int]]) -> set[tuple[str, str]]:
        """Return the room id and the label of each stop."""
        return {(self.targets[k].room_id, self.targets[k].label) for leaf in leaves for k in leaf}

    def of_labels(self, labels: Iterable[str]) -> int:
        """Return the targets with one of some labels."""
        found = 0
        for label in labels:
            found |= self._of_label.get(label, 0)
        return found

    def in_room(self, room_id: str) -> int:
        """Return the targets in a room."""
        return self._held.get(room_id, 0)

    def of_object(self, object_id: str) -> int:
        """Return the target that is an object, as a set; an empty one if it is none."""
        return self._of_object.get(object_id, 0)

    def _leaf(self, goal: int, count: int, held: int, firsts: int, draws: Draws) -> list[int]:
        """Return the stops of one leaf: `count` - 1 waypoints that are apart from one another, then `goal`. The first
        waypoint is one of `firsts`, the stops with which other leaves begin, only if no other target is left.
        """
        left = held & ~self._of_label[self.targets[goal].label]
        leaf: list[int] = []
        while len(leaf) < count - 1:
            fresh = left if leaf else left & ~firsts
            target = self._preferred(fresh, self._waypoints, draws)
            if target is None:
                target = self._preferred(left, self._waypoints, draws)
            if target is None:
                raise GivenUp("no_waypoint")
            leaf.append(target)
            left = self._beside(left, target)
        room_of = [self.targets[k].room_id for k in (*leaf, goal)]
        if count == 3 and room_of[0] == room_of[2] != room_of[1]:
            leaf.reverse()  # stops never return to a room
        return [*leaf, goal]

    def _beside(self, allowed: int, target: int) -> int:
        """Return those of the `allowed` targets that are apart from `target` and have another label."""
        return allowed & self._apart[target] & ~self._of_label[self.targets[target].label]

    def _preferred(self, allowed: int, weights: LabelWeights, draws: Draws) -> int | None:
        """Return one of the `allowed` targets, if possible one with a clear name; None if there is none."""
        target = self._drawn(allowed & self._clear, weights, draws)
        return self._drawn(allowed, weights, draws) if target is None else target

    def _drawn(self, allowed: int, weights: LabelWeights, draws: Draws) -> int | None:
        """Return one of the `allowed` targets, or None: first a label by its weight, then one of its targets."""
        if not allowed or not weights.labels:
            return None
        for _ in range(REJECTIONS):
            own = allowed & weights.members[draws.cumulative(weights.sums)]
            if own:
                break
        else:
            there = [k for k, one in enumerate(weights.members) if allowed & one]
            if not there:
                return None
            own = allowed & weights.members[draws.weighted(there, [weights.weights[k] for k in there])]
        return draws.choice([*members(own)]) if own & (own - 1) else own.bit_length() - 1

    def _fit(self, allowed: int, free: int, n: int, waypoints: int) -> bool:
        """Return whether `allowed` contains targets for `n` leaves, and `free` more for the `waypoints` of the longest
        one. They have different labels and are apart from each other, and the waypoints are apart from all goals.
        Answers are kept, since draws ask again and again.
        """
        if not waypoints:
            free = 0
            if n < 2:
                return n < 1 or allowed > 0
        key = (allowed, free, n, waypoints)
        if key not in self._answers:
            self._answers[key] = self._search(allowed, free, n, waypoints, [SEARCHED])
        return self._answers[key]

    def _search(self, allowed: int, free: int, n: int, waypoints: int, budget: list[int]) -> bool:
        """Return `_fit`; `budget` is how many targets may be tried yet, after which the result is True."""
        if n == 0:
            if not waypoints:
                return True
            return self._search(free, 0, waypoints, 0, [SEARCHED])
        if allowed.bit_count() < n:
            return False
        for target in members(allowed):
            budget[0] -= 1
            if budget[0] < 0:
                return True
            allowed &= ~(1 << target)  # every set with this target is searched now
            if self._search(self._beside(allowed, target), free & self._apart[target], n - 1, waypoints, budget):
                return True
            if allowed.bit_count() < n:
                return False
        return False


def _sets(table: NDArray[np.bool_]) -> list[int]:
    """Return each row of a table of booleans as a set."""
    return [int.from_bytes(np.packbits(row, bitorder="little").tobytes(), "little") for row in table]
