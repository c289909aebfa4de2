"""Check from where the evidence for an episode's conditions is visible, with all rays cast again.

The evidence for a true condition is one of its witnesses and its anchor. The evidence for a false one is almost the
whole floor of its room; or, if the room has objects that its words could mean, all of these and the anchor. O0 is
visible from the start, O1 from the positions on the path shared by all leaves taken together
(:mod:`condvln.verify.lookouts`), O2 is the rest.

The published level of each condition, whether it is visible without turning, and whether boxes replaced surfaces must
equal what is found here. :mod:`condvln.verify.sight` describes which sample points decide where two sets could differ.
Only the ray casting and the published sample points of ``navigation`` are shared with the generator; occluders,
targets, viewpoints and conclusions are this package's own code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.sight import eyes_at
from condvln.scene import Scene, SceneObject
from condvln.scene.geometry import SceneGeometry
from condvln.verify.certificate import Certificate
from condvln.verify.footprints import Obstacles
from condvln.verify.geodesics import Point
from condvln.verify.ground_points import ground_points
from condvln.verify.heading import yaw_of
from condvln.verify.lookouts import stands
from condvln.verify.referents import SceneReferents
from condvln.verify.rules import VerifierRules
from condvln.verify.sight import Eyes, Sight, Sought
from schemas.episode import Evidence, Observability
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition

__all__ = ["Surfaces", "check_observability", "proofs_of", "sight_of"]

F64 = NDArray[np.float64]

Surfaces = Callable[[], SceneGeometry | None]
"""Returns a scene's surfaces; None if its dataset has none."""
Proofs = list[list[Sought]]
"""Alternative sets of targets that reveal a condition's truth: one whole set must be seen."""

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
    eye_height: float,
) -> None:
    """Check the evidence of all episodes of one scene. The positions of the episodes must already have been checked."""
    asked = []
    starts: dict[Point, Eyes] = {}
    for row, certificate in zip(rows, certificates, strict=True):
        if row.observability is None or any(d.fact in RESTS_ON for d in certificate.disagreements):
            continue
        if certificate.same("surfaces", row.observability_approximate, sight.approximate):
            start = starts.get(row.start_position)
            if start is None:
                start = starts[row.start_position] = Eyes(eyes_at(row.start_position, eye_height))
            asked.append(_asked(row, certificate, referents, start))
    sight.look((thing, one.start) for one in asked for _, proofs in one.proofs for way in proofs for thing in way)
    at_start = [[_known(sight, proofs, one.start) for _, proofs in one.proofs] for one in asked]
    # Eyes on the shared path, in one or two variants; none if everything is visible at the start.
    walking = [not all(known) for known in at_start]
    paths = [[leaf.reference_path for leaf in one.row.leaves] for one, more in zip(asked, walking, strict=True) if more]
    walks = iter(stands(paths))
    ways = [[Eyes(eyes_at(places, eye_height)) for places in next(walks)] if more else [] for more in walking]
    sight.look(
        (thing, eyes)
        for one, known, places in zip(asked, at_start, ways, strict=True)
        for (_, proofs), at_once in zip(one.proofs, known, strict=True)
        if not at_once
        for way in proofs
        for thing in way
        for eyes in places
    )
    for one, known, places in zip(asked, at_start, ways, strict=True):
        for (evidence, proofs), at_once in zip(one.proofs, known, strict=True):
            _check(sight, one, evidence, proofs, [] if at_once else places)


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


def _asked(row: ManifestEpisode, certificate: Certificate, referents: SceneReferents, start: Eyes) -> _Asked:
    yaw = yaw_of(row.start_rotation)
    assert yaw is not None, "a start without a heading was rejected earlier"
    conditions = row.program.conditions
    told = [evidence for evidence in row.evidence or () if evidence.condition < len(conditions)]
    proofs = [(evidence, proofs_of(conditions[evidence.condition], referents)) for evidence in told]
    return _Asked(row, certificate, yaw, start, proofs)


def proofs_of(condition: Condition, referents: SceneReferents) -> Proofs:
    """Return the alternative sets of targets that reveal whether a condition is true."""
    anchor: list[Sought] = [("thing", name) for name in condition.qualifier.anchor_ids] if condition.qualifier else []
    if condition.truth:
        return [[("thing", witness), *anchor] for witness in condition.witnesses]
    proofs: Proofs = [[("floor", condition.room.room_id)]]
    view = referents.rooms.get(condition.room.room_id)
    rivals = () if condition.qualifier is None or view is None else view.meant(condition.label)
    if rivals:
        proofs.append([*(("thing", rival.object_id) for rival in rivals), *anchor])
    return proofs


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
    return {f"{kind} {name}": sight.shares((kind, name), eyes) for kind, name in things}
