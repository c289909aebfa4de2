"""Observability: from where the evidence for an instruction's conditions is visible.

The evidence for a true condition is a witness, and its anchor if it has one. The evidence for a false one is almost the
whole floor of the room; or, if the room has objects of that label without the stated relation, all such objects that
can be seen at all, and the anchor. Only conditions on the gold path count, since the agent evaluates no others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.episodes.floor import floor_points
from condvln.episodes.footprint import Footprint
from condvln.episodes.goals import wide_islands
from condvln.episodes.kernels.prefix import shared_beginning, spaced_points
from condvln.episodes.placing import Outlook
from condvln.episodes.view import SceneView
from condvln.instructions.referents import things_meant_by
from condvln.labels import Vocabulary, vocabulary
from condvln.navigation.protocol import PathfinderProtocol
from condvln.navigation.sight import Look, SightTarget, View, eyes_at, lines_in_view
from condvln.scene import Scene, SceneObject
from condvln.scene.sightings import EVERYTHING_SEEN, Sightings
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import EYE_SPACING, FIRST_VIEW_DEGREES, PREFIX_SAMPLES, PREFIX_STRAY
from schemas.episode import Observability
from schemas.program import Condition, Program

__all__ = ["FIRST_VIEW", "ConditionEvidence", "Observation", "Observer", "SightNeed", "common_prefix"]

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
FIRST_VIEW: Final = "O0f"
"""The name by which a cell asks for O0 with all evidence in the first view."""
NEEDS_AT_ONCE: Final = 2048
"""Targets in first views that are tested together, of some hundred sample points each: tens of megabytes."""
LEVELS: Final[tuple[Observability, ...]] = ("O0", "O1", "O2")
"""Levels in order: from visible at the start to visible only with a detour."""

SightNeed = tuple[str, str]
"""What must be seen: ("object", object id) or ("floor", room id)."""
_Needs = tuple[frozenset[SightNeed], ...]
"""Alternative sets of targets that reveal a condition's truth: one whole set must be seen."""


@dataclass(frozen=True, slots=True)
class ConditionEvidence:
    """From where the evidence for one condition is visible. `in_view` says whether an agent sees all of this evidence
    in its first view, without turning.
    """

    condition: int
    observability: Observability
    in_view: bool


