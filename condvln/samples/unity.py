"""Convert the layout's frame to Unity's (left-handed, +y up, +z north): (x, y, z) becomes (x, y, −z), angles are
negated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from condvln.samples.layout import Furniture, Layout

__all__ = ["UnityFrame"]

DECIMALS = 6


@dataclass(frozen=True, slots=True)
class UnityFrame:
    """Unity's coordinate frame, with its origin moved by (x, z)."""

    x: float = 0.0
    z: float = 0.0

    @classmethod
    def with_corner_at_origin(cls, layout: Layout) -> UnityFrame:
        """Return the frame in which the plan's lowest corner is (0, 0, 0), as in ProcTHOR's houses."""
        (x0, _), (_, z1) = layout.bounds
        return cls(-x0, z1)

    def ground(self, x: float, z: float) -> tuple[float, float]:
        """Return a floor point (x, z) in Unity's frame."""
        return round(x + self.x, DECIMALS) + 0.0, round(self.z - z, DECIMALS) + 0.0

    def point(self, x: float, y: float, z: float) -> dict[str, float]:
        """Return a point in Unity's JSON form."""
        unity_x, unity_z = self.ground(x, z)
        return {"x": unity_x, "y": round(y, DECIMALS) + 0.0, "z": unity_z}

    def center(self, piece: Furniture) -> dict[str, float]:
        """Return the centre of a piece's box in Unity's JSON form."""
        return self.point(*piece.center)

    def rotation(self, piece: Furniture) -> dict[str, float]:
        """Return a piece's rotation as Euler angles in degrees; yaw is clockwise seen from above."""
        return {"x": 0.0, "y": -math.degrees(piece.yaw.radians) % 360, "z": 0.0}
