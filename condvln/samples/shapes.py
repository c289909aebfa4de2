"""The parts of a piece of furniture: boxes in the unit cube, one list for each shape of the catalogue.

Shapes are simple, but more than single boxes: tables have legs, sofas arms, shelves boards. A part is
(x0, x1, y0, y1, z0, z1) as shares of width, height (up) and depth (the front is z = 1). Every shape touches all six
faces of the cube and has one part that spans the whole plan, so that a rotated piece has the extent of its box.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["SHAPES", "Part", "part_boxes"]


class Part(NamedTuple):
    """One box of a shape. Its bounds are shares, from 0 to 1, of the whole shape's width, height and depth."""

    x0: float
    x1: float
    y0: float
    y1: float
    z0: float
    z1: float


def _legs(y0: float, y1: float, thick: float = 0.1, inset: float = 0.02) -> tuple[Part, ...]:
    near, far = (inset, inset + thick), (1 - inset - thick, 1 - inset)
    return tuple(Part(*x, y0, y1, *z) for x in (near, far) for z in (near, far))


def _shelf() -> tuple[Part, ...]:
    boards = [Part(0.04, 0.96, y, y + 0.03, 0.06, 0.98) for y in (0.22, 0.42, 0.62, 0.82)]
    return (
        Part(0, 1, 0, 0.04, 0, 1),
        Part(0, 0.04, 0.04, 0.96, 0, 1),
        Part(0.96, 1, 0.04, 0.96, 0, 1),
        Part(0.04, 0.96, 0.04, 0.96, 0, 0.06),
        *boards,
        Part(0, 1, 0.96, 1, 0, 1),
    )


def _tub() -> tuple[Part, ...]:
    return (
        Part(0, 1, 0, 0.12, 0, 1),
        Part(0, 0.1, 0.12, 1, 0, 1),
        Part(0.9, 1, 0.12, 1, 0, 1),
        Part(0.1, 0.9, 0.12, 1, 0, 0.1),
        Part(0.1, 0.9, 0.12, 1, 0.9, 1),
    )


