"""Arrow schemas of the nine published tables; every column carries its description.

The family of a scene is the partition folder (``source=<family>``), not a column. Coordinates are metres in Habitat's
frame (+Y up, −Z forward; east = +X, north = −Z), rounded to 1 mm. Every nested value is a typed struct, so that DuckDB,
Polars and pyarrow read them unaided. ``docs/data.md`` is made from the descriptions.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

__all__ = [
    "ABOUT",
    "EPISODES",
    "FUNNEL",
    "INSTRUCTIONS",
    "OBJECTS",
    "REJECTIONS",
    "RELATIONS",
    "ROOMS",
    "SCENES",
    "SORT_KEYS",
    "TABLES",
    "VISIBILITY",
    "description",
]

_F = pa.float64()
_S = pa.string()
_I = pa.int32()
_B = pa.bool_()


def _field(name: str, kind: pa.DataType, about: str, *, nullable: bool = True) -> pa.Field:
    return pa.field(name, kind, nullable=nullable, metadata={"description": about})


def _required(name: str, kind: pa.DataType, about: str) -> pa.Field:
    return _field(name, kind, about, nullable=False)


def description(field: pa.Field) -> str:
    """Return the description of a column or of a struct's field; empty if there is none."""
    about: bytes = (field.metadata or {}).get(b"description", b"")
    return about.decode()


# Fields inside a struct are nullable: where the struct itself is null, Arrow's children have nulls too.
VEC3: Final = pa.struct([pa.field("x", _F), pa.field("y", _F), pa.field("z", _F)])
QUATERNION: Final = pa.struct([pa.field(c, _F) for c in "xyzw"])
MESH_PART: Final = pa.struct(
    [
        _field("path", _S, "mesh file, relative to the dataset's root"),
        _field("transform", pa.list_(_F), "row-major 4×4 matrix from the file's frame to the scene's"),
    ]
)
ORIENTED_BOX: Final = pa.struct(
    [
        _field("center", VEC3, "centre, metres"),
        _field("half_extents", VEC3, "half the lengths along the box's own axes, metres"),
        _field("rotation", QUATERNION, "quaternion [x, y, z, w] from the box's axes to the scene's"),
    ]
)
_WARNING: Final = pa.struct(
    [
        _field("code", _S, "kind of the warning"),
        _field("where", _S, "file, room or object"),
        _field("message", _S, "what was missing or odd, and how it was handled"),
    ]
)

_SCENE_ID: Final = _required("scene_id", _S, "id of the scene within its source")
_ROOM_ID: Final = _required("room_id", _S, "id of the room within its scene")

SCENES: Final = pa.schema(
    [
        _SCENE_ID,
        _required("status", _S, "`ok`, or `skipped`: a well-formed scene that can yield nothing"),
        _field("reason", _S, "why the scene was skipped; null where it was not"),
        _required("n_rooms", _I, "number of rooms"),
        _required("n_objects", _I, "number of objects"),
        _required("n_objects_without_extent", _I, "number of objects with a known centre and no known extent"),
        _field("navmesh_path", _S, "navmesh file, relative to the dataset's root, or the name of the built one"),
        _field("navmesh_sha256", _S, "SHA-256 of the navmesh file; null where there is none"),
        _field("navmesh_built", _B, "the navmesh was built here; false where the dataset ships it"),
        _field("navmesh_fits", _B, "the navmesh's settings match the configured agent"),
        _field("agent_radius", _F, "agent radius of the navmesh, metres"),
        _field("agent_height", _F, "agent height of the navmesh, metres"),
        _field("agent_max_climb", _F, "highest step that the agent of the navmesh climbs, metres"),
        _field("agent_max_slope", _F, "steepest slope that the agent of the navmesh walks, degrees"),
        _field("bounds_min", VEC3, "least corner of all rooms and objects, metres"),
        _field("bounds_max", VEC3, "greatest corner of all rooms and objects, metres"),
        _required("stage", pa.list_(MESH_PART), "meshes of the building itself: walls, floors, ceilings"),
        _required("warnings", pa.list_(_WARNING), "what was missing or odd in the source's files"),
    ]
)

