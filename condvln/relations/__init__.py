"""Relations of a scene: metrics and predicates of all pairs of objects, and the facts that text may use."""

from condvln.relations.decisions import PAIR_PREDICATES, SEMANTIC
from condvln.relations.directions import CANONICAL, COMPASS, SECTORS
from condvln.relations.metrics import PairMetrics, pair_metrics
from condvln.relations.room import RoomRelations, relate_room, relate_scene
from condvln.relations.solids import MeshOf, surface_distances
from condvln.relations.table import CONTAINS, relation_table, to_networkx
from condvln.relations.text import SIZE_PREDICATES, TEXT_PREDICATES, TextFacts, text_facts

__all__ = [
    "CANONICAL",
    "COMPASS",
    "CONTAINS",
    "PAIR_PREDICATES",
    "SECTORS",
    "SEMANTIC",
    "SIZE_PREDICATES",
    "TEXT_PREDICATES",
    "MeshOf",
    "PairMetrics",
    "RoomRelations",
    "TextFacts",
    "pair_metrics",
    "relate_room",
    "relate_scene",
    "relation_table",
    "surface_distances",
    "text_facts",
    "to_networkx",
]
