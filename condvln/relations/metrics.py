"""Distances and angles of all ordered pairs of objects in a room, as whole-room arrays.

Arithmetic is in whole millimetres, where float64 is exact: a scene that is shifted by whole millimetres gives the same
bits, and a distance exactly at a threshold compares as equal to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from condvln.arrays import F64

__all__ = ["AABB", "CENTRE", "SPHERE", "USED_METRICS", "PairMetrics", "millimetres", "pair_metrics"]


MILLIMETRES_PER_METRE: Final = 1000.0

USED_METRICS: Final = ("aabb", "sphere", "centre")
"""The distances that decide near and far, in order of preference; `PairMetrics.used_metric` indexes it."""
AABB, SPHERE, CENTRE = range(3)


def millimetres(metres: ArrayLike) -> F64:
    """Return metres as whole millimetres in float64; NaN is kept, −0 becomes 0."""
    whole: F64 = np.rint(np.asarray(metres, dtype=np.float64) * MILLIMETRES_PER_METRE) + 0.0
    return whole


@dataclass(frozen=True, eq=False, slots=True)
class PairMetrics:
    """Arrays over ordered pairs, subject by row and target by column, in metres and degrees.

    delta : (n, n, 3), c_target − c_subject
    centre, horizontal : (n, n), lengths of delta and of its horizontal part
    aabb : (n, n), between boxes; NaN where one is unknown
    sphere : (n, n), between bounding spheres, at least 0; NaN where one is unknown
    used : (n, n), the first available of aabb, sphere, centre
    used_metric : (n, n), the metric in `used`, as an index into `USED_METRICS`
    azimuth : (n, n), of c_subject − c_target in (−180, 180], from east towards north; NaN where horizontal < 1 mm
    elevation : (n, n), of c_subject − c_target in [−90, 90]
    footprint_overlap : (n, n), shared ground area of the two boxes divided by the smaller box's area; NaN where unknown
        or flat
    """

    delta: F64
    centre: F64
    horizontal: F64
    aabb: F64
    sphere: F64
    used: F64
    used_metric: NDArray[np.int8]
    azimuth: F64
    elevation: F64
    footprint_overlap: F64


def pair_metrics(centers: F64, aabb_min: F64, aabb_max: F64, radius: F64) -> PairMetrics:
    """Return the metrics of all pairs of n objects.

    centers, aabb_min, aabb_max : (n, 3) metres; radius : (n,) metres; NaN where unknown
    """
    center, low, high = millimetres(centers), millimetres(aabb_min), millimetres(aabb_max)
    # Subject minus target. North is −z: the operands are swapped rather than negated, so that no −0 arises.
    east = center[:, None, 0] - center[None, :, 0]
    up = center[:, None, 1] - center[None, :, 1]
    north = center[None, :, 2] - center[:, None, 2]
    ground_squared = east * east + north * north
    ground = np.sqrt(ground_squared)
    centre = np.sqrt(ground_squared + up * up) / MILLIMETRES_PER_METRE

    gaps = [_between(low[:, axis], high[:, axis]) for axis in range(3)]
    apart = [np.maximum(gap, 0.0) for gap in gaps]
    aabb = np.sqrt(sum(gap * gap for gap in apart)) / MILLIMETRES_PER_METRE
    sphere = np.maximum(centre - (radius[:, None] + radius[None, :]), 0.0)
    has_aabb, has_sphere = ~np.isnan(aabb), ~np.isnan(sphere)
    return PairMetrics(
        delta=(center[None, :, :] - center[:, None, :]) / MILLIMETRES_PER_METRE,
        centre=centre,
        horizontal=ground / MILLIMETRES_PER_METRE,
        aabb=aabb,
        sphere=sphere,
        used=np.where(has_aabb, aabb, np.where(has_sphere, sphere, centre)),
        used_metric=np.where(has_aabb, AABB, np.where(has_sphere, SPHERE, CENTRE)).astype(np.int8),
        azimuth=np.where(ground > 0, np.degrees(np.arctan2(north, east)), np.nan),
        elevation=np.degrees(np.arctan2(up, ground)),
        footprint_overlap=_footprint_overlap(gaps[0], gaps[2], (high - low)[:, [0, 2]]),
    )


def _between(low: F64, high: F64) -> F64:
    """Return the gap (n, n) between the intervals of each pair of n intervals along one axis. The gap of intervals that
    overlap is negative.
    """
    one_way = low[:, None] - high[None, :]
    gap: F64 = np.maximum(one_way, one_way.T)
    return gap


def _footprint_overlap(gap_x: F64, gap_z: F64, sizes: F64) -> F64:
    """Return, for each pair of n rectangles on the ground, the area that the two share, divided by the area of the
    smaller one. The gaps (n, n) are along x and z; `sizes` (n, 2) are the sides of the rectangles.
    """
    shared_x, shared_z = (
        np.maximum(np.minimum(-gap, np.minimum(size[:, None], size[None, :])), 0.0)
        for gap, size in ((gap_x, sizes[:, 0]), (gap_z, sizes[:, 1]))
    )
    area = sizes[:, 0] * sizes[:, 1]
    smaller = np.minimum(area[:, None], area[None, :])
    overlap: F64 = np.divide(shared_x * shared_z, smaller, out=np.full_like(smaller, np.nan), where=smaller > 0)
    return overlap