ROOMS: Final = pa.schema(
    [
        _SCENE_ID,
        _ROOM_ID,
        _required("raw_label", _S, "the source's own label"),
        _required("label", _S, "canonical room type, the same over all sources"),
        _required("level", _I, "storey; 0 is the lowest"),
        _required("floor_y", _F, "height of the floor, metres"),
        _required("ceiling_y", _F, "height of the ceiling, metres"),
        _field(
            "polygon",
            pa.list_(pa.struct([pa.field("x", _F), pa.field("z", _F)])),
            "corners of the outline, implicitly closed, metres; null where only a box or nothing is known",
        ),
        _required(
            "annotation", _S, "who outlined the room: `dataset`, `user`, or `scene` (the whole scene is one room)"
        ),
        _required(
            "complete",
            _B,
            "annotated completely enough to say what is absent, except for labels that an unnamed object may have",
        ),
        _required(
            "asked",
            _B,
            "conditions may be asked about this room; only about things that are there if it is not complete",
        ),
        _required("n_objects", _I, "number of objects in the room"),
    ]
)

OBJECTS: Final = pa.schema(
    [
        _SCENE_ID,
        _required("object_id", _S, "id of the object within its scene"),
        _required("room_id", _S, "id of the room that holds the object"),
        _required("raw_label", _S, "the source's own label"),
        _required("label", _S, "canonical label, the same over all sources"),
        _required("center", VEC3, "centre of the object, metres"),
        _field("aabb_min", VEC3, "least corner of the axis-aligned box, metres; null where the extent is unknown"),
        _field("aabb_max", VEC3, "greatest corner of the axis-aligned box, metres; null where the extent is unknown"),
        _field(
            "obb",
            ORIENTED_BOX,
            "oriented box, where the source gives one or a mesh",
        ),
        _field("size", VEC3, "edge lengths of the axis-aligned box, metres"),
        _field("radius", _F, "radius of the bounding sphere, metres"),
        _required(
            "geometry", _S, "best geometry known: `mesh`, `obb`, `aabb`, `size`, `radius`, or `none` (a centre only)"
        ),
        _required("mesh", pa.list_(MESH_PART), "mesh files of the object; empty where there are none"),
        _required("static", _B, "the object can't be moved"),
        _required(
            "parts",
            pa.list_(ORIENTED_BOX),
            "oriented boxes that make up the object, where one box does not fit its shape",
        ),
        _field(
            "receptacles",
            pa.list_(_S),
            "ids of the objects that it is in or on, according to the source; null if the source does not say",
        ),
        _field(
            "openness",
            _F,
            "how far it is open, 0 to 1, according to the source; 1 if it can't be closed; null if "
            "the source does not say",
        ),
        _field("parent", _S, "id of the object that contains this one; null if none does"),
        _field("support", _S, "id of the object that this one rests on; null for the floor, a wall or unknown"),
        _required("hidden", _B, "a container around the object can be closed, and is open less than half"),
    ]
)

RELATIONS: Final = pa.schema(
    [
        _SCENE_ID,
        _ROOM_ID,
        _required("subject", _S, "object id; for `contains` the room's id"),
        _required("predicate", _S, "`subject predicate target` reads as English: `lamp north of bed`"),
        _required("target", _S, "object id"),
        _required("kind", _S, "`containment`, `canonical` (one direction for each ordered pair) or `semantic`"),
        _field("delta", VEC3, "centre of the target minus centre of the subject, metres"),
        _field("centre_distance", _F, "distance between the centres, metres"),
        _field("horizontal_distance", _F, "distance between the centres on the ground plane, metres"),
        _field("aabb_distance", _F, "distance between the axis-aligned boxes, metres; null where one is unknown"),
        _field("sphere_distance", _F, "distance between the bounding spheres, metres; null where one is unknown"),
        _field(
            "surface_distance",
            _F,
            "distance between the surfaces (of meshes or oriented boxes), metres; null beyond "
            "`thresholds.surface_within` and where an extent is unknown",
        ),
        _field("used_distance", _F, "distance that decides near and far, metres"),
        _field("used_metric", _S, "which distance `used_distance` is: `aabb`, `sphere` or `centre`"),
        _field("azimuth", _F, "direction from target to subject on the ground, degrees: 0 = east, 90 = north"),
        _field("elevation", _F, "elevation of the subject as seen from the target, degrees"),
        _field("footprint_overlap", _F, "share of the smaller footprint that lies over the other, 0 to 1"),
        _required("degenerate", _B, "the centres are so close on the ground that the direction is unreliable"),
        _required("true_in_text", _B, "the predicate holds with the margin that text requires"),
        _field(
            "margin",
            _F,
            "distance from the threshold at which the edge is emitted, in widths of the dead zone; "
            "text may use edges with 1 or more",
        ),
    ]
)

