"""Constants that belong to the definition of an episode, shared by generator and verifier. They can't be configured.

A change here changes rows: raise the versions of the stages that read the number.
"""

from __future__ import annotations

import math
from typing import Final

__all__ = [
    "ABSENCE_METRES",
    "BORDER_SHARE",
    "COUNTER_HEIGHT",
    "COUNTER_LENGTH",
    "DOUBLE_CENTRES",
    "DOUBLE_FOOTPRINT",
    "DOUBLE_GAP",
    "DRAWN_PER_PLACE",
    "EVIDENCE",
    "EYE_SPACING",
    "FALLEN_DEGREES",
    "FALLEN_OFF_FLOOR",
    "FALLEN_SUNK",
    "FAR_RING_GAP",
    "FEW_LABELS_SLACK",
    "FLOOR_LEAST_SPACING",
    "FLOOR_LIFT",
    "FLOOR_POINTS",
    "FLOOR_STANDING",
    "FRAME_HEADROOM",
    "FURNITURE_DETOUR",
    "GROUP_RUG",
    "GROUP_SIZE",
    "GROUP_TABLE",
    "HANG",
    "HEADING_TOLERANCE",
    "INSIDE_SHARE",
    "KEPT_AT_LEAST",
    "LANDMARK_SIZE",
    "LARGER_THAN_RECEPTACLE",
    "LEAD_INSIDE",
    "LEVEL_CAMERA",
    "LIKE_HEIGHT",
    "LIKE_SIZE",
    "MOST_MOVES_OF_FOUR_LEAVES",
    "MOST_OBJECTS_PER_ROOM",
    "MOST_ROOMS",
    "MOVES_OFF",
    "OPEN_SHARE",
    "PART_INSIDE",
    "PATH_SPACING",
    "PLAIN_ROOM_WEIGHT",
    "PREFIX_SAMPLES",
    "PREFIX_STRAY",
    "RATE_STEPS",
    "REST_GAP",
    "REST_SHARE",
    "RING_GAP",
    "RING_SPACING",
    "SCREEN_TO_KEYBOARD",
    "SEAT_LENGTH",
    "SEAT_LONGEST",
    "SEAT_RATIO",
    "SEEABLE_IN_FRAME",
    "SEEABLE_PLACES",
    "SEEABLE_SHARE",
    "SIDE_TABLE_LENGTH",
    "SINK",
    "SNAP_AT_MOST",
    "SNAP_TOLERANCE",
    "STAGINGS",
    "STEP_CEILING",
    "TABLE_HEIGHT",
    "THIN_GAP",
    "THIN_SHARE",
    "TOP_DEPTH",
    "TWIN_HEIGHT",
    "UNKNOWN_EXTENT",
    "UPRIGHT_COSINE",
    "WALL_DETOUR",
]

PATH_SPACING: Final = 0.25
"""Largest distance between neighbouring points of a dense path, metres: VLN-CE's forward step."""

HANG: Final = 2.2
"""Largest height of an object's bottom above the floor from which it is reached, metres (a picture, a wall cabinet)."""

SINK: Final = 0.5
"""Largest height of the floor above an object's bottom, or difference from the floor of its room, metres (voxel height,
floor thickness)."""

WALL_DETOUR: Final = 1.0
"""Longest detour around an object's box between two of its goal points where the scene's walls are unknown, metres; a
longer one means that a wall lies between them."""

FURNITURE_DETOUR: Final = 6.0
"""The same where walls are known, metres: lines of sight keep to one side of a wall, and a pillow is reached from both
sides of its bed."""

SNAP_TOLERANCE: Final = 0.05
"""Largest sideways shift by snapping at which a point still counts as on the floor, metres."""

SNAP_AT_MOST: Final = 0.08
"""Largest distance by which snapping may move a goal point, metres: `SNAP_TOLERANCE` sideways and the same in
height."""

FLOOR_STANDING: Final = 0.5
"""Objects whose bottom is less than this above the floor are obstacles for the agent, metres."""

UPRIGHT_COSINE: Final = 0.999
"""Cosine of the tilt up to which an oriented box counts as upright. Boxes that are tilted more are replaced by their
axis-aligned box."""

EYE_SPACING: Final = 0.5
"""Distance between the places on a path from which the agent looks, metres: two steps."""

