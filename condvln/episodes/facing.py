"""Choose a start pose for texts with egocentric directions: left, right, ahead and behind.

Whether an egocentric statement is true depends on where the agent stands and how it faces, so the start pose is chosen
to give the program's truths. A position is only used if every combination of truths of the egocentric conditions has a
heading there. Position, paths and words are then the same for all combinations, so only the heading reveals the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final

import numpy as np
import shapely

from condvln.arrays import F64, Bools
from condvln.instructions.referents import things_meant
from condvln.kept import kept
from condvln.labels import vocabulary
from condvln.relations.directions import Sighting, bearing_status, sighted
from condvln.scene import Scene
from condvln.scene.scene import EVERYTHING_SEEN, Sightings
from schemas.config import Thresholds
from schemas.config.constants import SINK
from schemas.program import Program

__all__ = ["HEADINGS", "Facings", "Headings"]


HEADINGS: Final = 360
"""Number of headings tried per position, evenly spaced from a random first one."""

Claim = tuple[str, str, bool]
"""A claim about a start pose: object id, direction, and whether the object lies in that direction."""


@dataclass(frozen=True, eq=False, slots=True)
class Headings:
    """The start poses that programs allow, for s positions and h headings.

    possible : (s,) positions where the programs may start
    headings : (h,) degrees clockwise from north
    fit : (s, h) whether the programs' egocentric statements have their truths in that pose
    """

    possible: Bools
    headings: F64
    fit: Bools


class Facings:
    """Finds the start headings that programs allow at positions of one scene.

    Parameters
    ----------
    places : (s, 3) positions in metres where an agent may start
    """

    def __init__(
        self,
        scene: Scene,
        places: F64,
        thresholds: Thresholds,
        sightings: Sightings = EVERYTHING_SEEN,
    ) -> None:
        self._scene, self._places, self._thresholds = scene, places, thresholds
        self._sightings = sightings

    def headings(self, programs: Sequence[Program], first: float) -> Headings | None:
        """Return the start poses that `programs` allow if they share one start. Return None if no program requires a
        start room.

        first : degrees of the first heading that is tried, below ``360 / HEADINGS``
        """
        room_id = next((p.start_room for p in programs if p.start_room is not None), None)
        if room_id is None:
            return None
        headings: F64 = np.asarray(first + np.arange(HEADINGS) * (360.0 / HEADINGS), dtype=np.float64)
        fixed = {claim for program in programs for claim in self._of_stops(program)}
        fit = self._all(fixed, headings)
        possible = self._in_room[room_id].copy()
        if len(programs) == 1:
            asked = self._asked(programs[0])
            for truths in product((True, False), repeat=len(asked)):
                case = {(name, direction, truth) for (name, direction, _), truth in zip(asked, truths, strict=True)}
                possible &= (fit & self._all(case, headings)).any(axis=1)
        said = {claim for program in programs for claim in self._asked(program)}
        fit = fit & self._all(said, headings)
        return Headings(possible & fit.any(axis=1), headings, fit)

    def _all(self, claims: set[Claim], headings: F64) -> Bools:
        """Return a mask (s, h) of the poses in which all `claims` hold, for the scene's s positions and the h
        `headings`.
        """
        fit = np.ones((len(self._places), len(headings)), dtype=bool)
        for name, direction, truth in sorted(claims):
            seen = self._sighting(name)
            if seen is None:
                return np.zeros_like(fit)
            fit &= bearing_status(seen, direction, headings, self._thresholds) == (1 if truth else -1)
        return fit

    def _asked(self, program: Program) -> list[Claim]:
        """Return the claims of the program's egocentric conditions."""
        found: list[Claim] = []
        for condition in program.conditions:
            if condition.is_bearing and condition.qualifier is not None:
                for name in things_meant(
                    self._scene, condition.room.room_id, condition.label, vocabulary, self._sightings
                ):
                    found.append((name, condition.qualifier.predicate, condition.truth))
        return found

    def _of_stops(self, program: Program) -> list[Claim]:
        """Return the claims that a program's egocentric stops make. Each stop claims that its object lies in the stated
        direction, and that no other object that the stop's label might mean lies in this direction.
        """
        found: list[Claim] = []
        for leaf in program.leaves:
            for move in leaf.moves:
                if move.is_bearing and move.qualifier is not None:
                    for name in things_meant(self._scene, move.room.room_id, move.label, vocabulary, self._sightings):
                        found.append((name, move.qualifier.predicate, name == move.object_id))
        return found

    @kept
    def _sighting(self, name: str) -> Sighting | None:
        box = self._scene.object_of[name].box
        return None if box is None else sighted(self._places, box, self._thresholds)

    @cached_property
    def _in_room(self) -> Mapping[str, Bools]:
        """Return, by room id, a mask (s,) of the positions that are strictly inside that room and in no other room."""
        inside = {room.room_id: np.ones(len(self._places), dtype=bool) for room in self._scene.rooms}
        held = dict(inside)
        x, z = self._places[:, 0], self._places[:, 2]
        for room in self._scene.rooms:
            if room.polygon is not None:
                outline = shapely.make_valid(shapely.Polygon(room.polygon))
                level = np.abs(self._places[:, 1] - room.floor_y) <= SINK
                inside[room.room_id] = level & shapely.contains_xy(outline, x, z)
                held[room.room_id] = level & shapely.intersects_xy(outline, x, z)
        alone = np.sum(list(held.values()), axis=0) == 1
        return {name: np.asarray(own & alone) for name, own in inside.items()}