VISIBILITY: Final = pa.schema(
    [
        _SCENE_ID,
        _required("object_id", _S, "id of an object that is not part of the building"),
        _field(
            "seeable",
            _B,
            "enough of its surface is visible at eye height from places of its room where an agent "
            "can stand; text uses only such objects; null in a scene without a navmesh, where no "
            "object is excluded",
        ),
        _field(
            "unseen",
            _B,
            "none of its surface is visible from any of these places; where both this and "
            "`seeable` are false, text says nothing that depends on the object",
        ),
        _field(
            "places", _I, "number of places from which the object was looked for; 0 where a closed container hides it"
        ),
        _field("from_places", _I, "number of these places from which some of it is visible"),
        _field("share", _F, "share of its surface that is visible from all these places together, 0 to 1"),
        _field(
            "nearest_view",
            _F,
            "horizontal distance from its centre to the nearest place from which it is visible, metres; else null",
        ),
    ]
)

_ROOM_REF: Final = pa.struct(
    [
        _field("room_id", _S, "room"),
        _field("label", _S, "canonical room type"),
        _field(
            "anchor_id",
            _S,
            "id of an object that tells the room from others of its type (`the bedroom with the piano`)",
        ),
        _field("anchor_label", _S, "canonical label of that object"),
    ]
)
_ANCHOR: Final = pa.struct(
    [
        _field("object_id", _S, "id of the anchor object, unique in its room by its label"),
        _field("label", _S, "canonical label of the anchor"),
    ]
)
_QUALIFIER: Final = pa.struct(
    [
        _field("predicate", _S, "relation to the anchors, or `bigger` and `smaller` of two"),
        _field("anchors", pa.list_(_ANCHOR), "anchors in the order of the text: two for `between`, none for `bigger`"),
    ]
)
_OBJECT_REF: Final = pa.struct(
    [
        _field("object_id", _S, "object"),
        _field("label", _S, "canonical label"),
        _field("room", _ROOM_REF, "the room that the text names"),
        _field("qualifier", _QUALIFIER, "relation that makes the object unique; null where its label is unique"),
    ]
)
_CONDITION: Final = pa.struct(
    [
        _field("label", _S, "canonical label that is asked for"),
        _field("room", _ROOM_REF, "room in which it is asked for"),
        _field("qualifier", _QUALIFIER, "relation that is asked for; null for presence alone"),
        _field("definite", _B, "the label fits only one object of the room, so that text says `the`"),
        _field("truth", _B, "true if the condition holds"),
        _field("witnesses", pa.list_(_S), "ids of the objects that make it true; empty where it is false"),
    ]
)
_BRANCH: Final = pa.struct(
    [
        _field("condition", _I, "index into `conditions`, from 0"),
        _field("then", _I, "where a true condition leads: branch index, or leaf −1 − t where t is negative"),
        _field("otherwise", _I, "where a false condition leads, likewise"),
    ]
)

_INSTRUCTION_ID: Final = _required("instruction_id", _S, "content hash of scene and program")
_CATEGORY: Final = "`simple`, `nested`, `deep_nested`, `chain`, `long_chain` or `nested_chain`: the tree's shape"
_COMPOSITION: Final = (
    "`C0`: everything in one room; `C2`: some branch whose condition, then-leaf and else-leaf lie in three different "
    "rooms; `C1`: anything else"
)
_GROUP: Final = (
    "counterfactual group: episodes with one start that differ by the truth of a condition "
    "or by two exchanged leaves; null for episodes in no group"
)
_GOLD: Final = "index of the leaf that the conditions' truths lead to, from 0"

