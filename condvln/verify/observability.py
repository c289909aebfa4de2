"""Check from where the evidence for an episode's conditions is visible, and which objects are visible at all, with all
rays cast again.

The evidence for a true condition is one of its witnesses and its anchor. The evidence for a false one is almost the
whole floor of its room; or, if the room has objects that its words could mean, all of these and the anchor. O0 is
visible from the start, O1 from the positions on the path shared by all leaves taken together (`stands`), O2 is the
rest. An object must be recognised from one place, each point of a floor be visible so near that a usual object with
the label would be recognised there.

The published level of each condition, whether it is visible without turning, how many degrees of it are seen from the
best place, and whether boxes replaced surfaces must equal what is found here. Every stop must be recognised from all
points at which one may stop. :mod:`condvln.verify.sight` describes which sample points decide where two sets could
differ. Only the ray casting and the published sample points of ``navigation`` are shared with the generator; occluders,
targets, viewpoints and conclusions are this package's own code.

An object is visible at all if enough of this package's points on its surface are visible from positions in its room
where an agent can stand; one that a text names must be recognised from one of them. The generator requires four times
as much before text mentions an object, and zero of many more points before text may ignore it. Objects in between are
never mentioned, so two sets of points agree on the rest.
The contents of a shut container are not visible.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from condvln.arrays import F64
from condvln.kept import kept
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.scene import Scene, SceneObject
from condvln.scene.scene import SceneGeometry
from condvln.verify.certificate import Certificate, VerifierRules
from condvln.verify.footprints import Obstacles, Point, ground_points
from condvln.verify.program_check import leads_to, sharing
from condvln.verify.referents import SceneReferents
from condvln.verify.sight import Eyes, Sight, Sought, absence_range
from condvln.verify.standpoint import yaw_of
from schemas.config import PlacesConfig
from schemas.config.constants import EYE_SPACING, FLOOR_LIFT, LEVEL_CAMERA, PREFIX_SAMPLES, PREFIX_STRAY, SEEABLE_SHARE
from schemas.episode import EpisodeLeaf, Evidence, Observability
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition, Program

__all__ = [
    "Onlookers",
    "Surfaces",
    "check_absence",
    "check_observability",
    "check_seen",
    "measured",
    "proofs_of",
    "shared_length",
    "sight_of",
    "stands",
    "stops_of",
]


Surfaces = Callable[[], SceneGeometry | None]
"""Returns a scene's surfaces; None if its dataset has none."""
Proofs = list[list[Sought]]
"""Alternative sets of targets that reveal a condition's truth: one whole set must be seen."""

HUNDREDTH: Final = 0.0101
"""Tolerance in degrees: published ones are rounded."""
RESTS_ON: Final = frozenset({"reference_path", "start_rotation"})
"""Facts without which there is no position to look from: if a row already fails one, its observability is not
checked.
"""


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    """A row whose evidence is checked.

    start : the eye at its start
    proofs : for each condition with recorded evidence, its sets of targets
    """

    row: ManifestEpisode
    certificate: Certificate
    yaw: float
    start: Eyes
    proofs: list[tuple[Evidence, Proofs]]


def check_observability(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    sight: Sight,
    referents: SceneReferents,
    onlookers: Onlookers,
    eye_height: float,
) -> None:
    """Check the evidence of all episodes of one scene, and that their stops are seen. The positions of the episodes
    must already have been checked.
    """
    _check_stops(rows, certificates, sight, eye_height)
    _check_leads(rows, certificates, sight, referents, eye_height)
    asked = []
    starts: dict[Point, Eyes] = {}
    for row, certificate in zip(rows, certificates, strict=True):
        if row.observability is None or any(d.fact in RESTS_ON for d in certificate.disagreements):
            continue
        if certificate.same("surfaces", row.observability_approximate, sight.approximate):
            start = starts.get(row.start_position)
            if start is None:
                start = starts[row.start_position] = Eyes(eyes_at(row.start_position, eye_height))
            asked.append(_asked(row, certificate, referents, sight, start))
    sight.look((thing, one.start) for one in asked for _, proofs in one.proofs for way in proofs for thing in way)
    at_start = [[_known(sight, proofs, one.start) for _, proofs in one.proofs] for one in asked]
    # Eyes on the shared path, in one or two variants; none if everything is visible at the start.
    walking = [not all(known) for known in at_start]
    ways = [
        _shared_ways(one, eye_height) if more else [list[Eyes]()] * len(one.proofs)
        for one, more in zip(asked, walking, strict=True)
    ]
    sight.look(
        (thing, eyes)
        for one, known, places in zip(asked, at_start, ways, strict=True)
        for (_, proofs), at_once, its in zip(one.proofs, known, places, strict=True)
        if not at_once
        for way in proofs
        for thing in way
        for eyes in its
    )
    for one, known, places in zip(asked, at_start, ways, strict=True):
        for (evidence, proofs), at_once, its in zip(one.proofs, known, places, strict=True):
            _check(sight, one, evidence, proofs, [] if at_once else its)
            _check_degrees(sight, one, evidence, proofs, [] if at_once else its, onlookers)


