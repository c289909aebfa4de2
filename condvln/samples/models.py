"""Assets for the kinds of the catalogue: GLBs of rigid models with their centres of mass, and URDFs with GLBs of
articulated kinds.

A piece of furniture is a few boxes: tables have legs, sofas arms, shelves boards. A GLB has one unit cube for each
name, placed by node transforms below a rotated and translated root: the files test readers, so no node transform is the
identity, and the vertices alone do not give the extent.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
import trimesh

from condvln.arrays import F64
from condvln.own_tables import own_rows
from condvln.samples.catalogue import Kind, catalogue, record
from condvln.samples.layout import Layout

__all__ = [
    "ROOT",
    "Z_UP",
    "Model",
    "articulated_files",
    "box_placements",
    "glb_of_boxes",
    "glb_of_cubes",
    "model_of",
    "part_boxes",
    "shapes",
]


ROOT: Final = np.array([[1.0, 0.0, 0.0, 0.25], [0.0, 0.0, 1.0, -0.5], [0.0, -1.0, 0.0, 0.125], [0.0, 0.0, 0.0, 1.0]])
"""Transform of the root node: z-up, as modelling tools export, with the origin elsewhere."""

Z_UP: Final = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From Habitat's frame to that of scans: (x, y, z) becomes (x, −z, y)."""

PALE: Final = 0.35
"""Least brightness of a colour; the rest follows from the name."""

DECIMALS: Final = 9
"""Decimals in metres kept of a node's transform."""


def box_placements(boxes: F64) -> F64:
    """Return the transforms (n, 4, 4) that turn the unit cube about the origin into the boxes (n, 2, 3). A box is given
    by its lower and upper corner.
    """
    placements = np.zeros((len(boxes), 4, 4))
    placements[:, [0, 1, 2], [0, 1, 2]] = boxes[:, 1] - boxes[:, 0]
    placements[:, :3, 3] = (boxes[:, 0] + boxes[:, 1]) / 2
    placements[:, 3, 3] = 1.0
    return placements


def glb_of_boxes(parts: Mapping[str, F64]) -> bytes:
    """Return a binary glTF of axis-aligned boxes (n, 2, 3), metres, by name; see `glb_of_cubes`."""
    return glb_of_cubes({name: box_placements(boxes) for name, boxes in parts.items()})


def glb_of_cubes(parts: Mapping[str, F64], frame: F64 | None = None) -> bytes:
    """Return a binary glTF of placed unit cubes.

    Parameters
    ----------
    parts : name to (n, 4, 4) transforms of the unit cube, metres; each name becomes a mesh with its own colour
    frame : (4, 4) from the frame of `parts` to the file's; identity if None
    """
    scene = trimesh.Scene()
    scene.graph.update(frame_from="world", frame_to="root", matrix=ROOT)
    back = np.linalg.inv(ROOT) if frame is None else np.linalg.inv(ROOT) @ frame
    for name, placements in parts.items():
        cube = trimesh.creation.box()
        cube.metadata.clear()
        cube.visual = trimesh.visual.TextureVisuals(material=_material(name))
        scene.geometry[name] = cube
        for number, place in enumerate(placements):
            matrix = np.round(back @ place, DECIMALS)
            scene.graph.update(frame_from="root", frame_to=f"{name}.{number}", matrix=matrix, geometry=name)
    return bytes(scene.export(file_type="glb"))


def _material(name: str) -> trimesh.visual.material.PBRMaterial:
    shade = np.frombuffer(hashlib.sha256(name.encode()).digest()[:3], np.uint8) / 255
    colour = [*(float(round(PALE + (1 - PALE) * s, 3)) for s in shade), 1.0]
    return trimesh.visual.material.PBRMaterial(
        name=name, baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.9
    )


@cache
def shapes() -> dict[str, F64]:
    """Return the parts of each shape of the catalogue, from ``shapes.csv``: boxes (n, 2, 3) in the unit cube.

    A part is given by shares of width, height (up) and depth (the front is z = 1). Every shape touches all six faces of
    the cube and has one part that spans the whole plan, so that a rotated piece has the extent of its box.
    """
    parts: dict[str, list[list[list[float]]]] = {}
    for row in own_rows("condvln.samples", "shapes.csv"):
        shape, *bounds = row.values()
        x0, x1, y0, y1, z0, z1 = map(float, bounds)
        parts.setdefault(shape, []).append([[x0, y0, z0], [x1, y1, z1]])
    return {shape: np.array(boxes) for shape, boxes in parts.items()}


def part_boxes(shape: str, size: tuple[float, float, float]) -> F64:
    """Return the parts of a piece of furniture of the given `size` as boxes (n, 2, 3): lower and upper corners, in
    metres from the centre of the piece.
    """
    boxes: F64 = (shapes()[shape] - 0.5) * np.array(size)
    return boxes


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


def models_of(layouts: Iterable[Layout]) -> dict[tuple[str, int], Model]:
    """Return the models of all rigid furniture by kind and variant, in this order."""
    used = sorted({(piece.kind, piece.variant) for layout in layouts for piece in layout.furniture})
    return {key: model_of(catalogue()[key[0]], key[1]) for key in used if catalogue()[key[0]].urdf is None}


def bodies() -> list[Kind]:
    """Return the articulated kinds of the catalogue."""
    return [kind for kind in catalogue().values() if kind.urdf is not None]


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
    parts = []
    for link, origin in origins.items():
        x, y, z = np.round([origin[0], origin[2], -origin[1]], 6) + 0.0
        if link != "body":
            lower, upper = ("0", "2.3") if link.startswith("right") else ("-2.3", "0")
            parts.append(record("urdf hinge", link=link, x=x, y=y, z=z, lower=lower, upper=upper)["xml"])
        parts.append(record("urdf link", link=link)["xml"])
    return str(record("urdf robot", name=quoteattr(name), links="\n".join(parts))["xml"]) + "\n"