PREFIX_STRAY: Final = 0.25
"""Largest distance between two paths at which they count as the same, metres: one step."""

PREFIX_SAMPLES: Final = 0.05
"""Distance between the places at which paths are compared, metres."""

LEVEL_CAMERA: Final = (79.0, math.degrees(2 * math.atan(math.tan(math.radians(79.0 / 2)) * 480 / 640)))
"""Horizontal and vertical field of view of the level camera of looking walks, degrees: a picture of 640 × 480, as
StreamVLN and VLN-CE's recent agents have it."""

FLOOR_POINTS: Final = 256
"""Approximate number of floor points of a room that are tested for visibility."""

FLOOR_LEAST_SPACING: Final = 0.2
"""Least distance between two of these points, metres."""

FLOOR_LIFT: Final = 0.05
"""Height of these points above the floor, metres, so that the floor's own surface does not hide them."""

ABSENCE_METRES: Final = (1.0, 1.5, 2.5, 4.0, 6.0, 9.0, 15.0)
"""Distances up to which a room's floor is looked at to know that something is absent, metres: the greatest one at which
a usual object of the label is recognised. They are few, so that labels share them."""

TABLE_HEIGHT: Final = 0.75
"""Height above the floor at which a thing that usually lies on a table lies, metres."""

SEEABLE_SHARE: Final = 1 / 16
"""Share of an object's surface that must be visible, from all places of its room together, before text uses the object.
It is several times the share that the verifier requires at its own points, so that the two agree."""

SEEABLE_PLACES: Final = 2
"""Number of places from which the object must be recognised, and some of it visible."""

SEEABLE_IN_FRAME: Final = 1 / 24
"""Share of the positions in its room from which a level camera must recognise an object that text names."""

FRAME_HEADROOM: Final = 0.5
"""Height above a shelf, a table or another frame up to which the frame's box does not hide a thing, metres."""

GROUP_SIZE: Final = 4
"""Programs of a counterfactual group: both truths of a condition, each with two leaves in both orders."""

HEADING_TOLERANCE: Final = 0.5
"""Largest angle between a heading and the direction that names it, degrees; stored quaternions round to much less."""

RING_SPACING: Final = 0.2
"""Distance between neighbouring candidates for goal points around an object, metres: a fifth of the width of the
smallest success ball."""

RING_GAP: Final = 0.125
"""Largest distance between two rings of candidates within reach of a box, metres."""

FAR_RING_GAP: Final = 0.2
"""Largest distance between two rings of candidates beyond reach, metres."""

DRAWN_PER_PLACE: Final = 5
"""Number of candidates drawn at once for each episode that a cell lacks, since placing rejects some."""

MOVES_OFF: Final = 1.5
"""How many leaves too many or too few of a cell may have some number of moves, before candidates with other moves are
drawn."""

FEW_LABELS_SLACK: Final = 1.25
"""Factor on an equal share of labels: the share that a label may have where a scene has too few labels to keep the
cap."""

KEPT_AT_LEAST: Final = 0.5
"""Share of a scene's placed episodes that is kept whatever their labels are."""

RATE_STEPS: Final = 64
"""Number of steps between 0 and 1 to which rates of truth are rounded in a scene's key."""

EVIDENCE: Final = 8
"""Number of rooms in which a statement must have been seen before one that never varied counts as predictable from its
words."""

STAGINGS: Final = 3
"""The same for rooms that are stagings of one layout, near copies in which little varies. With fewer stagings, a layout
has no counts of its own."""

INSIDE_SHARE: Final = 0.8
"""Least share of an object's box that must lie in a container's box for the object to be in the container."""

OPEN_SHARE: Final = 0.5
"""A container that is open less than this share hides its contents."""

TOP_DEPTH: Final = 0.05
"""Least depth of an object's bottom below a container's top for the object to be in it, not on it, metres."""

REST_GAP: Final = 0.03
"""Largest gap between an object's bottom and the top of what it rests on, metres."""

REST_SHARE: Final = 0.5
"""Least share of an object's footprint that lies over what it rests on."""

LARGER_THAN_RECEPTACLE: Final = 2.0
"""An object whose longest side is more than this many times that of its stated receptacle is not in or on it."""

