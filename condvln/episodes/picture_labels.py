"""Place labels on a plan so that none covers another label or a mark."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Text
from numpy.typing import NDArray

__all__ = ["Label", "place_labels"]

F64 = NDArray[np.float64]

GAP: Final = 2.0
"""Least distance between two labels, pixels."""
STEP: Final = 7.0
"""Distance between two rings of positions that are tried, pixels."""
RINGS: Final = 40
"""Number of rings that are tried for a label that must be placed."""
NEARBY: Final = 2
"""The same for a label that may be left out."""
DIRECTIONS: Final = 16
"""Number of positions on a ring."""
LED: Final = 12.0
"""Shift in pixels from which a line joins a label to its place."""


@dataclass(frozen=True)
class Label:
    """A text to write at the place (x, z), in metres. A label that is not `needed` is left out if there is no room for
    it.
    """

    text: str
    x: float
    z: float
    colour: str = "#333333"
    size: float = 6.0
    needed: bool = False
    bold: bool = False


def place_labels(axes: Axes, labels: Sequence[Label], marks: Iterable[tuple[float, float, float]] = ()) -> list[Text]:
    """Add labels to a plan, the needed ones first, and return the texts that were added.

    The limits and the position of `axes` must be final, since the labels are placed by their sizes in pixels.

    Parameters
    ----------
    marks : x, z in metres, and the radius in pixels of what no label may cover
    """
    frame = np.array(axes.get_window_extent().extents)
    taken: list[F64] = []
    for x, z, radius in marks:
        column, row = axes.transData.transform((x, z))
        taken.append(np.array([column - radius, row - radius, column + radius, row + radius]))
    added = []
    for label in sorted(labels, key=lambda one: not one.needed):
        text = axes.text(
            label.x,
            label.z,
            label.text,
            color=label.colour,
            fontsize=label.size,
            weight="bold" if label.bold else "normal",
            ha="center",
            va="center",
            zorder=6,
        )
        box = np.array(text.get_window_extent().padded(GAP).extents)
        shift = _free_shift(box, np.array(taken).reshape(-1, 4), frame, RINGS if label.needed else NEARBY)
        if shift is None:
            text.remove()
            continue
        taken.append(box + np.tile(shift, 2))
        anchor = axes.transData.transform((label.x, label.z))
        place = axes.transData.inverted().transform(anchor + shift)
        text.set_position((float(place[0]), float(place[1])))
        if np.hypot(*shift) >= LED:
            axes.plot([label.x, place[0]], [label.z, place[1]], color=label.colour, linewidth=0.6, alpha=0.6, zorder=5)
        added.append(text)
    return added


def _free_shift(box: F64, taken: F64, frame: F64, rings: int) -> F64 | None:
    """Return the shortest of the tried shifts (2,), in pixels, that moves a box (left, bottom, right, top) to a place
    within the frame where it overlaps no box of `taken`; None if no tried shift does.
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    radii = STEP * np.arange(1, rings + 1)
    shifts = np.concatenate([np.zeros((1, 2)), (radii[:, None, None] * unit).reshape(-1, 2)])
    boxes = box + np.tile(shifts, 2)
    inside = (boxes[:, :2] >= frame[:2]).all(axis=1) & (boxes[:, 2:] <= frame[2:]).all(axis=1)
    apart = (boxes[:, None, :2] >= taken[None, :, 2:]) | (boxes[:, None, 2:] <= taken[None, :, :2])
    free = inside & apart.any(axis=2).all(axis=1)
    return np.asarray(shifts[int(np.argmax(free))], np.float64) if free.any() else None
