"""From where the evidence for an episode's conditions can be seen, with every ray cast again.

What must be seen to know that a condition is true: one of its witnesses, and the thing that its qualifier refers to.
That it is false: next to all of its room's floor; or, where things are there that its words could mean, all of these
with the thing of the qualifier. O0 is what is seen from the start, O1 what is seen from the places on the way that all
leaves share, taken together (:mod:`condvln.verify.lookouts`), O2 the rest.

The rule: the published level of each condition, whether it is seen without turning, and whether boxes stood in for
surfaces must be what is found here, exactly. Found by whose points, where sets of points could differ, is told in
:mod:`condvln.verify.sight`. Only the engine of the looks and the published points are shared with the factory, both of
``navigation``; what hides, what is looked for, where it is looked from, and what follows, is this package's own.
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
from condvln.verify.ground_points import ground_points
from condvln.verify.heading import yaw_of
from condvln.verify.lookouts import stands
from condvln.verify.referents import SceneReferents
from condvln.verify.rules import VerifierRules
from condvln.verify.sight import Sight, Sought
from schemas.episode import Evidence, Observability
from schemas.evaluation import ManifestEpisode
from schemas.program import Condition

__all__ = ["Surfaces", "check_observability", "sight_of"]

F64 = NDArray[np.float64]

Surfaces = Callable[[], SceneGeometry | None]
"""Reads a scene's surfaces; None where its dataset tells none."""
Proofs = list[list[Sought]]
"""Ways to know a condition's truth: all that one of them names must be seen."""

RESTS_ON: Final = frozenset({"reference_path", "start_rotation"})
"""Facts without which there is no place to look from: a row that they refute already is not asked what it sees."""


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    """A row whose evidence is looked for.

    start (1, 3) : the eye at its start
    proofs : by each condition that evidence is recorded for
    """

    row: ManifestEpisode
    certificate: Certificate
    yaw: float
    start: F64
    proofs: list[tuple[Evidence, Proofs]]


def check_observability(
    rows: Sequence[ManifestEpisode],
    certificates: Sequence[Certificate],
    sight: Sight,
    referents: SceneReferents,
    eye_height: float,
) -> None:
    """The evidence of all episodes of one scene, after their places were checked."""
    asked = []
    for row, certificate in zip(rows, certificates, strict=True):
        if row.observability is None or any(d.fact in RESTS_ON for d in certificate.disagreements):
            continue
        if certificate.same("surfaces", row.observability_approximate, sight.approximate):
            asked.append(_asked(row, certificate, referents, eye_height))
    sight.look((thing, one.start) for one in asked for _, proofs in one.proofs for way in proofs for thing in way)
    at_start = [[_known(sight, proofs, one.start) for _, proofs in one.proofs] for one in asked]
    # Eyes (n, 3) on the shared way, in one or two answers; none where all is known at the start.
    ways = [[] if all(known) else _ways(one.row, eye_height) for one, known in zip(asked, at_start, strict=True)]
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
    """Looks in a scene, from nothing but its files.

    Raises
    ------
    InputError : its surfaces can't be read
    """

    def floor(room_id: str) -> F64:
        room, radius = scene.room_of[room_id], rules.places.island_radius
        return ground_points(scene, room, pathfinder, radius, obstacles.grounds)

    return Sight(scene, surfaces(), is_structure, is_frame, floor, rules.places, rules.episodes)


def _asked(row: ManifestEpisode, certificate: Certificate, referents: SceneReferents, eye_height: float) -> _Asked:
    yaw = yaw_of(row.start_rotation)
    assert yaw is not None, "a start without a heading is refuted before"
    conditions = row.program.conditions
    told = [evidence for evidence in row.evidence or () if evidence.condition < len(conditions)]
    proofs = [(evidence, _proofs(conditions[evidence.condition], referents)) for evidence in told]
    return _Asked(row, certificate, yaw, eyes_at(row.start_position, eye_height), proofs)


def _ways(row: ManifestEpisode, eye_height: float) -> list[F64]:
    paths = [np.array(leaf.reference_path) for leaf in row.leaves]
    return [eyes_at(places, eye_height) for places in stands(paths)]


def _proofs(condition: Condition, referents: SceneReferents) -> Proofs:
    anchor: list[Sought] = [("thing", name) for name in condition.qualifier.anchor_ids] if condition.qualifier else []
    if condition.truth:
        return [[("thing", witness), *anchor] for witness in condition.witnesses]
    proofs: Proofs = [[("floor", condition.room.room_id)]]
    view = referents.rooms.get(condition.room.room_id)
    rivals = () if condition.qualifier is None or view is None else view.meant(condition.label)
    if rivals:
        proofs.append([*(("thing", rival.object_id) for rival in rivals), *anchor])
    return proofs


def _known(sight: Sight, proofs: Proofs, eyes: F64, yaw: float | None = None) -> bool:
    return any(all(sight.is_seen(thing, eyes, yaw) for thing in way) for way in proofs)


def _check(sight: Sight, one: _Asked, evidence: Evidence, proofs: Proofs, ways: Sequence[F64]) -> None:
    """One condition's level and whether it is seen without turning.

    ways : eyes (n, 3) on the shared way, in one or two answers; none where it is known at the start
    """
    levels: list[Observability] = ["O1" if _known(sight, proofs, eyes) else "O2" for eyes in ways] or ["O0"]
    ahead = not ways and _known(sight, proofs, one.start, one.yaw)
    place = f"condition {evidence.condition}"
    agreed = evidence.observability in levels
    found = None if agreed else {"level": levels[0], **_shares(sight, proofs, ways[0] if ways else one.start)}
    one.certificate.holds("observability", agreed, evidence.observability, found, place)
    one.certificate.same("first_view", evidence.in_view, ahead, place)


def _shares(sight: Sight, proofs: Proofs, eyes: F64) -> dict[str, Any]:
    """How much is seen of all that tells a condition's truth; by own points and published ones, or of a floor's."""
    things = sorted({thing for way in proofs for thing in way})
    return {f"{kind} {name}": sight.shares((kind, name), eyes) for kind, name in things}