LANDMARK_SIZE: Final = 0.9
"""Longest side from which a statue counts as fixed, metres, so that it may be the anchor of larger things."""

UNKNOWN_EXTENT: Final = 0.4
"""Edge of the cube that replaces an object of unknown extent as an obstacle, metres."""

STEP_CEILING: Final = 500
"""Actions after which VLN-CE ends an episode. It is one number, since stock loaders hold no budget per episode."""

MOST_MOVES_OF_FOUR_LEAVES: Final = 2
"""Most moves of a leaf where a program has four leaves: more would make the text too long to remember."""

MOST_ROOMS: Final = 4
"""Most rooms of a program that spans three or more rooms: people name few, and return to those."""

PLAIN_ROOM_WEIGHT: Final = 10.0
"""Weight of a room that its label alone identifies, relative to rooms that need an object in them ("the bedroom with
the piano")."""

MOST_OBJECTS_PER_ROOM: Final = 5000
"""Upper bound of ``limits.objects_per_room``: a room of that size has 65 million rows of relations."""

COUNTER_LENGTH: Final = 1.2
"""Length of the longer side of a table from which it may be called a counter, metres."""

DOUBLE_FOOTPRINT: Final = 0.5
"""Least share of the smaller footprint over the other for two boxes of a scan with one label to be possibly one
thing."""

DOUBLE_GAP: Final = 0.15
"""Largest vertical gap between two such boxes, metres."""

DOUBLE_CENTRES: Final = 0.2
"""Largest distance between the centres of two boxes of a scan, metres, for them to be possibly one thing whatever
their size."""

LIKE_SIZE: Final = 1.35
"""Largest ratio of each side of an unnamed thing to that of a named thing for the two to be possibly of one kind."""

LIKE_HEIGHT: Final = 0.25
"""Largest height difference between the bottoms of an unnamed and a named thing, metres, for the two to be possibly of
one kind."""

COUNTER_HEIGHT: Final = 0.85
"""Height above the floor from which the top of a table as large as the room's counter may be called a counter,
metres."""

FALLEN_DEGREES: Final = 20.0
"""Tilt from which a model on the floor counts as fallen over, degrees."""

FALLEN_OFF_FLOOR: Final = 0.1
"""Largest height above the floor of a tilted model's bottom for it to count as on the floor, metres."""

FALLEN_SUNK: Final = 0.1
"""Largest depth below the floor that a model may reach without counting as fallen over, metres."""

PART_INSIDE: Final = 0.5
"""Least share of a shelf's or a drawer's box inside the box of another piece of furniture for it to be a part of that
furniture, which text does not name."""

BORDER_SHARE: Final = 0.1
"""Least share of an object's footprint inside the outline of a second room of a scan for it to be on the border of two
rooms."""

SCREEN_TO_KEYBOARD: Final = 0.5
"""Distance between the footprints of a screen of a scan and of a keyboard up to which the screen may be a monitor,
metres."""

SEAT_LENGTH: Final = 1.0
"""Length of the longer side of a chair's box in a scan from which it may be the box of two chairs, metres."""

SEAT_RATIO: Final = 1.5
"""Least ratio of the sides of such a box."""

SEAT_LONGEST: Final = 1.4
"""Length of the longer side from which the box of a chair may be that of several, whatever the ratio of its sides,
metres."""

TWIN_HEIGHT: Final = 1.25
"""Largest ratio of the heights of two objects of a scan with one label for them to be possibly equal, one of them
scanned in part."""

THIN_GAP: Final = 0.1
"""Largest distance between the footprints of two boxes of a scan with one label, the one thin, for them to be possibly
one thing, metres."""

THIN_SHARE: Final = 0.5
"""Largest ratio of the shorter side of the thin box to that of the other."""

GROUP_RUG: Final = 0.25
"""Largest distance between the footprints of a rug and of two things for these to form a group, metres."""

GROUP_TABLE: Final = 1.5
"""The same for a coffee table, metres."""

SIDE_TABLE_LENGTH: Final = 1.0
"""Length of the longer side of a table up to which it may be called a side table, metres."""

LEAD_INSIDE: Final = 0.5
"""Least distance in metres, two steps, of the place at which a lead ends from the outline of its room."""
