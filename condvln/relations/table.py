"""The relations of a scene as one flat table, which `RoomRelations.from_table` reads back, and as a networkx graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import networkx as nx
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.relations.decisions import SEMANTIC
from condvln.relations.directions import CANONICAL, COINCIDENT, COMPASS
from condvln.relations.metrics import USED_METRICS
from condvln.relations.room import RoomRelations
from condvln.relations.text import TextFacts, text_facts
from condvln.scene import Scene
from schemas.config import Thresholds
from schemas.tables import RELATIONS, VEC3

__all__ = ["CONTAINS", "relation_table", "to_networkx"]

Codes = NDArray[np.int64]

CONTAINS: Final = "contains"
"""Predicate of the edge from a room to each of its objects; stored in this direction only."""

_KINDS: Final = ("canonical", "containment", "semantic")
_PREDICATES: Final = tuple(sorted((*CANONICAL, *SEMANTIC, CONTAINS)))
"""Sorted, so that codes are in the order of the texts."""

_CANONICAL_CODES: Final = np.array([_PREDICATES.index(predicate) for predicate in CANONICAL])
_SEMANTIC_CODES: Final = np.array([_PREDICATES.index(predicate) for predicate in SEMANTIC])
_NO_METRIC: Final = -1
"""Code of the distance that decided an edge without metrics."""


@dataclass(frozen=True, eq=False, slots=True)
class _Edges:
    """Edges as arrays, with the edges along the last axis; texts are codes, and NaN is "unknown".

    room, subject, target : indices into the sorted ids of a scene's rooms and objects
    kind, predicate, used_metric : indices into `_KINDS`, `_PREDICATES` and `USED_METRICS`
    delta : (3, k); measures : (10, k), the columns of `_MEASURES`; the others (k,)
    """

    room: Codes
    subject: Codes
    target: Codes
    kind: Codes
    predicate: Codes
    used_metric: Codes
    delta: F64
    measures: F64
    degenerate: Bools
    true_in_text: Bools


_MEASURES: Final = (
    "centre_distance",
    "horizontal_distance",
    "aabb_distance",
    "sphere_distance",
    "surface_distance",
    "used_distance",
    "azimuth",
    "elevation",
    "footprint_overlap",
    "margin",
)


def relation_table(
    scene: Scene,
    relations: Mapping[str, RoomRelations],
    thresholds: Thresholds,
    facts: Mapping[str, TextFacts] | None = None,
) -> pa.Table:
    """Return all edges of a scene in the schema `RELATIONS`, sorted by its keys.

    Each room has a containment edge per object (``room contains object``, without metrics), a canonical edge per
    ordered pair whose centres do not coincide, and the semantic edges whose thresholds hold. `margin` and
    `true_in_text` belong to the row's own predicate; predicates that text never uses have no margin.

    relations : by room id, from `relate_scene`
    facts : by room id, what text may state about the rooms, from `text_facts`; found here if they are not given
    """
    rooms = [relations[room.room_id] for room in scene.rooms if len(relations[room.room_id])]
    if not rooms:
        return RELATIONS.empty_table()
    names = sorted({name for found in rooms for name in (found.room_id, *found.objects.object_ids)})
    number = {name: code for code, name in enumerate(names)}
    parts = []
    for found in rooms:
        room, objects = number[found.room_id], np.array([number[name] for name in found.objects.object_ids])
        said = facts[found.room_id] if facts else text_facts(found, thresholds)
        parts += [_containment(room, objects), _edges(room, objects, found, said)]
    return _table(scene.scene_id, names, _sorted(parts))


def _containment(room: int, objects: Codes) -> _Edges:
    n = len(objects)
    return _Edges(
        room=np.full(n, room),
        subject=np.full(n, room),
        target=objects,
        kind=np.full(n, _KINDS.index("containment")),
        predicate=np.full(n, _PREDICATES.index(CONTAINS)),
        used_metric=np.full(n, _NO_METRIC),
        delta=np.full((3, n), np.nan),
        measures=np.full((len(_MEASURES), n), np.nan),
        degenerate=np.zeros(n, dtype=np.bool_),
        true_in_text=np.zeros(n, dtype=np.bool_),
    )


def _edges(room: int, objects: Codes, relations: RoomRelations, facts: TextFacts) -> _Edges:
    n, metrics = len(objects), relations.metrics
    first = np.flatnonzero(relations.canonical != COINCIDENT)  # pairs with a canonical edge
    codes = relations.canonical.reshape(-1)[first].astype(np.int64)
    semantic, second = np.divmod(np.flatnonzero(np.stack([relations.semantic[name] for name in SEMANTIC])), n * n)
    pairs = np.concatenate([first, second])
    # Text uses only those canonical predicates that are in `COMPASS`, which come first, and all semantic ones.
    level = np.flatnonzero(codes < len(COMPASS))
    said = np.concatenate([level, np.arange(len(first), len(pairs))])
    of_compass, of_semantic = codes[level] * (n * n) + first[level], semantic * (n * n) + second
    true, margin = np.zeros(len(pairs), dtype=np.bool_), np.full(len(pairs), np.nan)
    true[said] = _of_edges(facts.status, of_compass, of_semantic) == 1
    margin[said] = _of_edges(facts.margin, of_compass, of_semantic)
    subject, target = np.divmod(pairs, n)
    measures = (
        metrics.centre,
        metrics.horizontal,
        metrics.aabb,
        metrics.sphere,
        relations.surface,
        metrics.used,
        metrics.azimuth,
        metrics.elevation,
        metrics.footprint_overlap,
    )
    return _Edges(
        room=np.full(len(pairs), room),
        subject=objects[subject],
        target=objects[target],
        kind=np.repeat([_KINDS.index("canonical"), _KINDS.index("semantic")], [len(first), len(second)]),
        predicate=np.concatenate([_CANONICAL_CODES[codes], _SEMANTIC_CODES[semantic]]),
        used_metric=metrics.used_metric.reshape(-1)[pairs].astype(np.int64),
        delta=metrics.delta.reshape(-1, 3)[pairs].T,
        measures=np.stack([*(values.reshape(-1)[pairs] for values in measures), margin]),
        degenerate=relations.degenerate.reshape(-1)[pairs],
        true_in_text=true,
    )


def _of_edges(said: Mapping[str, NDArray[Any]], compass: Codes, semantic: Codes) -> NDArray[Any]:
    """Return what `said` (n, n) holds by predicate for the edges of `COMPASS`, then for those of `SEMANTIC`.

    compass, semantic : index of each edge's predicate, times n², plus that of its pair
    """
    found = [
        np.stack([said[name] for name in names]).reshape(-1)[at]
        for names, at in ((COMPASS, compass), (SEMANTIC, semantic))
    ]
    return np.concatenate(found)


def _sorted(parts: Sequence[_Edges]) -> _Edges:
    """Return all edges of `parts` in the order of the table's keys."""
    joined = {one.name: np.concatenate([getattr(part, one.name) for part in parts], -1) for one in fields(_Edges)}
    key = joined["room"]
    ids = 1 + max(int(joined[end].max()) for end in ("room", "subject", "target"))
    for name, count in (("subject", ids), ("target", ids), ("kind", len(_KINDS)), ("predicate", len(_PREDICATES))):
        key = key * count + joined[name]
    order = np.argsort(key)
    return _Edges(**{name: values[..., order] for name, values in joined.items()})