SHAPES: Final[dict[str, tuple[Part, ...]]] = {
    "slab": (Part(0, 1, 0, 1, 0, 1),),
    "table": (Part(0, 1, 0.92, 1, 0, 1), *_legs(0, 0.92)),
    "desk": (Part(0, 1, 0.94, 1, 0, 1), Part(0.02, 0.3, 0, 0.94, 0.02, 0.96), *_legs(0, 0.94)[2:]),
    "bench": (Part(0, 1, 0.7, 1, 0, 1), *_legs(0, 0.7, thick=0.12)),
    "stool": (Part(0, 1, 0.88, 1, 0, 1), *_legs(0, 0.88, thick=0.14, inset=0.06)),
    "chair": (Part(0, 1, 0.45, 0.52, 0, 1), *_legs(0, 0.45), Part(0.05, 0.95, 0.52, 1, 0, 0.1)),
    "office_chair": (
        Part(0, 1, 0, 0.08, 0, 1),
        Part(0.44, 0.56, 0.08, 0.42, 0.44, 0.56),
        Part(0.1, 0.9, 0.42, 0.52, 0.1, 0.9),
        Part(0.15, 0.85, 0.52, 1, 0.1, 0.2),
    ),
    "sofa": (
        Part(0, 1, 0, 0.45, 0, 1),
        Part(0, 1, 0.45, 1, 0, 0.25),
        Part(0, 0.1, 0.45, 0.7, 0.25, 1),
        Part(0.9, 1, 0.45, 0.7, 0.25, 1),
    ),
    "bed": (Part(0, 1, 0.2, 0.6, 0, 1), Part(0.02, 0.98, 0.6, 1, 0.02, 0.98), *_legs(0, 0.2, thick=0.06)),
    "drawers": (
        Part(0, 1, 0, 0.08, 0, 1),
        Part(0, 1, 0.08, 1, 0, 0.94),
        Part(0.03, 0.97, 0.12, 0.5, 0.94, 1),
        Part(0.03, 0.97, 0.54, 0.96, 0.94, 1),
    ),
    "cabinet": (
        Part(0, 1, 0, 0.06, 0, 1),
        Part(0, 1, 0.06, 1, 0, 0.94),
        Part(0.02, 0.49, 0.08, 0.98, 0.94, 1),
        Part(0.51, 0.98, 0.08, 0.98, 0.94, 1),
    ),
    "wardrobe": (
        Part(0, 1, 0, 0.04, 0, 1),
        Part(0, 1, 0.04, 1, 0, 0.95),
        Part(0.01, 0.49, 0.05, 0.99, 0.95, 1),
        Part(0.51, 0.99, 0.05, 0.99, 0.95, 1),
    ),
    "shelf": _shelf(),
    "tub": _tub(),
    "lamp": (
        Part(0.2, 0.8, 0, 0.05, 0.2, 0.8),
        Part(0.46, 0.54, 0.05, 0.7, 0.46, 0.54),
        Part(0, 1, 0.7, 1, 0, 1),
    ),
    "plant": (
        Part(0.25, 0.75, 0, 0.3, 0.25, 0.75),
        Part(0.45, 0.55, 0.3, 0.5, 0.45, 0.55),
        Part(0, 1, 0.5, 0.85, 0, 1),
        Part(0.2, 0.8, 0.85, 1, 0.2, 0.8),
    ),
    "television": (
        Part(0, 1, 0, 0.04, 0, 1),
        Part(0.46, 0.54, 0.04, 0.14, 0.4, 0.6),
        Part(0, 1, 0.14, 1, 0.35, 0.65),
    ),
    "laptop": (Part(0, 1, 0, 0.12, 0, 1), Part(0, 1, 0.12, 1, 0, 0.12)),
    "piano": (
        Part(0, 1, 0, 0.06, 0, 1),
        Part(0, 1, 0.06, 1, 0, 0.55),
        Part(0.02, 0.98, 0.52, 0.62, 0.55, 1),
    ),
    "fireplace": (
        Part(0, 1, 0, 0.06, 0, 1),
        Part(0, 0.22, 0.06, 0.9, 0, 0.9),
        Part(0.78, 1, 0.06, 0.9, 0, 0.9),
        Part(0.22, 0.78, 0.06, 0.9, 0, 0.2),
        Part(0, 1, 0.9, 1, 0, 1),
    ),
    "guitar": (
        Part(0, 1, 0, 0.42, 0, 1),
        Part(0.42, 0.58, 0.42, 0.88, 0.3, 0.6),
        Part(0.36, 0.64, 0.88, 1, 0.3, 0.6),
    ),
    "vase": (
        Part(0.2, 0.8, 0, 0.1, 0.2, 0.8),
        Part(0, 1, 0.1, 0.6, 0, 1),
        Part(0.25, 0.75, 0.6, 1, 0.25, 0.75),
    ),
    "candle": (Part(0, 1, 0, 0.1, 0, 1), Part(0.2, 0.8, 0.1, 1, 0.2, 0.8)),
    "bowl": (Part(0.25, 0.75, 0, 0.3, 0.25, 0.75), Part(0, 1, 0.3, 1, 0, 1)),
    "pan": (Part(0, 1, 0, 0.6, 0, 0.6), Part(0.42, 0.58, 0.6, 1, 0.4, 1), Part(0, 1, 0.5, 0.6, 0, 1)),
    "sink": (
        Part(0, 1, 0, 0.8, 0, 1),
        Part(0, 0.12, 0.8, 0.94, 0, 1),
        Part(0.88, 1, 0.8, 0.94, 0, 1),
        Part(0.12, 0.88, 0.8, 0.94, 0, 0.14),
        Part(0.12, 0.88, 0.8, 0.94, 0.88, 1),
        Part(0.46, 0.54, 0.94, 1, 0.02, 0.3),
    ),
    "stove": (
        Part(0, 1, 0, 0.97, 0, 0.95),
        Part(0.05, 0.95, 0.1, 0.8, 0.95, 1),
        Part(0, 1, 0.97, 0.985, 0, 1),
        *(Part(x, x + 0.3, 0.985, 1, z, z + 0.3) for x in (0.12, 0.58) for z in (0.12, 0.58)),
    ),
    "washer": (
        Part(0, 1, 0, 0.05, 0, 1),
        Part(0, 1, 0.05, 1, 0, 0.95),
        Part(0.2, 0.8, 0.2, 0.7, 0.95, 1),
    ),
    "microwave": (Part(0, 1, 0, 1, 0, 0.94), Part(0.04, 0.72, 0.1, 0.9, 0.94, 1)),
    "coffee_maker": (
        Part(0, 1, 0, 0.14, 0, 1),
        Part(0, 1, 0.14, 0.8, 0, 0.4),
        Part(0, 1, 0.8, 1, 0, 0.9),
        Part(0.25, 0.75, 0.14, 0.5, 0.45, 0.9),
    ),
    "range_hood": (Part(0, 1, 0, 0.25, 0, 1), Part(0.3, 0.7, 0.25, 1, 0, 0.5)),
    "toilet": (
        Part(0.2, 0.8, 0, 0.45, 0.2, 0.85),
        Part(0, 1, 0.45, 0.55, 0, 1),
        Part(0, 1, 0.55, 1, 0, 0.28),
    ),
    "shower": (
        Part(0, 1, 0, 0.06, 0, 1),
        Part(0, 0.03, 0.06, 1, 0, 1),
        Part(0.03, 1, 0.06, 1, 0, 0.03),
        Part(0.3, 0.7, 0.94, 0.97, 0.03, 0.4),
    ),
    "bar": (Part(0, 0.06, 0, 1, 0, 1), Part(0.94, 1, 0, 1, 0, 1), Part(0.06, 0.94, 0.35, 0.65, 0.6, 0.95)),
    "coat_rack": (
        Part(0, 1, 0, 0.04, 0, 1),
        Part(0.45, 0.55, 0.04, 1, 0.45, 0.55),
        Part(0.1, 0.9, 0.88, 0.92, 0.45, 0.55),
        Part(0.45, 0.55, 0.8, 0.84, 0.1, 0.9),
    ),
}
"""The parts of each shape, by name."""


def part_boxes(shape: str, size: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return the parts of a piece of furniture of the given `size` as boxes (n, 2, 3): lower and upper corners, in
    metres from the centre of the piece.
    """
    shares = np.array(SHAPES[shape])
    corners = np.stack([shares[:, 0::2], shares[:, 1::2]], axis=1)
    boxes: NDArray[np.float64] = (corners - 0.5) * np.array(size)
    return boxes
