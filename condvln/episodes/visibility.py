"""Compute which objects an agent can see, at its eye height, from at least one standing position in the object's room.

An object is *seeable* if a level camera recognises it from several positions, and so large a share of its surface is
visible that other sample points would give the same result. It is *unseen* if none of many sample points is visible
from any position. In between it is neither: text does not mention it, nor make statements whose truth could depend on
it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from condvln.arrays import F64, Bools
from condvln.episodes.floor import standing_points
from condvln.episodes.footprint import Obstacles
from condvln.episodes.view import SceneView
from condvln.labels import vocabulary
from condvln.navigation.protocol import PathfinderProtocol
from condvln.navigation.sight import Recognition, View, eyes_at, in_view, visible_extent
from condvln.scene import Scene, SceneObject
from condvln.scene.scene import Sightings
from schemas.config.constants import SEEABLE_IN_FRAME, SEEABLE_PLACES, SEEABLE_SHARE
from schemas.tables import VISIBILITY

__all__ = ["Visibility", "scene_visibility", "sightings_from_table", "visibility_table"]


FIRST_PLACES: Final = 32
"""Number of positions from which every object is looked for; the others are used only if these do not suffice."""
CLOSE_SAMPLES: Final = 512
"""Number of surface points tested then: all miss a visible part of 1 % of the surface once in 170 times."""
_ANY_DISTANCE: Final = View(range=float("inf"))


@dataclass(frozen=True, slots=True)
class Visibility:
    """What is visible of one object from the positions in its room where an agent can stand.

    places : number of positions tested
    from_places : number of positions from which some of it is visible
    share : share of its surface that is visible from all positions together
    nearest_view : horizontal metres from its centre to the nearest position that sees it; None if there is none
    degrees : how large it appears (`SceneView.degrees`) from the best of the positions; None if it is not recognised
    seeable, unseen : see the module; never both
    """

    object_id: str
    places: int
    from_places: int
    share: float
    nearest_view: float | None
    degrees: float | None
    seeable: bool
    unseen: bool


def scene_visibility(
    scene: Scene,
    view: SceneView,
    pathfinder: PathfinderProtocol,
    islands: Sequence[int],
    eye_height: float,
    rule: Recognition,
    obstacles: Obstacles = (),
) -> list[Visibility]:
    """Return the visibility of every object that is not part of the building, sorted by id.

    Unnamed objects are included, since a word may refer to them.

    islands : navmesh islands that episodes may use
    eye_height : metres above the floor
    rule : when an object is recognised
    obstacles : furniture that the navmesh ignores; no agent stands in it
    """
    things = _things(scene)
    found: dict[str, Visibility] = {}
    for room in scene.rooms:
        eyes = eyes_at(standing_points(scene, room, pathfinder, islands, obstacles), eye_height)
        few = eyes[np.unique(np.linspace(0, len(eyes) - 1, min(FIRST_PLACES, len(eyes))).round().astype(int))]
        open_ones = [item for item in things if item.room_id == room.room_id and not item.hidden]
        for item in open_ones:
            target = view.target(item.object_id)
            looked, lines = few, view.seen(few, target, _ANY_DISTANCE)
            near = lines & in_view(few, target.samples, rule.view)
            extent = visible_extent(few, target.samples, near)
            one = _visibility(item, looked, lines, np.where(rule.holds(near, extent), extent[:, 0], 0.0))
            if not one.seeable and len(eyes):
                if one.share < SEEABLE_SHARE or one.from_places < SEEABLE_PLACES:
                    denser = view.denser_target(item.object_id, CLOSE_SAMPLES)
                    looked, lines = eyes, view.seen(eyes, denser, _ANY_DISTANCE)
                one = _visibility(item, looked, lines, view.degrees(eyes, item.object_id, rule))
            found[item.object_id] = one
    return [found.get(item.object_id) or _from_nowhere(item) for item in things]


def _things(scene: Scene) -> list[SceneObject]:
    found = [item for item in scene.objects if not vocabulary.is_structure(item.label)]
    return sorted(found, key=lambda item: item.object_id)


def _from_nowhere(item: SceneObject) -> Visibility:
    """Return the visibility of an object that nothing can be seen of, or whose room is unknown."""
    return _visibility(item, np.empty((0, 3)), np.zeros((0, 1), bool), np.empty(0))


def _visibility(item: SceneObject, eyes: F64, lines: Bools, degrees: F64) -> Visibility:
    """Return the visibility of an object. `lines` (n, k) says which of its k sample points each of the `eyes` (n, 3)
    sees, `degrees` (n,) how large it appears from each; 0 where it is not recognised.
    """
    seeing, seen = eyes[lines.any(axis=1)], lines.any(axis=0)
    away = seeing - item.center
    square = away[:, 0] * away[:, 0] + away[:, 2] * away[:, 2]
    share = float(seen.mean())
    # Looking walks look from places that are farther apart than those tested here.
    least = min(SEEABLE_PLACES, len(eyes))
    enough = len(seeing) >= least and int(np.count_nonzero(degrees)) >= max(least, SEEABLE_IN_FRAME * len(degrees))
    return Visibility(
        object_id=item.object_id,
        places=len(eyes),
        from_places=len(seeing),
        share=round(share, 3),
        nearest_view=round(math.sqrt(float(square.min())), 3) if len(away) else None,
        degrees=round(float(degrees.max()), 2) if degrees.any() else None,
        seeable=share >= SEEABLE_SHARE and enough,
        unseen=not seen.any(),
    )


def visibility_table(scene: Scene, found: Iterable[Visibility] | None) -> pa.Table:
    """Return the rows of the visibility table. If `found` is None, since no positions are known, the visibility values
    are null.
    """
    rows: list[dict[str, Any]]
    if found is None:
        unknown = dict.fromkeys(VISIBILITY.names)
        rows = [{**unknown, "scene_id": scene.scene_id, "object_id": item.object_id} for item in _things(scene)]
    else:
        rows = [{"scene_id": scene.scene_id, **asdict(one)} for one in found]
    return pa.Table.from_pylist(rows, schema=VISIBILITY)


def sightings_from_table(table: pa.Table) -> Sightings:
    """Return, from the visibility table, the ids of the objects that can't be seen, the ids of those whose visibility
    is in doubt, and how large the others appear. All are empty if the table's visibility values are null.
    """
    columns: Mapping[str, list[Any]] = table.select(["object_id", "seeable", "unseen", "degrees"]).to_pydict()
    rows = list(zip(*columns.values(), strict=True))
    unseen = frozenset(name for name, _, out_of_sight, _ in rows if out_of_sight)
    doubtful = frozenset(name for name, seeable, _, _ in rows if seeable is False)
    degrees = {name: float(side) for name, _, _, side in rows if side is not None}
    return Sightings(unseen, doubtful - unseen, degrees)
