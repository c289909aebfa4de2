"""Observability: from where the evidence for an instruction's conditions is visible.

The evidence for a true condition is a witness, and its anchor if it has one. The evidence for a false one is almost the
whole floor of the room; or, if the room has objects of that label without the stated relation, all such objects that
can be seen at all, and the anchor. Only conditions on the gold path count, since the agent evaluates no others.

An object must be recognised from one place (:class:`condvln.navigation.sight.Recognition`). Of a floor each point must
be visible from some place so near that a usual object with the label would be recognised there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from condvln.arrays import F64, Bools
from condvln.episodes.floor import floor_points
from condvln.episodes.footprint import Obstacles
from condvln.episodes.goals import wide_islands
from condvln.episodes.placing import Outlook
from condvln.episodes.view import SceneView
from condvln.instructions.absence import absence_range
from condvln.instructions.referents import things_meant
from condvln.kept import kept
from condvln.labels import vocabulary
from condvln.navigation.protocol import PathfinderProtocol
from condvln.navigation.sight import EDGE, Recognition, SightTarget, View, eyes_at, in_view, visible_extent
from condvln.scene import Scene
from condvln.scene.scene import EVERYTHING_SEEN, Sightings
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import EYE_SPACING, LEVEL_CAMERA, PREFIX_SAMPLES, PREFIX_STRAY
from schemas.episode import Evidence, Observability
from schemas.program import Condition, Program

__all__ = ["FIRST_VIEW", "Observation", "Observer", "SightNeed", "common_prefix", "places_at", "row_by_row"]

DIGITS: Final = 2
"""Decimals of published degrees."""
FIRST_VIEW: Final = "O0f"
"""The name by which a cell asks for O0 with all evidence in the first view."""
LEVELS: Final[tuple[Observability, ...]] = ("O0", "O1", "O2")
"""Levels in order: from visible at the start to visible only with a detour."""

SightNeed = tuple[str, str, float]
"""What must be seen: ("object", object id, 0) or ("floor", room id, metres up to which its points count as seen)."""
_Needs = tuple[frozenset[SightNeed], ...]
"""Alternative sets of targets that reveal a condition's truth: one whole set must be seen."""


@dataclass(frozen=True, slots=True)
class Observation:
    """The observability of an episode: the worst level over the conditions on its gold path.

    in_view : all evidence lies in the first view, 79° × 63° (O0f, a part of O0)
    approximate : boxes were used where surfaces are not known
    """

    evidence: tuple[Evidence, ...]
    approximate: bool

    @property
    def observability(self) -> Observability:
        """The worst level over all conditions."""
        return max((e.observability for e in self.evidence), key=LEVELS.index)

    @property
    def in_view(self) -> bool:
        """Whether an agent sees all evidence in its first view, without turning."""
        return all(e.in_view for e in self.evidence)

    def fits(self, asked: str) -> bool:
        """Return whether this observation has the level that a cell asks for, `asked`. The level O0f means O0 with all
        evidence in the first view.
        """
        return self.in_view if asked == FIRST_VIEW else self.observability == asked