def _shared_ways(one: _Asked, eye_height: float) -> list[list[Eyes]]:
    """Return for each condition with recorded evidence the eyes on the way to it that its leaves share, in one or two
    variants.
    """
    known: dict[tuple[int, ...], list[Eyes]] = {}
    for evidence, _ in one.proofs:
        leaves = tuple(sharing(one.row.program, evidence.condition))
        if leaves not in known:
            paths = [one.row.leaves[leaf].reference_path for leaf in leaves]
            known[leaves] = [Eyes(eyes_at(places, eye_height)) for places in stands(paths)]
    return [known[tuple(sharing(one.row.program, evidence.condition))] for evidence, _ in one.proofs]


def sight_of(
    scene: Scene,
    surfaces: Surfaces,
    is_structure: Callable[[SceneObject], bool],
    is_frame: Callable[[SceneObject], bool],
    pathfinder: Pathfinder,
    obstacles: Obstacles,
    rules: VerifierRules,
) -> Sight:
    """Return the visibility tests of a scene, built from its files only.

    Raises
    ------
    InputError : its surfaces can't be read
    """

    def floor(room_id: str) -> F64:
        room, radius = scene.room_of[room_id], rules.places.island_radius
        return ground_points(scene, room, pathfinder, radius, obstacles.grounds)

    return Sight(scene, surfaces(), is_structure, is_frame, floor, rules.places, rules.episodes)


def check_absence(program: Program, referents: SceneReferents, places: PlacesConfig, certificate: Certificate) -> None:
    """Check that conditions ask for what an agent can find out: whether something with a label is in a room, only if it
    can see that there is none. Where the floor that a level camera shows is never near enough for that, it can't.
    """
    nearest = (places.eye_height - FLOOR_LIFT) / math.sin(math.radians(LEVEL_CAMERA[1] / 2))
    for number, condition in enumerate(program.conditions):
        view = referents.rooms.get(condition.room.room_id)
        there = view is not None and bool(view.meant(condition.label))
        if condition.qualifier is None or not (condition.truth or there):
            seen = absence_range(condition.label, places)
            needed = f"a floor {nearest:.2f} m away is in range"
            certificate.holds("absence_seen", seen > nearest, needed, seen, f"condition {number}")


def _check_stops(
    rows: Sequence[ManifestEpisode], certificates: Sequence[Certificate], sight: Sight, eye_height: float
) -> None:
    """Check that each stop's object is recognised from where an agent stops."""
    places: dict[tuple[str, Point], Eyes] = {}
    for row in rows:
        for stop in _objects_of(row):
            if stop not in places:
                places[stop] = Eyes(eyes_at(stop[1], eye_height))
    sight.look((("thing", name, 0.0), eyes) for (name, _), eyes in places.items())
    for row, certificate in zip(rows, certificates, strict=True):
        stops = _objects_of(row)
        unseen = sorted({name for name, at in stops if not sight.is_seen(("thing", name, 0.0), places[name, at])})
        certificate.holds("stop_seen", not unseen, "recognised from where one stops", unseen)


def _objects_of(row: ManifestEpisode) -> list[tuple[str, Point]]:
    """Return the stops and goals of all leaves at objects: not those at which leads end."""
    rooms = {branch.lead.room_id for branch in row.program.branches if branch.lead is not None}
    return [(name, at) for name, at in stops_of(row.leaves) if name not in rooms]