@dataclass(frozen=True, slots=True)
class Observation:
    """The observability of an episode: the worst level over the conditions on its gold path.

    in_view : all evidence lies in the first view, 90° wide (O0f, a part of O0)
    approximate : boxes were used where surfaces are not known
    """

    evidence: tuple[ConditionEvidence, ...]
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
        obstacles: Sequence[tuple[SceneObject, Footprint]] = (),
        words: Vocabulary = vocabulary,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self._scene, self._view, self._pathfinder, self._words = scene, view, pathfinder, words
        self._sightings = sightings
        self._things: dict[tuple[str, str], tuple[str, ...]] = {}
        self._places, self._rules = places, rules
        self._obstacles, self._islands = obstacles, wide_islands(pathfinder, places)
        # What the level camera of the first view sees of things if it turns through 360°. The floor at the agent's feet
        # has no limit, since nothing can be there.
        self.around = {
            "object": View(range=places.sight_range, pitch=FIRST_VIEW_DEGREES / 2),
            "floor": View(range=places.sight_range),
        }
        self._front = View(range=places.sight_range, horizontal_fov=FIRST_VIEW_DEGREES, vertical_fov=FIRST_VIEW_DEGREES)
        self._targets: dict[SightNeed, SightTarget | None] = {}
        self._seen: dict[SightNeed, _Seen] = {}
        self._evidence: dict[int, _Evidence] = {}

    def observe(self, placed: Sequence[tuple[Program, Outlook]]) -> list[Observation]:
        """Return the observation of each placed program, in order."""
        self._find_things(program.conditions[k] for program, _ in placed for k in set(program.route()[0]))
        asked = [
            [(k, self._evidence_of(program.conditions[k])) for k in sorted(set(program.route()[0]))]
            for program, _ in placed
        ]
        starts = [_Eyes(eyes_at(outlook.start, self._places.eye_height)) for _, outlook in placed]
        self._look((name, eye) for needs, eye in zip(asked, starts, strict=True) for _, of in needs for name in of.all)
        at_start = [[self._known(of.ways, eye) for _, of in needs] for needs, eye in zip(asked, starts, strict=True)]
        # Only what is not known at the start is looked for on the way.
        paths = [
            eye if all(known) else self._eyes_on_the_way(outlook)
            for (_, outlook), eye, known in zip(placed, starts, at_start, strict=True)
        ]
        self._look(
            (name, path)
            for needs, known, path in zip(asked, at_start, paths, strict=True)
            for (_, of), seen in zip(needs, known, strict=True)
            if not seen
            for name in of.all
        )
        ahead = self._ahead(
            (name, eye, outlook.yaw)
            for (_, outlook), needs, known, eye in zip(placed, asked, at_start, starts, strict=True)
            for (_, of), seen in zip(needs, known, strict=True)
            if seen
            for name in of.all
        )
        found = []
        for (_, outlook), needs, known, eye, path in zip(placed, asked, at_start, starts, paths, strict=True):
            evidence = []
            for (k, of), seen in zip(needs, known, strict=True):
                level: Observability = "O0" if seen else "O1" if self._known(of.ways, path) else "O2"
                in_view = seen and any(
                    all((name, eye.keys[0], outlook.yaw) in ahead for name in way) for way in of.ways
                )
                evidence.append(ConditionEvidence(k, level, in_view))
            found.append(Observation(tuple(evidence), self._view.approximate))
        return found

    def _eyes_on_the_way(self, outlook: Outlook) -> _Eyes:
        prefix = common_prefix(outlook.paths)
        points = spaced_points(prefix, EYE_SPACING)
        points[0] = outlook.start
        return _Eyes(eyes_at(points, self._places.eye_height))

    def _evidence_of(self, condition: Condition) -> _Evidence:
        """Return what `needs` returns, found once for each condition of the scene."""
        found = self._evidence.get(id(condition))
        if found is None:
            found = self._evidence[id(condition)] = _Evidence(condition, self.needs(condition))
        return found

    def needs(self, condition: Condition) -> _Needs:
        """Return alternative sets of sight targets. To know a condition's truth, an agent must see all targets of at
        least one set.
        """
        room = condition.room.room_id
        anchor = () if condition.qualifier is None else [("object", name) for name in condition.qualifier.anchor_ids]
        if condition.truth:
            return tuple(frozenset({("object", witness), *anchor}) for witness in condition.witnesses)
        whole: _Needs = (frozenset({("floor", room)}),)
        if condition.qualifier is None:
            return whole
        there = [("object", name) for name in self._meant(room, condition.label)]
        return (frozenset({*there, *anchor}), *whole) if there else whole

    def _find_things(self, conditions: Iterable[Condition]) -> None:
        """Find what `_meant` returns for conditions, all labels of a room together."""
        new: dict[str, dict[str, None]] = {}
        for condition in conditions:
            room = condition.room.room_id
            if not condition.truth and condition.qualifier is not None and (room, condition.label) not in self._things:
                new.setdefault(room, {})[condition.label] = None
        for room, labels in new.items():
            found = things_meant_by(self._scene, room, tuple(labels), self._words, self._sightings)
            self._things.update(((room, label), names) for label, names in zip(labels, found, strict=True))

    def _meant(self, room_id: str, label: str) -> tuple[str, ...]:
        """Return the ids of the visible objects that a word for `label` might mean in a room. Unlabelled objects are
        included.
        """
        if (room_id, label) not in self._things:
            (found,) = things_meant_by(self._scene, room_id, (label,), self._words, self._sightings)
            self._things[room_id, label] = found
        return self._things[room_id, label]

    def target(self, name: SightNeed) -> SightTarget | None:
        """Return the sight target of a piece of evidence; None for a room whose floor is unknown."""
        if name not in self._targets:
            kind, key = name
            if kind == "object":
                self._targets[name] = self._view.target(key)
            else:
                room = self._scene.room_of[key]
                points = floor_points(self._scene, room, self._pathfinder, self._islands, self._obstacles)
                self._targets[name] = SightTarget(points) if len(points) else None
        return self._targets[name]

    def _look(self, wanted: Iterable[tuple[SightNeed, _Eyes]]) -> None:
        """Compute and cache the wanted lines of sight that are not cached yet, all together."""
        new: dict[SightNeed, dict[bytes, F64]] = {}
        for name, eyes in wanted:
            known, added = self._seen.setdefault(name, _Seen()).masks, new.setdefault(name, {})
            for key, place in zip(eyes.keys, eyes.places, strict=True):
                if key not in known:
                    added[key] = place
        looks, keys = list[Look](), list[tuple[SightNeed, dict[bytes, F64]]]()
        for name, places in new.items():
            target = self.target(name) if places else None
            if target is not None:
                looks.append(Look(np.array(list(places.values())), target, self.around[name[0]]))
                keys.append((name, places))
        for (name, places), seen in zip(keys, self._view.seen_by_each(looks), strict=True):
            self._seen[name].add(places, seen, self._least(name))

    def _least(self, name: SightNeed) -> float:
        """Return the share of a target's sample points that must be seen."""
        return self._rules.floor_seen if name[0] == "floor" else self._rules.object_seen

    def _known(self, ways: _Needs, eyes: _Eyes) -> bool:
        """Return whether a condition's truth can be known from the `eyes`, looking all around. Each of the `ways` is a
        set of evidence that suffices to know the truth; all evidence of at least one set must be visible.
        """
        return any(all(self._is_seen(name, eyes) for name in way) for way in ways)

    def _is_seen(self, name: SightNeed, eyes: _Eyes) -> bool:
        if self.target(name) is None:
            return False
        return self._seen[name].is_enough(eyes.keys, self._least(name))

    def _ahead(self, asked: Iterable[tuple[SightNeed, _Eyes, float]]) -> set[tuple[SightNeed, bytes, float]]:
        """Return which of the needs are met in the view straight ahead, by its yaw, from the first of the eyes."""
        needs = [
            ((name, eyes.keys[0], yaw), eyes.places[0], target.samples)
            for name, eyes, yaw in asked
            if (target := self.target(name)) is not None and self._is_seen(name, eyes)
        ]
        met = set[tuple[SightNeed, bytes, float]]()
        for begin in range(0, len(needs), NEEDS_AT_ONCE):
            part = needs[begin : begin + NEEDS_AT_ONCE]
            sizes = [len(samples) for _, _, samples in part]
            eyes = np.repeat([place for _, place, _ in part], sizes, axis=0)
            yaws = np.repeat([yaw for (_, _, yaw), _, _ in part], sizes)
            seen = np.concatenate([self._seen[name].masks[key] for (name, key, _), _, _ in part])
            seen &= lines_in_view(eyes, np.concatenate([samples for _, _, samples in part]), self._front, yaws)
            begins = np.cumsum([0, *sizes[:-1]], dtype=np.int64)
            counts = np.add.reduceat(seen.view(np.uint8), begins, dtype=np.int64).tolist()
            for (need, _, _), count, size in zip(part, counts, sizes, strict=True):
                if count / size >= self._least(need[0]):
                    met.add(need)
        return met