def _table(scene_id: str, names: list[str], edges: _Edges) -> pa.Table:
    ids = pa.array(names, pa.string())
    bare = edges.used_metric == _NO_METRIC
    delta = [pa.array(values, pa.float64(), mask=bare) for values in edges.delta]
    columns: dict[str, pa.Array] = {
        "scene_id": pa.array([scene_id], pa.string()).take(pa.array(np.zeros(len(bare), dtype=np.int64))),
        "room_id": ids.take(pa.array(edges.room)),
        "subject": ids.take(pa.array(edges.subject)),
        "predicate": pa.array(_PREDICATES, pa.string()).take(pa.array(edges.predicate)),
        "target": ids.take(pa.array(edges.target)),
        "kind": pa.array(_KINDS, pa.string()).take(pa.array(edges.kind)),
        "delta": pa.StructArray.from_arrays(delta, fields=list(VEC3), mask=pa.array(bare)),
        "used_metric": pa.array(USED_METRICS, pa.string()).take(pa.array(edges.used_metric, mask=bare)),
        "degenerate": pa.array(edges.degenerate),
        "true_in_text": pa.array(edges.true_in_text),
    }
    for name, values in zip(_MEASURES, edges.measures, strict=True):
        columns[name] = pa.array(values, pa.float64(), from_pandas=True)  # NaN becomes null
    return pa.table([columns[field.name] for field in RELATIONS], schema=RELATIONS)


def to_networkx(scene: Scene, relations: Mapping[str, RoomRelations], thresholds: Thresholds) -> nx.MultiDiGraph[str]:
    """Return a directed multigraph: nodes are rooms and objects, edges the rows of the relations table.

    Nodes have ``kind`` (``room`` or ``object``), ``label`` and ``raw_label``; objects also have ``room_id`` and
    ``center``. Each edge goes from subject to target with its predicate as key (a pair has each predicate at most
    once), and has the non-null columns of its row as attributes.
    """
    graph: nx.MultiDiGraph[str] = nx.MultiDiGraph(scene_id=scene.scene_id, family=scene.family)
    for room in scene.rooms:
        graph.add_node(room.room_id, kind="room", label=room.label, raw_label=room.raw_label)
    for item in scene.objects:
        center = tuple(item.center.tolist())
        node = {"label": item.label, "raw_label": item.raw_label, "room_id": item.room_id, "center": center}
        graph.add_node(item.object_id, kind="object", **node)
    for row in relation_table(scene, relations, thresholds).to_pylist():
        subject, target, predicate = (row.pop(key) for key in ("subject", "target", "predicate"))
        known = {key: value for key, value in row.items() if value is not None and key != "scene_id"}
        graph.add_edge(subject, target, key=predicate, predicate=predicate, **known)
    return graph