def _check_leads(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    sight: Sight,
    referents: SceneReferents,
    eye_height: float,
) -> None:
    """Check that each condition with a lead can be decided from where the lead ends, whatever its truth is."""
    asked: dict[tuple[Condition, Point], tuple[Proofs, Eyes]] = {}
    told = []
    for row, certificate in zip(rows, certificates, strict=True):
        for leaf in row.leaves[: len(row.program.leaves)]:
            for branch, stop in zip(leads_to(row.program, leaf.leaf), leaf.subgoals, strict=False):
                key = row.program.conditions[branch.condition], stop.position
                if key not in asked:
                    asked[key] = [_either_way(key[0], referents, sight)], Eyes(eyes_at(stop.position, eye_height))
                told.append((certificate, key, f"condition {branch.condition}, leaf {leaf.leaf}"))
    sight.look((thing, eyes) for proofs, eyes in asked.values() for way in proofs for thing in way)
    for certificate, key, name in told:
        certificate.holds("lead_seen", _known(sight, *asked[key]), "recognised", key[1], name)


def stops_of(leaves: Sequence[EpisodeLeaf]) -> list[tuple[str, Point]]:
    """Return the stops and goals of leaves, each with its object."""
    stops = [(stop.object_id, stop.position) for leaf in leaves for stop in leaf.subgoals]
    return stops + [(leaf.object_id, goal) for leaf in leaves for goal in leaf.goals]


def _asked(
    row: ManifestEpisode, certificate: Certificate, referents: SceneReferents, sight: Sight, start: Eyes
) -> _Asked:
    yaw = yaw_of(row.start_rotation)
    assert yaw is not None, "a start without a heading was rejected earlier"
    conditions = row.program.conditions
    told = [evidence for evidence in row.evidence or () if evidence.condition < len(conditions)]
    proofs = [(evidence, proofs_of(conditions[evidence.condition], referents, sight)) for evidence in told]
    return _Asked(row, certificate, yaw, start, proofs)


def proofs_of(condition: Condition, referents: SceneReferents, sight: Sight) -> Proofs:
    """Return the alternative sets of targets that reveal whether a condition is true."""
    anchors = condition.qualifier.anchor_ids if condition.qualifier else ()
    anchor: list[Sought] = [("thing", name, 0.0) for name in anchors]
    if condition.truth:
        return [[("thing", witness, 0.0), *anchor] for witness in condition.witnesses]
    proofs: Proofs = [[("floor", condition.room.room_id, absence_range(condition.label, sight.places))]]
    view = referents.rooms.get(condition.room.room_id)
    rivals = () if condition.qualifier is None or view is None else view.meant(condition.label)
    if rivals:
        proofs.append([*(("thing", rival.object_id, 0.0) for rival in rivals), *anchor])
    return proofs


def _either_way(condition: Condition, referents: SceneReferents, sight: Sight) -> list[Sought]:
    """Return the targets that settle a condition for one who does not know its truth: all things that its words could
    mean, with the anchor; and the floor, if there is no such thing or the question is whether there is one.
    """
    view = referents.rooms.get(condition.room.room_id)
    meant = () if view is None else view.meant(condition.label)
    named = [*(one.object_id for one in meant), *(condition.qualifier.anchor_ids if condition.qualifier else ())]
    floor: Sought = ("floor", condition.room.room_id, absence_range(condition.label, sight.places))
    asks_if_any = condition.qualifier is None or not meant
    return [*(("thing", name, 0.0) for name in named), *([floor] if asks_if_any else [])]


def _known(sight: Sight, proofs: Proofs, eyes: Eyes, yaw: float | None = None) -> bool:
    return any(all(sight.is_seen(thing, eyes, yaw) for thing in way) for way in proofs)


def _check(sight: Sight, one: _Asked, evidence: Evidence, proofs: Proofs, ways: Sequence[Eyes]) -> None:
    """Check two published facts about one condition: its observability level, and whether its evidence is visible at
    the start without turning.

    ways : eyes on the shared path, in one or two variants; none if it is visible at the start
    """
    levels: list[Observability] = ["O1" if _known(sight, proofs, eyes) else "O2" for eyes in ways] or ["O0"]
    ahead = not ways and _known(sight, proofs, one.start, one.yaw)
    place = f"condition {evidence.condition}"
    agreed = evidence.observability in levels
    found = None if agreed else {"level": levels[0], **_shares(sight, proofs, ways[0] if ways else one.start)}
    one.certificate.holds("observability", agreed, evidence.observability, found, place)
    one.certificate.same("first_view", evidence.in_view, ahead, place)