class _Seen:
    """What is seen of one target from the eyes from which it was looked for.

    masks : which sample points (k,) each eye sees, by its key
    """

    def __init__(self) -> None:
        self.masks: dict[bytes, Bools] = {}
        self._enough: dict[bytes, bool] = {}

    def add(self, keys: Collection[bytes], seen: Bools, least: float) -> None:
        """Add the masks (n, k) of n eyes. At least the share `least` of the k sample points must be seen."""
        self.masks.update(zip(keys, seen, strict=True))
        enough = np.count_nonzero(seen, axis=1) / max(1, seen.shape[1]) >= least
        self._enough.update(zip(keys, enough.tolist(), strict=True))

    def is_enough(self, keys: Sequence[bytes], least: float) -> bool:
        """Return whether enough of the target is seen from several eyes together."""
        if any(self._enough[key] for key in keys):
            return True
        if len(keys) == 1:
            return False
        seen = np.logical_or.reduce([self.masks[key] for key in keys])
        return bool(np.count_nonzero(seen) / len(seen) >= least)


class _Eyes:
    """Places (n, 3) of eyes in metres, and a key of each."""

    def __init__(self, places: F64) -> None:
        raw, size = places.tobytes(), places.itemsize * 3
        self.places = places
        self.keys = [raw[k : k + size] for k in range(0, len(raw), size)]


class _Evidence:
    """The sets of targets that reveal the truth of a condition, which is kept so that its identity stays its own, and
    all of these targets.
    """

    def __init__(self, condition: Condition, ways: _Needs) -> None:
        self.condition, self.ways, self.all = condition, ways, sorted(frozenset().union(*ways))


def common_prefix(paths: Sequence[F64]) -> F64:
    """Return the shared beginning (n, 3) of several paths from one start; at least the start itself.

    It ends where two paths are farther than PREFIX_STRAY apart at equal walked length.
    """
    first = np.cumsum([0, *map(len, paths)], dtype=np.int64)
    return shared_beginning(np.concatenate(paths, dtype=np.float64), first, PREFIX_SAMPLES, PREFIX_STRAY)