class Observer:
    """Computes the observability of placed programs of one scene; each line of sight is computed once."""

    def __init__(
        self,
        scene: Scene,
        view: SceneView,
        pathfinder: PathfinderProtocol,
        places: PlacesConfig,
        rules: EpisodeConfig,
        obstacles: Obstacles = (),
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self._scene, self._view, self._pathfinder = scene, view, pathfinder
        self._sightings = sightings
        self._places, self._rules = places, rules
        self.obstacles, self._islands = obstacles, wide_islands(pathfinder, places)
        # What the level camera of the first view recognises if it turns through 360°. The floor at the agent's feet has
        # no limit, since nothing can be there.
        self.rule = Recognition.of(places, rules)
        self._front = View(places.sight_range, *LEVEL_CAMERA)
        self._targets: dict[tuple[str, str], SightTarget | None] = {}
        self._degrees: dict[SightNeed, dict[bytes, float]] = {}
        self._seen: dict[SightNeed, dict[bytes, Bools]] = {}

    def observe(self, program: Program, outlook: Outlook) -> Observation:
        """Return the observation of a placed program."""
        start = eyes_at(outlook.start, self._places.eye_height).reshape(1, 3)
        on_the_way: dict[tuple[int, ...], F64] = {}
        sharing = _sharing(program)
        evidence = []
        for k in sorted(set(program.route()[0])):
            ways = self.needs(program.conditions[k])
            known, degrees = self._known(ways, start)
            if known:
                in_view = any(all(self._is_ahead(name, start, outlook.yaw) for name in way) for way in ways)
                evidence.append(Evidence(condition=k, observability="O0", in_view=in_view, degrees=degrees))
                continue
            # Only what is not known at the start is looked for on the way.
            leaves = sharing[k]
            if leaves not in on_the_way:
                on_the_way[leaves] = self._eyes_on_the_way(outlook, leaves)
            known, degrees = self._known(ways, on_the_way[leaves])
            found: Observability = "O1" if known else "O2"
            best = degrees if known else self._from_anywhere(ways)
            evidence.append(Evidence(condition=k, observability=found, in_view=False, degrees=best))
        return Observation(tuple(evidence), self._view.approximate)

    def _eyes_on_the_way(self, outlook: Outlook, leaves: Sequence[int]) -> F64:
        points = spaced_points(common_prefix([outlook.paths[leaf] for leaf in leaves]), EYE_SPACING)
        points[0] = outlook.start
        return eyes_at(points, self._places.eye_height)

    def needs(self, condition: Condition) -> _Needs:
        """Return alternative sets of sight targets. To know a condition's truth, an agent must see all targets of at
        least one set.
        """
        room = condition.room.room_id
        anchor = () if condition.qualifier is None else [_object(name) for name in condition.qualifier.anchor_ids]
        if condition.truth:
            return tuple(frozenset({_object(witness), *anchor}) for witness in condition.witnesses)
        whole: _Needs = (frozenset({("floor", room, absence_range(condition.label, self._places))}),)
        if condition.qualifier is None:
            return whole
        there = [_object(name) for name in self._meant(room, condition.label)]
        return (frozenset({*there, *anchor}), *whole) if there else whole

    def either_way(self, condition: Condition) -> frozenset[SightNeed]:
        """Return what an agent must see to know a condition's truth, if it can't tell beforehand what the truth is: all
        things that may be meant, with the anchor; the floor if nothing may be, or if the question is whether there is a
        thing at all.
        """
        room = condition.room.room_id
        things = {_object(name) for name in self._meant(room, condition.label)}
        floor = {("floor", room, absence_range(condition.label, self._places))}
        anchors = () if condition.qualifier is None else condition.qualifier.anchor_ids
        asks_if_any = condition.qualifier is None or not things
        return frozenset({*things, *map(_object, anchors), *(floor if asks_if_any else ())})

    def shows(self, need: SightNeed, eyes: F64) -> Bools:
        """Return a mask (n,) of the eyes (n, 3) from each of which one sees an object, or enough of a floor."""
        if need[0] == "object":
            return np.asarray(self.degrees(need, eyes) > 0.0)
        known = self.target(need) is not None
        return (
            np.asarray(self.floor_in_view(need, eyes).mean(axis=1) >= self._rules.floor_seen)
            if known
            else (np.zeros(len(eyes), bool))
        )

    @kept
    def _meant(self, room_id: str, label: str) -> tuple[str, ...]:
        """Return the ids of the visible objects that a word for `label` might mean in a room. Unlabelled objects are
        included.
        """
        found = things_meant(self._scene, room_id, label, vocabulary, self._sightings)
        return tuple(found)

    def target(self, name: SightNeed) -> SightTarget | None:
        """Return the sight target of a piece of evidence; None for a room whose floor is unknown."""
        kind, key, _ = name
        if (kind, key) not in self._targets:
            if kind == "object":
                self._targets[kind, key] = self._view.target(key)
            else:
                room = self._scene.room_of[key]
                points = floor_points(self._scene, room, self._pathfinder, self._islands, self.obstacles)
                self._targets[kind, key] = SightTarget(points) if len(points) else None
        return self._targets[kind, key]

    def around(self, name: SightNeed) -> View:
        """Return the view of a piece of evidence by a camera that turns through 360°."""
        kind, _, metres = name
        return self.rule.view if kind == "object" else View(range=max(metres, EDGE))

    def _known(self, ways: _Needs, eyes: F64) -> tuple[bool, float | None]:
        """Return whether a condition's truth can be known from the `eyes` (n, 3) together, looking all around, and how
        large the evidence appears at least (None for a floor). Each of the `ways` is a set of evidence that suffices to
        know the truth; all evidence of at least one set must be visible.
        """
        best: list[float] = []
        known = False
        for way in ways:
            if all(self._covered(name, eyes) for name in way if name[0] == "floor"):
                objects = [float(self.degrees(name, eyes).max()) for name in way if name[0] == "object"]
                if all(objects):
                    known = True
                    best += [min(objects)] if objects else []
        return known, round(max(best), DIGITS) if best else None

    def _from_anywhere(self, ways: _Needs) -> float | None:
        """Return how large the objects of the best of the `ways` appear from the best places of their rooms; None if no
        way has only objects that are recognised from there.
        """
        known = self._sightings.degrees
        best = [min(known.get(name, 0.0) for _, name, _ in way) for way in ways if all(n[0] == "object" for n in way)]
        return max(best, default=0.0) or None

    def _covered(self, name: SightNeed, eyes: F64) -> bool:
        """Return whether enough of a floor is visible from the `eyes` (n, 3) together."""
        target = self.target(name)
        if target is None:
            return False
        return bool(self.floor_in_view(name, eyes).any(axis=0).mean() >= self._rules.floor_seen)

    def _is_ahead(self, name: SightNeed, eye: F64, yaw: float) -> bool:
        """Return whether a piece of evidence is recognised from one eye (1, 3) in the view straight ahead."""
        target = self.target(name)
        if target is None:
            return False
        seen = in_view(eye, target.samples, self._front, [yaw])
        if name[0] == "floor":
            return bool((seen & self.floor_in_view(name, eye)).mean() >= self._rules.floor_seen)
        seen &= self._view.seen(eye, target, self.rule.view)
        return bool(self.rule.holds(seen, visible_extent(eye, target.samples, seen))[0])

    def degrees(self, name: SightNeed, eyes: F64) -> F64:
        """Return how large an object appears from each of the eyes (n, 3), in any direction: (n,) degrees, 0 where it
        is not recognised; see `SceneView.degrees`.
        """
        known = self._degrees.setdefault(name, {})
        return np.array(row_by_row(known, eyes, lambda new: self._view.degrees(new, name[1], self.rule)))

    def floor_in_view(self, name: SightNeed, eyes: F64) -> Bools:
        """Return a mask (n, k): whether each point of a known floor is visible from each of the eyes (n, 3), near
        enough to recognise there what the evidence asks for.
        """
        target = self.target(name)
        assert target is not None, "the floor is known"
        known = self._seen.setdefault(name, {})
        found = row_by_row(known, eyes, lambda new: self._view.seen(new, target, self.around(name)))
        return np.array(found, bool).reshape(len(eyes), len(target.samples))


def row_by_row(known: dict[bytes, Any], places: F64, find: Callable[[F64], Iterable[Any]]) -> list[Any]:
    """Return what `find` finds for each of some places (n, 3). `known` keeps it; nothing is looked for twice."""
    keys = [place.tobytes() for place in places]
    new = {key: k for k, key in enumerate(keys) if key not in known}
    if new:
        known.update(zip(new, find(places[list(new.values())]), strict=True))
    return [known[key] for key in keys]


def _object(name: str) -> SightNeed:
    return ("object", name, 0.0)


def _sharing(program: Program) -> dict[int, tuple[int, ...]]:
    """Return for each condition the leaves to which the last lead before it leads, whose paths have that lead in
    common; all leaves if there is none.
    """
    numbers = range(len(program.leaves))
    below: dict[int, tuple[int, ...]] = {-1 - leaf: (leaf,) for leaf in numbers}
    for at in reversed(range(len(program.branches))):
        below[at] = below[program.branches[at].then] + below[program.branches[at].otherwise]
    found, here = dict[int, tuple[int, ...]](), {0: tuple(numbers)}
    for at, branch in enumerate(program.branches):  # a branch comes before those below it
        leaves = here[at] if branch.lead is None else tuple(sorted(below[at]))
        found[branch.condition] = here[branch.then] = here[branch.otherwise] = leaves
    return found


def common_prefix(paths: Sequence[F64]) -> F64:
    """Return the shared beginning (n, 3) of several paths from one start; at least the start itself.

    It ends where two paths are farther than PREFIX_STRAY apart at equal walked length.
    """
    shortest = min(_walked(path)[-1] for path in paths)
    at = np.append(np.arange(0.0, shortest, PREFIX_SAMPLES), shortest)
    places = np.array([places_at(path, at) for path in paths])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1).max(axis=(0, 1)) > PREFIX_STRAY
    last = max(int(np.argmax(apart)) if apart.any() else len(at), 1) - 1
    walked = _walked(paths[0])
    inner = (walked > 0.0) & (walked < at[last])
    return np.concatenate([paths[0][:1], paths[0][inner], places[0][[last]]])


def spaced_points(path: F64, spacing: float) -> F64:
    """Return points (n, 3) along a polyline at equal distances of at most ``spacing`` metres, both ends included."""
    length = _walked(path)[-1]
    return places_at(path, np.linspace(0.0, length, max(1, math.ceil(length / spacing)) + 1))


def _walked(path: F64) -> F64:
    """Return the metres walked (n,) at each corner of a path."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])


def places_at(path: F64, at: F64) -> F64:
    """Return the points (k, 3) of a path at which `at` (k,) metres are walked."""
    walked = _walked(path)
    return np.column_stack([np.interp(at, walked, path[:, axis]) for axis in range(3)])