def _shares(sight: Sight, proofs: Proofs, eyes: Eyes) -> dict[str, Any]:
    """Return for each target the shares of its sample points that are visible from `eyes`: first of the points that
    this package chose itself, then of the published points. A floor has only one set of points.
    """
    things = sorted({thing for way in proofs for thing in way})
    return {f"{thing[0]} {thing[1]}": sight.shares(thing, eyes) for thing in things}


def _check_degrees(
    sight: Sight, one: _Asked, evidence: Evidence, proofs: Proofs, ways: Sequence[Eyes], onlookers: Onlookers
) -> None:
    """Check how large the evidence appears from the best place: the start (O0), the shared path (O1) or any place of
    its room (O2), where the generator looks from all places only if few don't suffice.

    ways : eyes on the shared path, in one or two variants; empty if everything is known at the start
    """
    told = evidence.degrees or 0.0
    if evidence.observability == "O2":
        found = [_largest(proofs, partial(onlookers.degrees, every=False))]
        if told > found[0] + HUNDREDTH:
            most = _largest(proofs, partial(onlookers.degrees, every=True))
            # The generator may have looked at one object from few places, and at another from all.
            each = [onlookers.degrees(thing, every=True) for way in proofs for thing in way if thing[0] == "thing"]
            found += [most, *(value for value in each if found[0] < value < most)]
    else:
        places = ways or [one.start]
        known = [[way for way in proofs if all(sight.is_seen(thing, eyes) for thing in way)] for eyes in places]
        found = [_largest(its, partial(sight.degrees, eyes=eyes)) for its, eyes in zip(known, places, strict=True)]
    agreed = any(abs(told - value) <= HUNDREDTH for value in found)
    one.certificate.holds("degrees", agreed, evidence.degrees, found, f"condition {evidence.condition}")


def _largest(proofs: Proofs, degrees: Callable[[Sought], float]) -> float:
    """Return how large the evidence appears for the best of its `proofs`: of several objects, the one that appears
    smallest counts; 0 if all evidence is a floor.
    """
    return max((min(map(degrees, way)) for way in proofs if all(kind == "thing" for kind, _, _ in way)), default=0.0)


EVEN: Final = 1e-6
"""Tolerance in steps: a path of 1.5000000001 m has three parts of 0.5 m or four, depending on how its length is
rounded.
"""


def stands(paths: Sequence[Sequence[Point]]) -> list[F64]:
    """Return the positions (n, 3), the start first, at which an agent looks around before the paths of an episode's
    leaves diverge.

    Paths count as shared as long as, at equal walked lengths, no two of them are more than a step apart. This is tested
    every `PREFIX_SAMPLES` metres. The agent looks around at the start and then at equal distances of at most
    `EYE_SPACING` metres. If the shared length is a multiple of that up to rounding, there are two possible divisions,
    and both are returned.
    """
    corners, walked = measured(paths)
    together = shared_length(corners, walked)
    parts = {max(math.ceil(together / EYE_SPACING + even), 1) for even in (-EVEN, EVEN)}
    return [
        _places(corners[0], walked[0], np.append(np.arange(count) * (together / count), together))
        for count in sorted(parts)
    ]


def measured(paths: Sequence[Sequence[Point]]) -> tuple[list[F64], list[F64]]:
    """Return the corners (n, 3) of each path, and the metres (n,) walked from its start to each corner."""
    corners = [np.array(path, dtype=np.float64) for path in paths]
    return corners, [np.append(0.0, np.cumsum(np.linalg.norm(np.diff(its, axis=0), axis=1))) for its in corners]


def shared_length(corners: Sequence[F64], walked: Sequence[F64]) -> float:
    """Return the metres that paths, as `measured` returns them, have in common."""
    shortest = min(float(its[-1]) for its in walked)
    metres = np.append(np.arange(0.0, shortest, PREFIX_SAMPLES), shortest)
    places = np.array([_places(*line, metres) for line in zip(corners, walked, strict=True)])
    apart = np.linalg.norm(places[:, None] - places, axis=-1).max(axis=(0, 1)) > PREFIX_STRAY
    return float(metres[max(int(apart.argmax()) - 1, 0)]) if apart.any() else shortest


def _places(corners: F64, walked: F64, metres: F64) -> F64:
    """Return the positions (n, 3) after so many `metres` (n,) on a path with corners (k, 3), each reached after so much
    as `walked` (k,) says.
    """
    return np.stack([np.interp(metres, walked, axis) for axis in corners.T], axis=1)


