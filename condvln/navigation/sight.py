"""Lines of sight: what an agent sees of an object from its position.

A line goes from an eye to a point on the object's surface. The point is seen if it is within range and in the field of
view, and nothing blocks the line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.compiled import register_warm_up
from condvln.navigation.kernels.lines import lines_in_range
from condvln.navigation.occluders import Flags, Occluders, Points
from schemas.errors import UsageError

__all__ = [
    "EYE_HEIGHT",
    "Look",
    "SightTarget",
    "View",
    "eyes_at",
    "first_sights",
    "in_view",
    "lines_in_view",
    "visible_points",
    "visible_shares",
    "visible_to_each",
]

EYE_HEIGHT = 1.25
"""Height in metres of the camera above the agent's feet: habitat-lab's default, which VLN-CE's R2R task keeps."""


@dataclass(frozen=True, slots=True)
class View:
    """The range and field of view of an agent.

    range : metres from the eye, inclusive
    horizontal_fov : degrees; 360 looks all around, else below 180
    vertical_fov : degrees below 180, of a level pinhole camera; None for no limit
    pitch : degrees below 90 above and below level; None for no limit
    """

    range: float = 5.0
    horizontal_fov: float = 360.0
    vertical_fov: float | None = None
    pitch: float | None = None

    def __post_init__(self) -> None:
        if not self.range > 0:
            raise UsageError(f"a view of range {self.range} m sees nothing", remedy="Give a positive range")
        if self.horizontal_fov != 360 and not 0 < self.horizontal_fov < 180:
            raise UsageError(
                f"the horizontal field of view can't be {self.horizontal_fov}°", remedy="Give 360, or less than 180"
            )
        if self.vertical_fov is not None and not 0 < self.vertical_fov < 180:
            raise UsageError(
                f"the vertical field of view can't be {self.vertical_fov}°", remedy="Give less than 180, or none"
            )

        if self.pitch is not None and not 0 < self.pitch < 90:
            raise UsageError(f"the pitch can't be {self.pitch}°", remedy="Give less than 90, or none")

    @property
    def needs_heading(self) -> bool:
        """Whether the agent's heading matters."""
        return self.horizontal_fov != 360 or self.vertical_fov is not None


@dataclass(frozen=True, eq=False)
class SightTarget:
    """An object to look for.

    samples : (k, 3) points of its surface
    own : index of the occluder that is the object's own box, or (k,) one index per sample; -1 for none
    """

    samples: Points
    own: int | npt.NDArray[np.int64] = -1

    @property
    def owners(self) -> npt.NDArray[np.int64]:
        """The occluder that each sample belongs to: the argument `own` of :func:`visible_points`."""
        return np.broadcast_to(np.asarray(self.own, dtype=np.int64), len(self.samples))


def eyes_at(positions: npt.ArrayLike, height: float = EYE_HEIGHT) -> Points:
    """Return the positions of agents' eyes, (n, 3) in metres: ``height`` above the positions of their feet, (n, 3)."""
    eyes: Points = np.asarray(positions, np.float64).reshape(-1, 3) + np.array([0.0, height, 0.0])
    return eyes


def visible_points(
    occluders: Occluders,
    eyes: npt.ArrayLike,
    points: npt.ArrayLike,
    view: View | None = None,
    headings: npt.ArrayLike | None = None,
    own: npt.ArrayLike | None = None,
) -> Flags:
    """Return a mask (n, m): whether each of n eyes sees each of m points.

    Parameters
    ----------
    eyes : (n, 3) metres, Habitat frame; a non-finite one sees nothing
    points : (m, 3) metres
    view : 5 m all around if not given
    headings : (n,) radians counter-clockwise from −z, for a view that does not look all around
    own : (m,) index of the occluder that each point belongs to, -1 for none

    Raises
    ------
    UsageError : the view needs headings and none are given, or shapes do not match
    """
    view = view or View()
    looking, seen = (np.asarray(values, np.float64).reshape(-1, 3) for values in (eyes, points))
    belongs = np.full(len(seen), -1, np.int64) if own is None else np.asarray(own, np.int64)
    if belongs.shape != (len(seen),):
        raise UsageError(f"there are {len(seen)} points, but `own` has the shape {belongs.shape}")
    visible = in_view(looking, seen, view, headings)
    eye, point = np.nonzero(visible)
    visible[eye, point] = ~occluders.hidden(looking[eye], seen[point], belongs[point])
    return visible


class Look(NamedTuple):
    """Eyes (n, 3) in metres that look for a target in any direction."""

    eyes: Points
    target: SightTarget
    view: View


