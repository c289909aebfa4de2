"""Arrow schemas of the eight published tables.

The family of a scene is the partition folder (``source=<family>``), not a column. Coordinates are metres in Habitat's
frame, rounded to 1 mm. Every nested value is a typed struct, so that DuckDB, Polars and pyarrow read them unaided.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa

__all__ = [
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
]

_F = pa.float64()
_S = pa.string()
_I = pa.int32()
_B = pa.bool_()


def _required(name: str, kind: pa.DataType) -> pa.Field:
    return pa.field(name, kind, nullable=False)


# Fields inside a struct are nullable: where the struct itself is null, Arrow's children have nulls too.
VEC3: Final = pa.struct([pa.field("x", _F), pa.field("y", _F), pa.field("z", _F)])
QUATERNION: Final = pa.struct([pa.field(c, _F) for c in "xyzw"])
MESH_PART: Final = pa.struct([pa.field("path", _S), pa.field("transform", pa.list_(_F))])

SCENES: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("status", _S),  # ok | skipped
        pa.field("reason", _S),
        _required("n_rooms", _I),
        _required("n_objects", _I),
        _required("n_objects_without_extent", _I),
        pa.field("navmesh_path", _S),
        pa.field("navmesh_sha256", _S),
        pa.field("navmesh_built", _B),
        pa.field("navmesh_fits", _B),
        pa.field("agent_radius", _F),
        pa.field("agent_height", _F),
        pa.field("agent_max_climb", _F),
        pa.field("agent_max_slope", _F),
        pa.field("bounds_min", VEC3),
        pa.field("bounds_max", VEC3),
        _required("stage", pa.list_(MESH_PART)),
        _required("warnings", pa.list_(pa.struct([pa.field(n, _S) for n in ("code", "where", "message")]))),
    ]
)

ROOMS: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("room_id", _S),
        _required("raw_label", _S),
        _required("label", _S),
        _required("level", _I),
        _required("floor_y", _F),
        _required("ceiling_y", _F),
        pa.field("polygon", pa.list_(pa.struct([pa.field("x", _F), pa.field("z", _F)]))),
        _required("annotation", _S),  # dataset | user | scene
        _required("complete", _B),
        _required("n_objects", _I),
    ]
)

OBJECTS: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("object_id", _S),
        _required("room_id", _S),
        _required("raw_label", _S),
        _required("label", _S),
        _required("center", VEC3),
        pa.field("aabb_min", VEC3),
        pa.field("aabb_max", VEC3),
        pa.field(
            "obb",
            pa.struct([pa.field("center", VEC3), pa.field("half_extents", VEC3), pa.field("rotation", QUATERNION)]),
        ),
        pa.field("size", VEC3),
        pa.field("radius", _F),
        _required("geometry", _S),  # mesh | obb | aabb | size | radius | none
        _required("mesh", pa.list_(MESH_PART)),
        _required("static", _B),
    ]
)

RELATIONS: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("room_id", _S),
        _required("subject", _S),
        _required("predicate", _S),
        _required("target", _S),
        _required("kind", _S),  # containment | canonical | semantic
        pa.field("delta", VEC3),
        pa.field("centre_distance", _F),
        pa.field("horizontal_distance", _F),
        pa.field("aabb_distance", _F),
        pa.field("sphere_distance", _F),
        pa.field("surface_distance", _F),
        pa.field("used_distance", _F),
        pa.field("used_metric", _S),
        pa.field("azimuth", _F),
        pa.field("elevation", _F),
        pa.field("footprint_overlap", _F),
        _required("degenerate", _B),
        _required("true_in_text", _B),
        pa.field("margin", _F),
    ]
)

_ROOM_REF: Final = pa.struct(
    [pa.field("room_id", _S), pa.field("label", _S), pa.field("anchor_id", _S), pa.field("anchor_label", _S)]
)
_QUALIFIER: Final = pa.struct([pa.field("predicate", _S), pa.field("anchor_id", _S), pa.field("anchor_label", _S)])
_OBJECT_REF: Final = pa.struct(
    [
        pa.field("object_id", _S),
        pa.field("label", _S),
        pa.field("room", _ROOM_REF),
        pa.field("qualifier", _QUALIFIER),
    ]
)
_CONDITION: Final = pa.struct(
    [
        pa.field("label", _S),
        pa.field("room", _ROOM_REF),
        pa.field("qualifier", _QUALIFIER),
        pa.field("truth", _B),
        pa.field("witnesses", pa.list_(_S)),
    ]
)
_BRANCH: Final = pa.struct([pa.field("condition", _I), pa.field("then", _I), pa.field("otherwise", _I)])

INSTRUCTIONS: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("instruction_id", _S),
        pa.field("group_id", _S),
        _required("category", _S),
        _required("depth", _I),
        _required("chain", _I),
        _required("composition", _S),
        _required("n_conditions", _I),
        _required("n_relational", _I),
        _required("n_leaves", _I),
        _required("gold_leaf", _I),
        _required("moves", _I),
        _required("conditions", pa.list_(_CONDITION)),
        _required("branches", pa.list_(_BRANCH)),
        _required("leaves", pa.list_(pa.struct([pa.field("moves", pa.list_(_OBJECT_REF))]))),
        pa.field("text", _S),
        pa.field("words", _I),
    ]
)

_EPISODE_LEAF: Final = pa.struct(
    [
        pa.field("leaf", _I),
        pa.field("object_id", _S),
        pa.field("goals", pa.list_(VEC3)),
        pa.field("subgoals", pa.list_(pa.struct([pa.field("object_id", _S), pa.field("position", VEC3)]))),
        pa.field("reference_path", pa.list_(VEC3)),
        pa.field("geodesic_distance", _F),
        pa.field("route_length", _F),
    ]
)

_EVIDENCE: Final = pa.struct([pa.field("condition", _I), pa.field("observability", _S), pa.field("in_view", _B)])

EPISODES: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("episode_id", _S),
        _required("instruction_id", _S),
        pa.field("group_id", _S),
        _required("category", _S),
        _required("composition", _S),
        pa.field("observability", _S),  # O0 | O1 | O2
        pa.field("evidence_in_view", _B),
        pa.field("observability_approximate", _B),
        pa.field("evidence", pa.list_(_EVIDENCE)),
        _required("gold_leaf", _I),
        _required("n_leaves", _I),
        _required("gold_label", _S),
        _required("moves", _I),
        _required("start_position", VEC3),
        _required("start_rotation", QUATERNION),
        _required("start_heading_degrees", _F),
        _required("geodesic_distance", _F),
        _required("route_length", _F),
        _required("leaves", pa.list_(_EPISODE_LEAF)),
        _required("success_distance", _F),
        _required("ground_truth_steps", _I),
        pa.field("actions", pa.list_(pa.int8())),
        pa.field("locations", pa.list_(VEC3)),
        _required("words", _I),
        _required("max_steps", _I),
        _required("instruction_text", _S),
        _required("navmesh_sha256", _S),
    ]
)

REJECTIONS: Final = pa.schema(
    [
        _required("scene_id", _S),
        _required("stage", _S),
        pa.field("category", _S),
        _required("cell", _S),  # the category, and what else the configuration fixes
        _required("reason", _S),
        _required("count", pa.int64()),
        pa.field("example", _S),
    ]
)

FUNNEL: Final = pa.schema(
    [
        _required("scene_id", _S),
        pa.field("category", _S),  # null for counterfactual groups, whose categories take turns
        _required("cell", _S),
        _required("wanted", _I),
        _required("candidates", _I),
        _required("rejected", _I),  # in placing; candidates = rejected + placed
        _required("placed", _I),
    ]
)

TABLES: Final[dict[str, pa.Schema]] = {
    "scenes": SCENES,
    "rooms": ROOMS,
    "objects": OBJECTS,
    "relations": RELATIONS,
    "instructions": INSTRUCTIONS,
    "episodes": EPISODES,
    "rejections": REJECTIONS,
    "funnel": FUNNEL,
}

SORT_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "scenes": ("scene_id",),
    "rooms": ("scene_id", "room_id"),
    "objects": ("scene_id", "object_id"),
    "relations": ("scene_id", "room_id", "subject", "target", "kind", "predicate"),
    "instructions": ("scene_id", "instruction_id"),
    "episodes": ("scene_id", "episode_id"),
    "rejections": ("scene_id", "stage", "reason", "cell"),
    "funnel": ("scene_id", "cell"),
}
"""Columns that order the rows of each table; together they are unique."""
