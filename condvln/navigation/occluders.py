"""Occluders of lines of sight: a scene's triangles or, if the scene has no triangles, boxes and walls."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from condvln.navigation.kernels.sight import blocked_looks
from schemas.errors import UsageError

__all__ = ["BoxOccluders", "JoinedOccluders", "MeshOccluders", "Occluders"]

Points = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

TOUCH = 0.01
"""Metres: a hit this near to the target point is the target's own surface, or something lying on it."""

# Metres: bounds with a shorter diagonal are a point. This is trimesh's ``tol.zero``.
_POINT = 100 * float(np.finfo(np.float64).resolution)

# Number of rays cast at once: tens of megabytes of temporaries.
_RAYS = 1 << 18


class MeshOccluders:
    """Triangle occluders, blocking from both sides. Exact up to float32.

    Parameters
    ----------
    vertices : (n, 3) metres, Habitat frame
    faces : (m, 3) int, m > 0

    Raises
    ------
    FormatError : the mesh is malformed
    """

    approximate = False

    def __init__(self, vertices: npt.ArrayLike, faces: npt.ArrayLike) -> None:
        # Imported here because both are slow to load, and boxes need neither.
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        from condvln.navigation.recast.config import checked_triangles

        points, corners = checked_triangles(vertices, faces)
        self._triangles = np.array(points[corners], np.float64, order="C")
        self._caster = RayMeshIntersector(_Surface(points, corners))

    def hidden(self, eyes: Points, points: Points, own: npt.NDArray[np.int64] | None = None) -> Flags:
        """Return a mask (k,) of the lines of sight that are blocked. ``eyes`` and ``points`` are the ends of these
        lines, (k, 3) each, in metres.
        """
        out = np.zeros(len(eyes), bool)
        for begin in range(0, len(eyes), _RAYS):
            part = slice(begin, begin + _RAYS)
            out[part] = self._hidden(eyes[part], points[part])
        return out

    def _hidden(self, eyes: Points, points: Points) -> Flags:
        away = points - eyes
        distance = np.linalg.norm(away, axis=1)
        hidden = np.zeros(len(eyes), bool)
        rays = np.flatnonzero(distance > TOUCH)
        if not len(rays):
            return hidden
        direction = away[rays] / distance[rays, None]
        first = np.asarray(self._caster.intersects_first(eyes[rays], direction), np.int64)
        hit = first >= 0
        rays, first, direction = rays[hit], first[hit], direction[hit]
        hidden[rays] = distances_to_hits(eyes[rays], direction, self._triangles[first]) < distance[rays] - TOUCH
        return hidden


def distances_to_hits(eyes: Points, direction: Points, triangles: Points) -> Points:
    """Return the distance (k,) in metres at which each ray meets its triangle (k, 3, 3).

    It is the distance to the plane of the triangle, limited to the range of the triangle's corners along the ray; for a
    ray parallel to the plane it is the farthest corner.

    eyes, direction : (k, 3) origins in metres and unit vectors
    """
    # Coordinates come first: NumPy adds up long rows, not many short ones.
    ray = np.ascontiguousarray(direction.T)
    away = np.ascontiguousarray(triangles.transpose(1, 2, 0)) - eyes.T
    along = (away * ray).sum(axis=1)
    nearest, farthest = along.min(axis=0), along.max(axis=0)
    (ax, ay, az), (bx, by, bz) = away[1:] - away[0]
    normal = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = (normal * away[0]).sum(axis=0) / (normal * ray).sum(axis=0)
    found: Points = np.clip(np.where(np.isfinite(plane), plane, farthest), nearest, farthest)
    return found


class _Surface:
    """What embree's intersector reads of a mesh. A ``trimesh.Trimesh`` refers to itself, so that it and embree's scene
    would stay in memory until Python's garbage collector runs.
    """

    def __init__(self, vertices: Points, faces: npt.NDArray[np.int64]) -> None:
        self.vertices, self.faces = np.asarray(vertices, np.float64), faces
        used = np.zeros(len(vertices), bool)
        used[faces] = True
        extents = np.ptp(self.vertices[used], axis=0)
        diagonal = float((extents**2).sum() ** 0.5)
        self.scale = diagonal if diagonal >= _POINT else 1.0
        """Diagonal of the bounds of the faces in metres, or 1 if all are one point, as ``trimesh.Trimesh.scale``."""


