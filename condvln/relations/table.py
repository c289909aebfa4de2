"""Write the relations of a scene as one flat table; `RoomRelations.from_table` reads them back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from condvln.relations.compass import CANONICAL
from condvln.relations.metrics import USED_METRICS
from condvln.relations.room import SEMANTIC, RoomRelations
from condvln.relations.text import text_facts
from condvln.scene import RoomArrays, Scene
from schemas.config import Thresholds
from schemas.tables import RELATIONS, SORT_KEYS, VEC3

__all__ = ["CONTAINS", "relation_table"]

F64 = NDArray[np.float64]

CONTAINS: Final = "contains"
"""Predicate of the edge from a room to each of its objects; stored in this direction only."""

_KINDS: Final = ("containment", "canonical", "semantic")


def relation_table(scene: Scene, relations: Mapping[str, RoomRelations], thresholds: Thresholds) -> pa.Table:
    """Return all edges of a scene in the schema `RELATIONS`, sorted by its keys.

    Each room has a containment edge per object (``room contains object``, without metrics), a canonical edge per
    ordered pair whose centres do not coincide, and the semantic edges whose thresholds hold. `margin` and
    `true_in_text` belong to the row's own predicate; predicates that text never uses have no margin.

    relations : by room id, from `relate_scene`
    """
    tables = [RELATIONS.empty_table()]
    for room in scene.rooms:
        tables.append(_containment(scene.scene_id, relations[room.room_id].objects))
        tables.append(_edges(scene.scene_id, relations[room.room_id], thresholds))
    return pa.concat_tables(tables).sort_by([(key, "ascending") for key in SORT_KEYS["relations"]])


def _containment(scene_id: str, objects: RoomArrays) -> pa.Table:
    n = len(objects)
    columns: dict[str, pa.Array] = {
        "scene_id": _constant(scene_id, n),
        "room_id": _constant(objects.room_id, n),
        "subject": _constant(objects.room_id, n),
        "predicate": _constant(CONTAINS, n),
        "target": pa.array(objects.object_ids, pa.string()),
        "kind": _constant("containment", n),
        "degenerate": pa.array(np.zeros(n, dtype=np.bool_)),
        "true_in_text": pa.array(np.zeros(n, dtype=np.bool_)),
    }
    return pa.table([columns.get(f.name, pa.nulls(n, f.type)) for f in RELATIONS], schema=RELATIONS)


def _edges(scene_id: str, relations: RoomRelations, thresholds: Thresholds) -> pa.Table:
    facts = text_facts(relations, thresholds)
    subjects, targets, predicates, kinds, status, margins = [], [], [], [], [], []
    for predicate, kind, i, j in _groups(relations):
        subjects.append(i)
        targets.append(j)
        predicates.append(np.full(len(i), _PREDICATE_CODE[predicate]))
        kinds.append(np.full(len(i), _KINDS.index(kind)))
        in_text = predicate in facts.status
        status.append(facts.status[predicate][i, j] == 1 if in_text else np.zeros(len(i), dtype=np.bool_))
        margins.append(facts.margin[predicate][i, j] if in_text else np.full(len(i), np.nan))
    i, j = np.concatenate(subjects), np.concatenate(targets)
    metrics = relations.metrics
    ids = pa.array(relations.objects.object_ids, pa.string())
    delta = metrics.delta[i, j]
    columns: dict[str, pa.Array] = {
        "scene_id": _constant(scene_id, len(i)),
        "room_id": _constant(relations.room_id, len(i)),
        "subject": ids.take(pa.array(i)),
        "predicate": pa.array(_PREDICATES, pa.string()).take(pa.array(np.concatenate(predicates))),
        "target": ids.take(pa.array(j)),
        "kind": pa.array(_KINDS, pa.string()).take(pa.array(np.concatenate(kinds))),
        "delta": pa.StructArray.from_arrays([pa.array(delta[:, axis]) for axis in range(3)], fields=list(VEC3)),
        "centre_distance": _measured(metrics.centre[i, j]),
        "horizontal_distance": _measured(metrics.horizontal[i, j]),
        "aabb_distance": _measured(metrics.aabb[i, j]),
        "sphere_distance": _measured(metrics.sphere[i, j]),
        "surface_distance": _measured(relations.surface[i, j]),
        "used_distance": _measured(metrics.used[i, j]),
        "used_metric": pa.array(USED_METRICS, pa.string()).take(pa.array(metrics.used_metric[i, j])),
        "azimuth": _measured(metrics.azimuth[i, j]),
        "elevation": _measured(metrics.elevation[i, j]),
        "footprint_overlap": _measured(metrics.footprint_overlap[i, j]),
        "degenerate": pa.array(relations.degenerate[i, j]),
        "true_in_text": pa.array(np.concatenate(status)),
        "margin": _measured(np.concatenate(margins)),
    }
    return pa.table([columns[f.name] for f in RELATIONS], schema=RELATIONS)


_PREDICATES: Final = (*CANONICAL, *SEMANTIC)
_PREDICATE_CODE: Final = {predicate: code for code, predicate in enumerate(_PREDICATES)}


def _groups(relations: RoomRelations) -> Iterator[tuple[str, str, NDArray[np.intp], NDArray[np.intp]]]:
    """Yield (predicate, kind, subjects, targets) for each predicate. Subjects and targets are the indices of the
    objects between which the predicate has an edge.
    """
    for code, predicate in enumerate(CANONICAL):
        i, j = np.nonzero(relations.canonical == code)
        yield predicate, "canonical", i, j
    for predicate in SEMANTIC:
        i, j = np.nonzero(relations.semantic[predicate])
        yield predicate, "semantic", i, j


def _constant(value: str, n: int) -> pa.Array:
    return pa.array([value], pa.string()).take(pa.array(np.zeros(n, dtype=np.int64)))


def _measured(values: F64) -> pa.Array:
    """Return a float column in which NaN ("unknown" in memory) becomes null."""
    return pa.array(values, pa.float64(), from_pandas=True)