POINTS: Final = 256
"""Number of points on an object's surface."""
SEEN_SHARE: Final = SEEABLE_SHARE / 4
"""Share of the points that must be visible."""
PLACES: Final = 32
"""Number of positions from which the generator looks for every object before it looks from all of its room."""
FEW: Final = 8
"""Stride of the positions and points that are tested first; this suffices for most objects."""


class Onlookers:
    """Finds out whether an object is visible from at least one position in its room where an agent can stand. Each
    object is tested once.

    hidden : ids of objects inside something shut
    """

    def __init__(
        self, scene: Scene, sight: Sight, pathfinder: Pathfinder, places: PlacesConfig, hidden: Set[str]
    ) -> None:
        self._scene, self._sight, self._pathfinder, self._places = scene, sight, pathfinder, places
        self._hidden = hidden
        self._seen: dict[str, bool] = {}
        self._degrees: dict[tuple[str, bool], float] = {}

    def degrees(self, thing: Sought, *, every: bool) -> float:
        """Return how large an object appears from the best of the positions in its room that the generator tries first,
        or of all if it is not recognised from there; 0 if it is not recognised from anywhere.

        every : all positions count also if few of the first ones recognise it
        """
        if (thing[1], every) not in self._degrees:
            item, best = self._scene.object_of.get(thing[1]), 0.0
            known = item is not None and thing[1] not in self._hidden and item.room_id in self._scene.room_of
            eyes = self._of_room(item.room_id) if item is not None and known else np.empty((0, 3))
            if len(eyes):
                first = Eyes(eyes[np.unique(np.round(np.linspace(0, len(eyes) - 1, PLACES)).astype(int))])
                best, sure = self._sight.degrees(thing, first), self._sight.is_sure(thing, first)
                if not best or (every and not sure):
                    best = self._sight.degrees(thing, Eyes(eyes))
            self._degrees[thing[1], every] = best
        return self._degrees[thing[1], every]

    def see(self, object_id: str) -> bool:
        """Return whether an object is visible from some position in its room."""
        if object_id not in self._seen:
            item = self._scene.object_of.get(object_id)
            if item is None or object_id in self._hidden or item.room_id not in self._scene.room_of:
                return False
            self._look_around(item.room_id)
        return self._seen[object_id]

    def recognise(self, object_id: str) -> bool:
        """Return whether an object is visible, and recognised from some position in its room."""
        thing: Sought = ("thing", object_id, 0.0)
        return self.see(object_id) and self.degrees(thing, every=False) > 0

    def _look_around(self, room_id: str) -> None:
        """Look for all objects of a room."""
        names = [x.object_id for x in self._scene.objects if x.room_id == room_id and x.object_id not in self._hidden]
        things = [(name, self._sight.surface(name, POINTS)) for name in names]
        eyes = self._of_room(room_id)
        for stride in (FEW, 1):
            looked = [(name, points[::stride]) for name, points in things]
            least = [SEEN_SHARE * len(points) for _, points in things]
            seen = self._sight.met(looked, eyes[::stride], least)
            self._seen.update(zip([name for name, _ in things], seen, strict=True))
            things = [thing for thing, found in zip(things, seen, strict=True) if not found]

    @kept
    def _of_room(self, room_id: str) -> F64:
        """Return eyes (n, 3) at the positions of a room where an agent can stand."""
        floor = self._sight.floor(room_id) - np.array([0.0, FLOOR_LIFT, 0.0])
        stood = np.asarray(self._pathfinder.are_navigable(floor)) if len(floor) else np.zeros(0, bool)
        return eyes_at(floor[stood], self._places.eye_height)


def check_seen(program: Program, onlookers: Onlookers, certificate: Certificate) -> None:
    """Check that all objects that a text presupposes (stops, anchors and witnesses) are visible."""
    named: set[str | None] = set()
    for one in program.named:
        named |= {*one.witnesses} if isinstance(one, Condition) else {one.object_id}
        named |= {one.room.anchor_id, *(one.qualifier.anchor_ids if one.qualifier else ())}
    out_of_sight = sorted(name for name in named if name is not None and not onlookers.recognise(name))
    certificate.holds("seeable", not out_of_sight, "recognised from where an agent can stand", out_of_sight)
