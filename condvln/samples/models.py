"""Assets for the kinds of the catalogue: GLBs of rigid models with their centres of mass, and URDFs with GLBs of
articulated kinds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from condvln.samples.catalogue import Kind
from condvln.samples.glb import glb_of_boxes
from condvln.samples.shapes import part_boxes

__all__ = ["Model", "articulated_files", "body_size", "model_of"]

F64 = NDArray[np.float64]

COM_EVERY: Final = 4
"""One kind in this many has a centre of mass that differs from its asset's origin."""

DOOR_SHARE: Final = 0.06
"""Share of an articulated body's depth that is its door leaf (as in the shape ``cabinet``)."""


@dataclass(frozen=True, eq=False, slots=True)
class Model:
    """A rigid model's asset: its GLB, with the centre (3,) of its box and its centre of mass (3,), in metres in the
    asset's own frame.
    """

    center: F64
    com: F64
    glb: bytes


def model_of(kind: Kind, variant: int) -> Model:
    """Return the asset of one variant (size) of a kind. The asset's origin is not the centre of its box, as in models
    made by artists.
    """
    width, height, depth = (v / 1000 for v in kind.sizes[variant])
    # Pivots are at floor level or slightly above, at a corner, edge or side of the plan, depending on the kind.
    side, front, up = kind.number % 3 - 1, kind.number // 3 % 3 - 1, kind.number % 2
    pivot = np.array([side * width / 4, -height / 2 + up * height / 8, front * depth / 4])
    center = -np.round(pivot, 4)
    com = np.round(center / 2, 4) if kind.number % COM_EVERY == 0 else np.zeros(3)
    glb = glb_of_boxes({kind.kind: part_boxes(kind.shape, (width, height, depth)) + center})
    return Model(center, com, glb)


def body_size(kind: Kind) -> tuple[float, float, float]:
    """Return width, height and depth in metres of an articulated body before it is scaled uniformly for an instance."""
    width, height, depth = kind.sizes[kind.scales.index(1.0)]
    return width / 1000, height / 1000, depth / 1000


def articulated_files(kind: Kind) -> dict[str, bytes]:
    """Return the URDF and GLBs of an articulated kind, by file name: a body and two door leaves on hinges, all closed.

    The links' frames have z pointing down (as ReplicaCAD's fridge) and are turned upright by the joint to the root,
    whose origin is the centre of the body's box.
    """
    assert kind.urdf is not None
    size = body_size(kind)
    parts = part_boxes(kind.shape, size)
    depth = size[2]
    leaves = parts[:, 0, 2] >= depth / 2 - DOOR_SHARE * depth - 1e-9
    hinge_z = depth / 2 - DOOR_SHARE * depth
    links = {"body": (np.zeros(3), parts[~leaves])}
    for name, sign, leaf in zip(("left_door", "right_door"), (-1, 1), parts[leaves], strict=True):
        hinge = np.array([sign * size[0] / 2, 0.0, hinge_z])
        links[name] = hinge, leaf[None] - hinge
    files = {f"{name}.glb": glb_of_boxes({name: _to_link(boxes)}) for name, (_, boxes) in links.items()}
    files[f"{kind.urdf}.urdf"] = _urdf(kind.urdf, {name: origin for name, (origin, _) in links.items()}).encode()
    return files


def _to_link(boxes: F64) -> F64:
    """Convert boxes from the y-up frame to the frame of a URDF link: (x, y, z) becomes (x, z, −y)."""
    turned = boxes[..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    return np.sort(turned, axis=-2)


def _urdf(name: str, origins: dict[str, F64]) -> str:
    lines = ['<?xml version="1.0" ?>', f"<robot name={quoteattr(name)}>", '  <link name="root"/>']
    lines += [
        '  <joint name="root_rotation" type="fixed">',
        '    <origin rpy="1.5707963267948966 0 0" xyz="0 0 0"/>',
        '    <parent link="root"/>',
        '    <child link="body"/>',
        "  </joint>",
    ]
    for link, origin in origins.items():
        x, y, z = np.round([origin[0], origin[2], -origin[1]], 6) + 0.0
        if link != "body":
            swing = ("0", "2.3") if link.startswith("right") else ("-2.3", "0")
            lines += [
                f'  <joint name="{link}_hinge" type="revolute">',
                f'    <origin rpy="0 0 0" xyz="{x} {y} {z}"/>',
                '    <parent link="body"/>',
                f'    <child link="{link}"/>',
                '    <axis xyz="0 0 1"/>',
                f'    <limit effort="44.4" lower="{swing[0]}" upper="{swing[1]}" velocity="40"/>',
                "  </joint>",
            ]
        lines += [
            f'  <link name="{link}">',
            "    <inertial>",
            '      <origin rpy="0 0 0" xyz="0 0 0"/>',
            '      <mass value="10.0"/>',
            '      <inertia ixx="1.0" ixy="0" ixz="0" iyy="1.0" iyz="0" izz="1.0"/>',
            "    </inertial>",
            "    <visual>",
            '      <origin rpy="0 0 0" xyz="0 0 0"/>',
            "      <geometry>",
            # ReplicaCAD separates the numbers of a scale by commas, and so do we.
            f'        <mesh filename="{link}.glb" scale="1, 1, 1"/>',
            "      </geometry>",
            "    </visual>",
            "  </link>",
        ]
    return "\n".join([*lines, "</robot>", ""])
