"""The relation graph of a scene as a networkx graph."""

from __future__ import annotations

from collections.abc import Mapping

import networkx as nx

from condvln.relations.room import RoomRelations
from condvln.relations.table import relation_table
from condvln.scene import Scene
from schemas.config import Thresholds

__all__ = ["to_networkx"]


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