def visible_to_each(occluders: Occluders, looks: Sequence[Look]) -> list[Flags]:
    """Return for each look a mask (n, k): whether each of its n eyes sees each of the k samples of its target. The
    masks are those of :func:`visible_points`; the lines of all looks are tested together.

    Raises
    ------
    UsageError : a view needs headings
    """
    if any(view.needs_heading for _, _, view in looks):
        raise UsageError("a look in any direction can't have a limited field of view")
    first_eye = np.cumsum([0, *(len(eyes) for eyes, _, _ in looks)], dtype=np.int64)
    first_point = np.cumsum([0, *(len(target.samples) for _, target, _ in looks)], dtype=np.int64)
    eyes, points = (
        np.concatenate([np.empty((0, 3)), *parts], dtype=np.float64)
        for parts in ([look.eyes for look in looks], [look.target.samples for look in looks])
    )
    reach = np.array([view.range**2 for _, _, view in looks], np.float64)
    line, eye, point = lines_in_range(eyes, points, first_eye, first_point, reach)
    begin, end = eyes[eye], points[point]
    if any(view.pitch is not None for _, _, view in looks):
        steepest = [math.inf if view.pitch is None else math.tan(math.radians(view.pitch)) for _, _, view in looks]
        slope = np.repeat(steepest, np.diff(first_eye))[eye]
        x, y, z = (end - begin).T
        with np.errstate(invalid="ignore"):  # straight up or down, without a limit: 0 times infinity
            kept = np.isinf(slope) | (np.abs(y) <= np.hypot(x, z) * slope)
        line, point, begin, end = line[kept], point[kept], begin[kept], end[kept]
    own = np.concatenate([np.empty(0, np.int64), *(target.owners for _, target, _ in looks)])[point]
    sizes = np.diff(first_eye) * np.diff(first_point)
    visible = np.zeros(int(sizes.sum()), bool)
    visible[line[~occluders.hidden(begin, end, own)]] = True
    parts = pairwise(np.cumsum([0, *sizes]).tolist())
    return [visible[i:j].reshape(len(look.eyes), -1) for look, (i, j) in zip(looks, parts, strict=True)]


def in_view(eyes: Points, points: Points, view: View, headings: npt.ArrayLike | None = None) -> Flags:
    """Return a mask (n, m): whether each of m points is in the range and field of view of each of n eyes. Occluders are
    ignored.

    Raises
    ------
    UsageError : the view needs one heading per eye
    """
    heading: Points | None = None
    if view.needs_heading:
        if headings is None:
            raise UsageError(
                "the view has a limited field of view, but no headings were given", remedy="Give one heading per eye"
            )
        heading = np.asarray(headings, np.float64).reshape(-1, 1)
        if len(heading) != len(eyes):
            raise UsageError(f"there are {len(eyes)} eyes but {len(heading)} headings")
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = (points[None, :, axis] - eyes[:, None, axis] for axis in range(3))
    return _inside(x, y, z, view, heading)


def lines_in_view(eyes: Points, points: Points, view: View, headings: Points) -> Flags:
    """Return a mask (n,): whether each of n points (n, 3) is in the range and field of view of its own eye (n, 3),
    which looks along its own heading (n,). The values are those of :func:`in_view`.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = (points - eyes).T
    return _inside(x, y, z, view, headings)


def _inside(x: Points, y: Points, z: Points, view: View, heading: Points | None) -> Flags:
    """Return a mask of the offsets from eyes to points that are within a view. A heading is needed if it matters."""
    with np.errstate(invalid="ignore", over="ignore"):
        inside: Flags = x * x + y * y + z * z <= view.range**2
        if view.pitch is not None:
            inside &= np.abs(y) <= np.hypot(x, z) * math.tan(math.radians(view.pitch))
    if not view.needs_heading or heading is None:
        return inside
    sine, cosine = np.sin(heading), np.cos(heading)
    ahead = -x * sine - z * cosine
    aside = x * cosine - z * sine
    with np.errstate(invalid="ignore"):
        if view.horizontal_fov != 360:
            inside &= np.abs(aside) <= ahead * math.tan(math.radians(view.horizontal_fov / 2))
        if view.vertical_fov is not None:
            inside &= np.abs(y) <= ahead * math.tan(math.radians(view.vertical_fov / 2))
    return inside


def visible_shares(
    occluders: Occluders,
    eyes: npt.ArrayLike,
    targets: Sequence[SightTarget],
    view: View | None = None,
    headings: npt.ArrayLike | None = None,
) -> Points:
    """Return a table (n, t) that holds, for each of n eyes and each of t targets, the share (0 to 1) of the target's
    samples that the eye sees. All shares are computed as one batch.
    """
    sizes = np.array([len(target.samples) for target in targets], np.int64)
    if (sizes == 0).any():
        raise UsageError("a target has no samples", place=f"target {int(np.argmin(sizes))}")
    count = len(np.asarray(eyes, np.float64).reshape(-1, 3))
    if not len(targets):
        return np.zeros((count, 0))
    points = np.concatenate([target.samples for target in targets])
    own = np.concatenate([target.owners for target in targets])
    seen = visible_points(occluders, eyes, points, view, headings, own)
    shares: Points = np.add.reduceat(seen.astype(np.float64), np.cumsum(sizes) - sizes, axis=1) / sizes
    return shares


def first_sights(
    occluders: Occluders,
    path: npt.ArrayLike,
    targets: Sequence[SightTarget],
    view: View | None = None,
    headings: npt.ArrayLike | None = None,
    least_share: float = 0.0,
) -> npt.NDArray[np.int64]:
    """Return, for each of t targets, the index of the first eye of ``path`` (n, 3) that sees more than ``least_share``
    of the target; -1 if no eye does.
    """
    seen = visible_shares(occluders, path, targets, view, headings) > least_share
    if not len(seen):
        return np.full(len(targets), -1, np.int64)
    return np.where(seen.any(axis=0), seen.argmax(axis=0), -1)


def _warm_up() -> None:
    lines_in_range(np.eye(3), np.eye(3), np.array([0, 3]), np.array([0, 3]), np.ones(1))


register_warm_up("lines of sight in range", _warm_up)