INSTRUCTIONS: Final = pa.schema(
    [
        _SCENE_ID,
        _INSTRUCTION_ID,
        _field("group_id", _S, _GROUP),
        _required("category", _S, _CATEGORY),
        _required("depth", _I, "deepest nesting of then-branches"),
        _required("chain", _I, "number of tests in the top chain"),
        _required("composition", _S, _COMPOSITION),
        _required("n_conditions", _I, "number of conditions"),
        _required("n_relational", _I, "number of conditions that ask for a relation"),
        _required("n_leaves", _I, "number of leaves"),
        _required("gold_leaf", _I, _GOLD),
        _required("moves", _I, "number of stops of the gold leaf, its goal included"),
        _required("conditions", pa.list_(_CONDITION), "conditions in the order in which the text asks them"),
        _required("branches", pa.list_(_BRANCH), "the decision tree; the first branch is its root"),
        _required(
            "leaves",
            pa.list_(pa.struct([_field("moves", pa.list_(_OBJECT_REF), "stops in order; the last is the goal")])),
            "leaves in reading order",
        ),
        _field("text", _S, "the instruction's text; null where the program was not placed"),
        _field("words", _I, "number of words of the text"),
    ]
)

_EPISODE_LEAF: Final = pa.struct(
    [
        _field("leaf", _I, "index of the leaf, from 0"),
        _field("object_id", _S, "id of the leaf's goal object"),
        _field(
            "goals",
            pa.list_(VEC3),
            "navigable points at the goal object, the one nearest to the start first, metres",
        ),
        _field(
            "subgoals",
            pa.list_(
                pa.struct([_field("object_id", _S, "object"), _field("position", VEC3, "point on the navmesh, metres")])
            ),
            "stops before the goal, in order",
        ),
        _field(
            "reference_path", pa.list_(VEC3), "corners of the shortest path from the start through all stops, metres"
        ),
        _field("geodesic_distance", _F, "start to the nearest goal point, as Habitat computes it, metres"),
        _field("route_length", _F, "length of the reference path, metres"),
    ]
)

_EVIDENCE: Final = pa.struct(
    [
        _field("condition", _I, "index of the condition, from 0"),
        _field("observability", _S, "`O0`, `O1` or `O2`, as in the column `observability`"),
        _field("in_view", _B, "visible from the start without turning, in a view 90° wide"),
    ]
)

EPISODES: Final = pa.schema(
    [
        _SCENE_ID,
        _required("episode_id", pa.int64(), "id in every file, below 2^53, made from `episode_hash`"),
        _required("episode_hash", _S, "content hash of scene, instruction and start pose"),
        _INSTRUCTION_ID,
        _field("group_id", _S, _GROUP),
        _required("category", _S, _CATEGORY),
        _required("composition", _S, _COMPOSITION),
        _field(
            "observability",
            _S,
            "where the evidence for the conditions on the gold route is visible, the worst case "
            "over them: `O0` from the start, `O1` on the part of the way that all leaves share, "
            "`O2` only after a detour",
        ),
        _field("evidence_in_view", _B, "all evidence is in the first view, 90° wide"),
        _field("observability_approximate", _B, "visibility was decided with boxes, since surfaces are missing"),
        _field("evidence", pa.list_(_EVIDENCE), "visibility of the evidence for each condition on the gold route"),
        _required("gold_leaf", _I, _GOLD),
        _required("n_leaves", _I, "number of leaves"),
        _required("gold_label", _S, "canonical label of the gold leaf's goal"),
        _required("moves", _I, "number of stops of the gold leaf, its goal included"),
        _required("start_position", VEC3, "start on the navmesh, metres"),
        _required("start_rotation", QUATERNION, "start rotation, quaternion [x, y, z, w]; identity faces north"),
        _required("start_heading_degrees", _F, "compass heading at the start, clockwise from north, degrees"),
        _required("geodesic_distance", _F, "start to the nearest goal point of the gold leaf, metres"),
        _required(
            "route_length", _F, "length of the route from the start through the gold leaf's stops to its goal, metres"
        ),
        _required("leaves", pa.list_(_EPISODE_LEAF), "every leaf, placed and checked as if it were gold"),
        _required("success_distance", _F, "distance from a goal point within which STOP succeeds, metres"),
        _required("ground_truth_steps", _I, "actions of the longest walk to any leaf, STOP included"),
        _field(
            "actions",
            pa.list_(pa.int8()),
            "actions of the walk to the gold leaf: 0 STOP, 1 forward 0.25 m, 2 left 15°, 3 right 15°",
        ),
        _field("locations", pa.list_(VEC3), "the start and the position after each forward step, metres"),
        _required("words", _I, "number of words of the text"),
        _required("max_steps", _I, "step budget: actions after which the episode ends, STOP included"),
        _required("instruction_text", _S, "the instruction as published"),
        _required("navmesh_sha256", _S, "SHA-256 of the navmesh on which the episode was placed"),
    ]
)

