"""The relations of one room, as arrays over all ordered pairs of its objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from condvln.arrays import F64, Bools
from condvln.relations.decisions import edges
from condvln.relations.directions import COINCIDENT, canonical_codes
from condvln.relations.metrics import PairMetrics, pair_metrics
from condvln.relations.solids import MeshOf, surface_distances
from condvln.scene import RoomArrays, Scene
from schemas.config import Thresholds
from schemas.errors import StoreError

__all__ = ["RoomRelations", "relate_room", "relate_scene"]


@dataclass(frozen=True, eq=False)
class RoomRelations:
    """All ordered pairs of a room's n objects; the subject is the row, the target the column.

    objects : the room's objects in order of id: the order of rows and columns
    metrics : distances and angles, see `PairMetrics`
    surface : (n, n) metres, rounded to 1 mm; NaN where not computed or unknown
    canonical : (n, n) index into `CANONICAL`; −1 where centres coincide and on the diagonal
    degenerate : (n, n), centres so close horizontally that the azimuth is unreliable
    semantic : for each predicate of `SEMANTIC`, (n, n) whether the edge exists; False on the diagonal
    """

    objects: RoomArrays
    metrics: PairMetrics
    surface: F64
    canonical: NDArray[np.int8]
    degenerate: Bools
    semantic: Mapping[str, Bools]

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def room_id(self) -> str:
        """Id of the room."""
        return self.objects.room_id

    @classmethod
    def from_table(cls, rows: pa.Table, arrays: RoomArrays, thresholds: Thresholds) -> RoomRelations:
        """Return the relations of one room from its stored rows; no distance is measured again.

        rows : rows of the relations table of one scene, made with the same `thresholds`; rows of other rooms are
            ignored
        arrays : the room's objects

        Raises
        ------
        StoreError
            The rows belong to other objects or were made with other thresholds.
        """
        rows = rows.filter(
            pc.and_(pc.equal(rows["room_id"], arrays.room_id), pc.not_equal(rows["kind"], "containment"))
        )
        ids = pa.array(arrays.object_ids, pa.string())
        subject, target = (pc.index_in(rows[end], value_set=ids) for end in ("subject", "target"))
        metrics = pair_metrics(arrays.centers, arrays.aabb_min, arrays.aabb_max, arrays.radius)
        known = subject.null_count + target.null_count == 0
        if known:
            i, j = subject.to_numpy(), target.to_numpy()
            surface = np.full((len(arrays), len(arrays)), np.nan)
            surface[i, j] = rows["surface_distance"].to_numpy()
            np.fill_diagonal(surface, 0.0)
            found = _decide(arrays, metrics, surface, thresholds)
            edges = (found.canonical != COINCIDENT).sum() + sum(mask.sum() for mask in found.semantic.values())
            if edges == len(rows) and np.array_equal(rows["centre_distance"].to_numpy(), metrics.centre[i, j]):
                return found
        raise StoreError(
            "the stored relations belong to other objects or other thresholds",
            place=f"room {arrays.room_id!r}",
            remedy="Compute the scene's relations again",
        )


def relate_room(arrays: RoomArrays, thresholds: Thresholds, meshes: MeshOf | None = None) -> RoomRelations:
    """Return the relations of one room.

    meshes : returns an object's mesh in the scene's frame; without it, boxes are used for all objects
    """
    metrics = pair_metrics(arrays.centers, arrays.aabb_min, arrays.aabb_max, arrays.radius)
    surface = surface_distances(arrays, metrics.aabb, thresholds.surface_within, meshes)
    return _decide(arrays, metrics, surface, thresholds)


def relate_scene(scene: Scene, thresholds: Thresholds, meshes: MeshOf | None = None) -> dict[str, RoomRelations]:
    """Return the relations of every room of a scene, by room id in the scene's order."""
    return {room.room_id: relate_room(scene.arrays(room.room_id), thresholds, meshes) for room in scene.rooms}


def _decide(arrays: RoomArrays, metrics: PairMetrics, surface: F64, thresholds: Thresholds) -> RoomRelations:
    """Return the relations of a room, with the predicates that follow from its metrics, surface distances and
    thresholds.
    """
    dy = -metrics.delta[..., 1] + 0.0
    others = ~np.eye(len(arrays), dtype=np.bool_)
    canonical = canonical_codes(metrics.azimuth, metrics.elevation, dy, thresholds.level)
    return RoomRelations(
        objects=arrays,
        metrics=metrics,
        surface=surface,
        canonical=np.where(others, canonical, COINCIDENT).astype(np.int8),
        degenerate=(metrics.horizontal < thresholds.degenerate_horizontal) & others,
        semantic={predicate: mask & others for predicate, mask in edges(metrics, thresholds).items()},
    )
