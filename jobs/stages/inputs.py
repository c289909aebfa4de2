"""Inputs of the stages of a scene: its source, its scene, its navmesh and its surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from condvln.episodes.steps import Walkable
from condvln.episodes.view import SceneView
from condvln.instructions import LabelPriors, PriorBits, programs_from_table
from condvln.navigation.navmesh_file import parse_navmesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.relations import RoomRelations, TextFacts, text_facts
from condvln.scene import Scene
from condvln.scene.tables import scene_from_tables
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from factory.stage import Unit
from schemas.canonical import JSON
from schemas.config import (
    InstructionsConfig,
    LimitsConfig,
    PlacesConfig,
    SamplingConfig,
    Section,
    Thresholds,
    WordingConfig,
)
from schemas.program import Program

__all__ = [
    "NAVMESHES",
    "Tables",
    "asked_of",
    "bits_of",
    "dump",
    "facts_of",
    "navmeshes_table",
    "pathfinder_of",
    "programs_of",
    "scene_of",
    "source_of",
    "walkable_of",
]


Tables = Mapping[str, pa.Table]

NAVMESHES: Final = pa.schema([("scene_id", pa.string()), ("data", pa.large_binary())])
"""Table of built navmeshes, kept in the unit for later stages and for the export; it is not published."""


def navmeshes_table(scene_id: str, data: bytes | None) -> pa.Table:
    rows = [] if data is None else [{"scene_id": scene_id, "data": data}]
    return pa.Table.from_pylist(rows, schema=NAVMESHES)


DEFAULT_LIMITS: Final = LimitsConfig()


OPENED_BY: Final = ("family", "root", "navmesh", "regions", "houses", "connectivity", "absence")
"""Keys of a unit's payload that say how its dataset is opened."""


@lru_cache(maxsize=8)
def _source(limits: LimitsConfig, *named: tuple[str, Any]) -> Source:
    """Return the reader of a dataset, one per process, so that shared files are read once."""
    return open_source(**dict(named), limits=limits)


def source_of(unit: Unit, limits: LimitsConfig = DEFAULT_LIMITS) -> Source:
    """Return the reader of a unit's dataset. Only readers of whole scenes get the size limits."""
    return _source(limits, *((name, unit.payload[name]) for name in OPENED_BY if name in unit.payload))


V = TypeVar("V")


class _Latest(Generic[V]):
    """A cache of one value. The value is made from parts, and stays valid as long as each request comes with the same
    parts.

    The stages of one scene follow each other in a process and read the same tables, so one is enough.
    """

    def __init__(self) -> None:
        self._kept: tuple[tuple[object, ...], V] | None = None

    def get(self, parts: tuple[object, ...], make: Callable[[], V]) -> V:
        """Return the cached value if each of `parts` is the same object as before or equal to it; else call `make`."""
        kept = self._kept
        if kept is not None and len(kept[0]) == len(parts) and all(map(_same, kept[0], parts)):
            return kept[1]
        self._kept = None  # freed before the next one is made
        made = make()
        self._kept = (parts, made)
        return made


def _same(one: object, other: object) -> bool:
    if one is other:
        return True
    if isinstance(one, pa.Table):  # the factory makes a table anew; equal rows make equal things
        return isinstance(other, pa.Table) and one.equals(other)
    return isinstance(one, (str, float)) and one == other


_scenes: Final[_Latest[Scene]] = _Latest()
_walkables: Final[_Latest[Walkable]] = _Latest()
_priors: Final[_Latest[LabelPriors]] = _Latest()
_bits: Final[_Latest[PriorBits]] = _Latest()


def scene_of(unit: Unit, tables: Tables) -> Scene:
    """Return the scene that a unit's tables describe; stages that read the same tables get the same object."""
    root, family = str(unit.payload["root"]), str(unit.payload["family"])
    parts = (root, family, *(tables[name] for name in ("scenes", "rooms", "objects")))
    return _scenes.get(parts, lambda: scene_from_tables(tables, Path(root), family=family))


def pathfinder_of(scene: Scene, tables: Tables) -> Pathfinder:
    """Open a pathfinder over the navmesh that the scene stage chose or built."""
    assert scene.navmesh is not None
    if scene.navmesh.built:
        return Pathfinder(parse_navmesh(tables["navmeshes"]["data"][0].as_py(), scene.navmesh.path))
    return Pathfinder.load(scene.root / scene.navmesh.path)


def walkable_of(unit: Unit, scene: Scene, tables: Tables, max_climb: float) -> Walkable | None:
    """Return the places where an agent can walk in the scene, with what it sees there; None if the scene has no
    navmesh.
    """
    if scene.navmesh is None:
        return None

    def make() -> Walkable:
        view = SceneView(scene, source_of(unit).geometry(scene))
        return Walkable(pathfinder_of(scene, tables), view, max_climb)

    return _walkables.get((scene, unit, tables["navmeshes"], max_climb), make)


def facts_of(scene: Scene, relations: pa.Table, thresholds: Thresholds) -> Mapping[str, TextFacts]:
    """Return what text may state about a scene's rooms, by room id, from the scene's table of relations."""
    rooms = (scene.arrays(room.room_id) for room in scene.rooms)
    found = (RoomRelations.from_table(relations, arrays, thresholds) for arrays in rooms)
    return {one.room_id: text_facts(one, thresholds) for one in found}


def bits_of(
    scene: Scene, priors: pa.Table, sampling: SamplingConfig, directions: str, places: PlacesConfig
) -> PriorBits:
    """Return the bits of the priors that a scene reads: the stage's key needs them, and then the stage itself."""

    def read() -> PriorBits:
        counts = _priors.get((priors,), lambda: LabelPriors.from_table(priors))
        asked = sampling.label_only(scene.single_room)
        return counts.bits(scene, sampling.plausible_share, sampling.predicates, directions, asked, places)

    return _bits.get((scene, priors, sampling, directions, places), read)


def programs_of(table: pa.Table, names: pa.ChunkedArray) -> dict[str, Program]:
    """Return the programs with the instruction ids `names` by their ids, in the order of a table of programs."""
    return dict(programs_from_table(table.filter(pc.is_in(table["instruction_id"], value_set=names))))


def dump(section: Section) -> dict[str, JSON]:
    document: dict[str, JSON] = section.model_dump(mode="json")
    return document


def asked_of(instructions: InstructionsConfig) -> dict[str, JSON]:
    """Return the configuration of instructions without their wording."""
    said = InstructionsConfig.model_fields.keys() & WordingConfig.model_fields.keys()
    return {key: value for key, value in dump(instructions).items() if key not in said}
