"""Numbers that decide and are not keys: they are parts of what an episode means, for the generator and the verifier.

A change here changes rows: raise the versions of the stages that read the number.
"""

from __future__ import annotations

from typing import Final

__all__ = [
    "EVIDENCE",
    "EYE_SPACING",
    "FAR_RING_GAP",
    "FEW_LABELS_SLACK",
    "FIRST_VIEW_DEGREES",
    "FLOOR_LEAST_SPACING",
    "FLOOR_LIFT",
    "FLOOR_POINTS",
    "FLOOR_STANDING",
    "FRAME_HEADROOM",
    "GROUP_SIZE",
    "HANG",
    "HEADING_TOLERANCE",
    "INSIDE_SHARE",
    "KEPT_AT_LEAST",
    "LANDMARK_SIZE",
    "LARGER_THAN_RECEPTACLE",
    "LOW_EYE",
    "MOST_MOVES_OF_FOUR_LEAVES",
    "MOST_OBJECTS_PER_ROOM",
    "MOST_ROOMS",
    "OPEN_SHARE",
    "PATH_SPACING",
    "PLAIN_ROOM_WEIGHT",
    "PREFIX_SAMPLES",
    "PREFIX_STRAY",
    "RATE_STEPS",
    "REST_GAP",
    "REST_SHARE",
    "RING_GAP",
    "RING_SPACING",
    "SEEABLE_PLACES",
    "SEEABLE_SHARE",
    "SINK",
    "SNAP_AT_MOST",
    "SNAP_TOLERANCE",
    "STAGINGS",
    "STEP_CEILING",
    "TOP_DEPTH",
    "UNKNOWN_EXTENT",
    "UPRIGHT_COSINE",
    "WALL_DETOUR",
]

PATH_SPACING: Final = 0.25
"""Metres between points of a dense path at most: VLN-CE's forward step."""

HANG: Final = 2.2
"""Metres an object's bottom may hang above the floor it is reached from (a picture, a wall cabinet)."""

SINK: Final = 0.5
"""Metres the floor may lie above an object's bottom, or off the floor of its room (voxel height, floor thickness)."""

WALL_DETOUR: Final = 1.0
"""Metres of detour around the box allowed between two of its goal points; more means a wall lies between them."""

SNAP_TOLERANCE: Final = 0.05
"""Metres a point may move sideways when snapped, and still have been on the floor."""

SNAP_AT_MOST: Final = 0.08
"""Metres that snapping may move a goal point: `SNAP_TOLERANCE` sideways and the same in height."""

FLOOR_STANDING: Final = 0.5
"""Metres; objects whose bottom is lower than this above the floor stand in the agent's way."""

UPRIGHT_COSINE: Final = 0.999
"""Cosine of the tilt up to which an oriented box counts as upright; more tilted ones go by their axis-aligned box."""

EYE_SPACING: Final = 0.5
"""Metres between the places of a path from which is looked: two steps."""

PREFIX_STRAY: Final = 0.25
"""Metres, one step: paths are still the same while they are no farther apart."""

PREFIX_SAMPLES: Final = 0.05
"""Metres between the places at which paths are compared."""

FIRST_VIEW_DEGREES: Final = 90.0
"""Field of view, both ways, of the camera of VLN-CE's R2R task."""

FLOOR_POINTS: Final = 256
"""Points of a room's floor that are looked for, about."""

FLOOR_LEAST_SPACING: Final = 0.2
"""Metres between two of these points at least."""

FLOOR_LIFT: Final = 0.05
"""Metres that these points lie above the floor, so that its own surface does not hide them."""

SEEABLE_SHARE: Final = 1 / 16
"""Part of an object's surface that must be seen, from all places of its room together, before text uses the object:
several times what the verifier asks of other points, so that the two agree."""

SEEABLE_PLACES: Final = 2
"""Places that must see some of it."""

FRAME_HEADROOM: Final = 0.5
"""Metres above a shelf, a table or another frame within which a thing is on it, so that its box does not hide it."""

GROUP_SIZE: Final = 4
"""Programs of a counterfactual group: both truths of a condition, with two leaves exchanged and not."""

HEADING_TOLERANCE: Final = 0.5
"""Degrees that a heading may be off its name; stored quaternions round to much less."""

RING_SPACING: Final = 0.2
"""Metres between neighbouring candidates around an object: a fifth of the smallest success ball's width."""

RING_GAP: Final = 0.125
"""Most metres between two rings of candidates within reach of a box."""

FAR_RING_GAP: Final = 0.2
"""Most metres between two rings of candidates beyond it."""

LOW_EYE: Final = 0.5
"""Metres above the floor of a second eye, for what stands under a table."""

FEW_LABELS_SLACK: Final = 1.25
"""Where a scene has so few labels that the cap can't hold, a label may have this much more than an equal share."""

KEPT_AT_LEAST: Final = 0.5
"""Part of a scene's placed episodes that is kept whatever their labels."""

RATE_STEPS: Final = 64
"""Rates of truth enter a scene's key in steps of 1/64."""

EVIDENCE: Final = 8
"""Rooms in which a statement must have been seen before one that never varied is held to be foretold by its words."""

STAGINGS: Final = 3
"""The same where they are stagings of one layout, near copies in which little varies; with fewer of them a layout's
counts don't stand for themselves."""

INSIDE_SHARE: Final = 0.8
"""Share of an object's box that must lie in a container's box for the container to hold it."""

OPEN_SHARE: Final = 0.5
"""A container that is open less than this hides what is inside."""

TOP_DEPTH: Final = 0.05
"""Metres below a container's top that an object's bottom must lie for the object to be in it, not on it."""

REST_GAP: Final = 0.03
"""Metres between an object's bottom and the top of what it rests on."""

REST_SHARE: Final = 0.5
"""Share of an object's footprint that must lie over what it rests on."""

LARGER_THAN_RECEPTACLE: Final = 2.0
"""An object whose longest side is more than this many times that of its stated receptacle is not in or on it."""

LANDMARK_SIZE: Final = 0.9
"""Metres; longest side from which a statue counts as fixed, so that larger things are found by it."""

UNKNOWN_EXTENT: Final = 0.4
"""Metres; edges of the cube that stands in the agent's way where an object's own extent is unknown."""

STEP_CEILING: Final = 500
"""Actions after which VLN-CE ends an episode: one number for all, since stock loaders hold no budget an episode."""

MOST_MOVES_OF_FOUR_LEAVES: Final = 2
"""Moves of a leaf at most where a program has four leaves: more make a text too long to remember."""

MOST_ROOMS: Final = 4
"""Rooms of a program that spans three or more: people name few, and come back to those that they have named."""

PLAIN_ROOM_WEIGHT: Final = 3.0
"""Weight of a room that its label alone names, where others need a thing in them ("the bedroom with the piano")."""

MOST_OBJECTS_PER_ROOM: Final = 5000
"""Upper bound of ``limits.objects_per_room``: relations of such a room are 65 million rows."""
