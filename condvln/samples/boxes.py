"""Write layouts as scenes of family ``boxes``, one JSON file each; in odd scenes z is up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from condvln.formats.streams import indented
from condvln.samples.layout import Layout

__all__ = ["boxes_files"]


def boxes_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes)."""
    for number, (name, layout) in enumerate(layouts.items()):
        yield f"{name}.json", _file(layout, z_up=number % 2 == 1)


def _file(layout: Layout, *, z_up: bool) -> bytes:
    def ground(x: float, z: float) -> list[float]:
        return [x, -z + 0.0] if z_up else [x, z]

    def vector(x: float, y: float, z: float, sign: int) -> list[float]:
        return [x, sign * z + 0.0, y] if z_up else [x, y, z]

    document = {
        "up": "z" if z_up else "y",
        "rooms": [
            {"id": r.room_id, "label": r.label, "polygon": [ground(*c) for c in r.polygon], "height": layout.ceiling}
            for r in layout.rooms
        ],
        "doors": [{"from": ground(*d.start), "to": ground(*d.end), "height": d.height} for d in layout.doors],
        "objects": [
            {
                "id": piece.object_id,
                "label": piece.label,
                "center": vector(*piece.center, -1),
                "size": vector(*piece.size, 1),
                "yaw": round(math.degrees(piece.yaw.radians), 9),
            }
            for piece in layout.furniture
        ],
    }
    return indented(document)
