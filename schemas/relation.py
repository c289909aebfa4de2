"""One edge of the relation graph, with every quantity that decided it."""

from __future__ import annotations

from typing import Literal

from schemas.base import Document, Finite, Vec3

__all__ = ["RelationRecord", "UsedDistance"]

UsedDistance = Literal["aabb", "sphere", "centre"]
"""The distance that decides near and far: the first that is available of the three."""


class RelationRecord(Document):
    """One edge. ``subject predicate target`` reads as English: the stool is north of the dishwasher.

    ``delta`` is c_target − c_subject; predicates are decided on its negative. Metres and degrees; null where a
    quantity does not apply (containment) or was not needed (surface distance of far pairs).
    """

    scene_id: str
    room_id: str
    subject: str
    predicate: str
    target: str
    kind: Literal["containment", "canonical", "semantic"]
    delta: Vec3 | None = None
    centre_distance: Finite | None = None
    horizontal_distance: Finite | None = None
    aabb_distance: Finite | None = None
    sphere_distance: Finite | None = None
    surface_distance: Finite | None = None
    used_distance: Finite | None = None
    used_metric: UsedDistance | None = None
    azimuth: Finite | None = None
    elevation: Finite | None = None
    footprint_overlap: Finite | None = None
    degenerate: bool = False
    true_in_text: bool = False
    margin: Finite | None = None