class BoxOccluders:
    """Solid boxes that replace a scene's surfaces.

    A box that contains the eye or the point does not block, since boxes of neighbouring objects overlap and a shelf's
    box contains the objects in it. The point's own box blocks its far side.

    Parameters
    ----------
    centers, half_extents : (b, 3) metres, Habitat frame
    rotations : (b, 3, 3), their columns the boxes' axes; None for axis-aligned boxes
    headroom : (b,) metres; a box does not block points up to this height above it either, such as things on a table;
        None for 0

    Raises
    ------
    UsageError : shapes do not match, or an extent is negative or not finite
    """

    approximate = True

    def __init__(
        self,
        centers: npt.ArrayLike,
        half_extents: npt.ArrayLike,
        rotations: npt.ArrayLike | None = None,
        headroom: npt.ArrayLike | None = None,
    ) -> None:
        self._centers = np.array(centers, np.float64, order="C").reshape(-1, 3)
        self._half = np.array(half_extents, np.float64, order="C").reshape(-1, 3)
        count = len(self._centers)
        axes = np.broadcast_to(np.eye(3), (count, 3, 3)) if rotations is None else rotations
        self._axes = np.array(axes, np.float64, order="C").reshape(-1, 3, 3)
        above = np.zeros(count) if headroom is None else headroom
        self._headroom = np.array(above, np.float64, order="C").reshape(-1)
        if {len(self._half), len(self._axes), len(self._headroom)} != {count}:
            raise UsageError(
                f"numbers differ: {count} centres, {len(self._half)} extents, {len(self._axes)} rotations and "
                f"{len(self._headroom)} headrooms of boxes"
            )
        sound = np.isfinite(self._centers).all(axis=1) & np.isfinite(self._axes).all(axis=(1, 2))
        sound &= (np.isfinite(self._half) & (self._half >= 0)).all(axis=1)
        if not sound.all():
            raise UsageError(
                "a box has a number that is NaN or infinite, or a negative extent", place=f"box {int(np.argmin(sound))}"
            )

    def hidden(self, eyes: Points, points: Points, own: npt.NDArray[np.int64] | None = None) -> Flags:
        """Return whether each line of sight is blocked; see :meth:`MeshOccluders.hidden`.

        ``own`` (k,) : the box that each point belongs to, in the order in which they were given; -1 for none
        """
        mine = np.full(len(eyes), -1, np.int64) if own is None else np.require(own, np.int64, ["C", "W"])
        begin, end = (np.require(values, np.float64, ["C", "W"]) for values in (eyes, points))
        return blocked_looks(begin, end, mine, self._centers, self._half, self._axes, self._headroom, TOUCH)


class JoinedOccluders:
    """Triangles and boxes together: walls known as surfaces, objects known as boxes.

    ``own`` indexes the boxes.
    """

    approximate = True

    def __init__(self, mesh: MeshOccluders, boxes: BoxOccluders) -> None:
        self._mesh, self._boxes = mesh, boxes

    def hidden(self, eyes: Points, points: Points, own: npt.NDArray[np.int64] | None = None) -> Flags:
        """Return a mask (k,) of the lines of sight that are blocked. ``eyes`` and ``points`` are the ends of these
        lines, (k, 3) each, in metres.
        """
        out = self._boxes.hidden(eyes, points, own)  # boxes first: they are faster
        left = np.flatnonzero(~out)
        out[left] = self._mesh.hidden(eyes[left], points[left])
        return out


Occluders: TypeAlias = MeshOccluders | BoxOccluders | JoinedOccluders
"""What blocks lines of sight; ``approximate`` says whether it is boxes rather than the scene's surfaces."""
