"""Habitat's form of ProcTHOR (``ai2thor-hab``): scene instances, whose rooms are only in the houses' own JSON.

A scene and its house are matched by name: ``ProcTHOR-Train-293`` is line 293 of ``train.jsonl``. The match is verified
by their objects, which must have the same positions: either in Unity's coordinates with z mirrored, or, as glTF
exporters write it, with x mirrored, which is rotated by 180°.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from scipy.spatial import cKDTree

from condvln.scene import Room, SceneObject
from condvln.sources.input_ledger import InputLedger
from condvln.sources.procthor import ProcthorSource
from condvln.sources.procthor_house import House
from condvln.sources.replicacad import Assembly, ReplicaCadSource
from condvln.sources.scene_choice import SceneChoice
from condvln.sources.scene_source import Note, SourceOptions
from schemas.errors import FormatError

__all__ = ["ProcthorHabitatSource"]

_NAME: Final = re.compile(r"^(?:.*/)?ProcTHOR-(?P<split>[A-Za-z]+)-(?P<number>0|[1-9][0-9]{0,8})$")

SAME_PLACE: Final = 0.25
"""Largest distance in metres between the centres of an object's box in the house and of its mesh in the scene."""

LEAST_SHARE: Final = 0.5
"""Least share of a house's objects that must be found in the scene; some of Habitat's have no mesh or another pivot."""


class ProcthorHabitatSource(ReplicaCadSource):
    """Scenes ``ProcTHOR-<Split>-<n>`` of a Habitat scene dataset; its other scenes have no houses and are left out."""

    family: ClassVar[str] = "procthor"

    def __init__(self, root: Path, options: SourceOptions, houses: Path) -> None:
        super().__init__(root, options)
        self._houses = ProcthorSource(houses, replace(options, choice=SceneChoice(), navmesh=None, regions=None))

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `SceneSource.listing`."""
        for scene_id, note in super().listing():
            if _NAME.match(scene_id):
                yield scene_id, partial(self._note, scene_id, note)

    def _note(self, scene_id: str, note: Note, ledger: InputLedger) -> None:
        note(ledger)
        name, data = self._houses.record(_house_id(scene_id))
        ledger.record(f"houses/{name}", data)

    def _rooms(self, scene_id: str, assembly: Assembly, objects: Sequence[SceneObject]) -> tuple[Room, ...]:
        """Return the user's zones if there are any, else the house's rooms."""
        if any(room.annotation == "user" for room in assembly.regions):
            return assembly.regions
        house_id = _house_id(scene_id)
        house = self._houses.house(house_id)
        turn = _turn(house, objects)
        if turn is None:
            raise FormatError(
                f"the objects of house {house_id!r} are not where scene {scene_id!r} has them: the two do not match",
                where=self._houses.root,
                place=house_id,
                remedy="Use the houses of the same release as Habitat's scenes, one per line, in a file for each split",
            )
        return tuple(
            replace(room, polygon=None if room.polygon is None else room.polygon * turn + 0.0)
            for room in self._houses.rooms(house)
        )


def _house_id(scene_id: str) -> str:
    named = _NAME.match(scene_id)
    assert named is not None
    return f"{named['split'].lower()}-{named['number']}"


def _turn(house: House, objects: Sequence[SceneObject]) -> int | None:
    """Return 1 if the objects of house and scene are in the same places, −1 if they are in the same places after the
    house is turned by 180°, None otherwise.
    """
    if not house.objects or not objects:
        return 1
    tree = cKDTree(np.array([item.center for item in objects]))
    places = np.array([item.position for item in house.objects])
    shares = {}
    for turn in (1, -1):
        distance, _ = tree.query(places * [turn, 1, turn])
        shares[turn] = float((distance <= SAME_PLACE).mean())
    best = max(shares, key=lambda turn: shares[turn])
    return best if shares[best] >= LEAST_SHARE else None
