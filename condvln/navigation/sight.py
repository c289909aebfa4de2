"""Lines of sight: what an agent sees of an object from its position.

A line goes from an eye to a point on the object's surface. The point is seen if it is within range and in the field of
view, and nothing blocks the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from condvln.navigation.occluders import Flags, Occluders, Points
from schemas.config import EpisodeConfig, PlacesConfig
from schemas.config.constants import LEVEL_CAMERA
from schemas.errors import UsageError

__all__ = [
    "EDGE",
    "EYE_HEIGHT",
    "Recognition",
    "SightTarget",
    "View",
    "eyes_at",
    "in_view",
    "visible_extent",
    "visible_points",
]

EYE_HEIGHT = 1.25
"""Height in metres of the camera above the agent's feet: habitat-lab's default, which VLN-CE's R2R task keeps."""

EDGE = 1e-9
"""Metres by which a point may lie outside the border of a view and still be inside. So rounding doesn't decide about
points exactly on the border, which are frequent where headings are multiples of 45° and positions whole millimetres.
"""


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


@dataclass(frozen=True, slots=True)
class Recognition:
    """When an agent recognises a thing: enough of it is in free view, and that part appears large enough.

    view : range and field of view
    share : share of the thing's sample points that must be visible
    short, long : least sides in degrees of the rectangle of azimuth × elevation around its visible samples
    """

    view: View
    share: float
    short: float
    long: float

    @classmethod
    def of(cls, places: PlacesConfig, rules: EpisodeConfig) -> Recognition:
        """Return the rule of a configuration, for a level camera that turns: it sees nothing far above or below it."""
        view = View(range=places.sight_range, pitch=LEVEL_CAMERA[1] / 2)
        return cls(view, rules.object_seen, places.seen_degrees.short, places.seen_degrees.long)

    def holds(self, visible: Flags, extent: Points) -> Flags:
        """Return a mask (n,) of the eyes that recognise a thing, from the samples that each one sees, (n, k), and the
        extent of these samples, (n, 2) as :func:`visible_extent` returns it.
        """
        enough = np.count_nonzero(visible, axis=1) >= self.share * visible.shape[1]
        large = (extent >= np.array([self.short, self.long])).all(axis=1)
        return np.asarray(enough & large & visible.any(axis=1))


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
    view : `View`'s range, all around, if not given
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


def visible_extent(eyes: npt.ArrayLike, samples: npt.ArrayLike, visible: npt.ArrayLike) -> Points:
    """Return how large a thing appears from each of n eyes: the sides (n, 2) in degrees, the shorter one first, of the
    rectangle of azimuth × elevation around its visible samples; 0 where none is visible.

    The azimuth is that of the narrowest sector with all visible samples in it, so that a thing all round an eye is
    wide; it is measured along the parallel of the sample nearest to the horizon, so that a thin thing at one's feet is
    not. In the picture of a pinhole camera, level or not, that looks at the thing, a degree is at least about the focal
    length times π / 180 pixels.

    Parameters
    ----------
    eyes : (n, 3) metres, Habitat frame
    samples : (k, 3) metres; visible : (n, k) whether each eye sees each sample
    """
    looking, points = (np.asarray(values, np.float64).reshape(-1, 3) for values in (eyes, samples))
    seen = np.asarray(visible, np.bool_)
    some = np.flatnonzero(seen.any(axis=1))
    found = np.zeros((len(looking), 2))
    if not len(some):
        return found
    seen = seen[some]
    x, y, z = points.T[:, None] - looking[some].T[:, :, None]
    azimuth, elevation = np.degrees(np.arctan2(x, -z)), np.degrees(np.arctan2(y, np.hypot(x, z)))
    # Samples that aren't visible take the place of one that is.
    row, one = np.arange(len(some))[:, None], seen.argmax(axis=1)[:, None]
    around = np.sort(np.where(seen, azimuth, azimuth[row, one]), axis=1)
    gaps = np.diff(around, axis=1, append=around[:, :1] + 360.0)
    tall = np.where(seen, elevation, elevation[row, one])
    wide = (360.0 - gaps.max(axis=1)) * np.cos(np.radians(np.abs(tall).min(axis=1)))
    found[some] = np.sort(np.stack([wide, np.ptp(tall, axis=1)], axis=1), axis=1)
    return found


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


def _inside(x: Points, y: Points, z: Points, view: View, heading: Points | None) -> Flags:
    """Return a mask of the offsets from eyes to points that are within a view. A heading is needed if it matters."""
    with np.errstate(invalid="ignore", over="ignore"):
        inside: Flags = x * x + y * y + z * z <= (view.range + EDGE) ** 2
        if view.pitch is not None:
            inside &= np.abs(y) <= np.hypot(x, z) * math.tan(math.radians(view.pitch)) + EDGE
    if not view.needs_heading or heading is None:
        return inside
    sine, cosine = np.sin(heading), np.cos(heading)
    ahead = -x * sine - z * cosine
    aside = x * cosine - z * sine
    with np.errstate(invalid="ignore"):
        if view.horizontal_fov != 360:
            inside &= np.abs(aside) <= ahead * math.tan(math.radians(view.horizontal_fov / 2)) + EDGE
        if view.vertical_fov is not None:
            inside &= np.abs(y) <= ahead * math.tan(math.radians(view.vertical_fov / 2)) + EDGE
    return inside