_CELL: Final = "cell of the configuration: a category, and the other axes that it fixes"

REJECTIONS: Final = pa.schema(
    [
        _SCENE_ID,
        _required(
            "stage",
            _S,
            "what was rejected: draws (`programs`) or candidates that were not placed (`episodes`)",
        ),
        _field("category", _S, _CATEGORY),
        _required("cell", _S, _CELL),
        _required("reason", _S, "rule that they failed"),
        _required("count", pa.int64(), "number of rejected draws or candidates"),
        _field("example", _S, "one of the rejected candidates"),
    ]
)

FUNNEL: Final = pa.schema(
    [
        _SCENE_ID,
        _field(
            "category", _S, "category of the cell; null for counterfactual groups, which alternate between categories"
        ),
        _required("cell", _S, _CELL),
        _required("wanted", _I, "episodes wanted"),
        _required("candidates", _I, "number of candidates drawn: rejected plus placed"),
        _required("rejected", _I, "number of candidates for which no placement was found"),
        _required("placed", _I, "episodes placed"),
    ]
)

TABLES: Final[dict[str, pa.Schema]] = {
    "scenes": SCENES,
    "rooms": ROOMS,
    "objects": OBJECTS,
    "relations": RELATIONS,
    "visibility": VISIBILITY,
    "instructions": INSTRUCTIONS,
    "episodes": EPISODES,
    "rejections": REJECTIONS,
    "funnel": FUNNEL,
}

ABOUT: Final[dict[str, str]] = {
    "scenes": "One row for each scene, with its navmesh and what was odd in its files.",
    "rooms": "One row for each room.",
    "objects": "One row for each object, with the best geometry that its source gives.",
    "relations": "One row for each edge of the relation graphs, with every metric it was decided by.",
    "visibility": "One row for each object except walls and floors: whether it can be seen from where an "
    "agent can stand.",
    "instructions": "One row for each program that was sampled: its tree, truths and, where placed, its text.",
    "episodes": "One row for each placed instruction: start, goals and paths of every leaf, budget and text.",
    "rejections": "One row for each rule and cell of a scene: how many candidates failed the rule.",
    "funnel": "One row for each cell of a scene: episodes wanted, candidates drawn, episodes placed.",
}
"""Description of the rows of each table."""

SORT_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "scenes": ("scene_id",),
    "rooms": ("scene_id", "room_id"),
    "objects": ("scene_id", "object_id"),
    "relations": ("scene_id", "room_id", "subject", "target", "kind", "predicate"),
    "visibility": ("scene_id", "object_id"),
    "instructions": ("scene_id", "instruction_id"),
    "episodes": ("scene_id", "episode_id"),
    "rejections": ("scene_id", "stage", "reason", "cell"),
    "funnel": ("scene_id", "cell"),
}
"""Columns that order the rows of each table; together they are unique."""
