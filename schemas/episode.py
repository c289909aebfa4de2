"""Parts of an episode: its axes, the evidence for its conditions, and its leaves with their goals and paths."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from schemas.base import Document, Finite, Vec3

__all__ = ["Composition", "EpisodeLeaf", "Evidence", "Observability", "Subgoal"]

Composition = Literal["C0", "C1", "C2"]
"""C0: one room for everything. C2: condition, then-leaf and else-leaf of some branch are in three rooms. C1: the
rest."""

Observability = Literal["O0", "O1", "O2"]
"""Where the evidence is visible. O0: from the start. O1: on the way shared by all leaves to which the last lead before
the condition leads; without leads, by all leaves. O2: only after a detour.
"""


class Evidence(Document):
    """Where the evidence for one condition is visible. Only conditions on the gold route have an entry."""

    condition: int = Field(ge=0)
    observability: Observability
    in_view: bool
    """whether the evidence is visible from the start without turning, in the view of a level camera, 79° × 63° (O0f)"""
    degrees: Finite | None = None
    """degrees of the shorter side of the rectangle of azimuth × elevation around the visible part of the evidence, from
    the best place: the start for O0, the shared way for O1, else any place of its room; of several objects the one that
    appears smallest counts; null for a floor"""


class Subgoal(Document):
    """A point on the way to the goal, snapped to the navmesh, and the object that it belongs to; the room of a lead."""

    object_id: str
    position: Vec3
    outline: tuple[tuple[Finite, Finite], ...] | None = None
    """corners (x, z) of the room of a lead, implicitly closed, metres: whoever is in there has followed the lead; null
    for an object"""


class EpisodeLeaf(Document):
    """One leaf, placed as if it were gold: object, goal points (nearest to the start first), subgoals and path."""

    leaf: int = Field(ge=0)
    object_id: str
    goals: tuple[Vec3, ...] = Field(min_length=1)
    subgoals: tuple[Subgoal, ...] = ()
    reference_path: tuple[Vec3, ...] = Field(min_length=2)
    geodesic_distance: Finite
    """distance from the start to the nearest goal point, metres, as Habitat computes it"""
    route_length: Finite
    """length of the route from the start through the subgoals to the goal, metres"""
