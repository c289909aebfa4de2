"""Write layouts as scans of HM3D with semantics: a list of instances, and a mesh that is painted with their colours.

Folders and names are those of the release (``val/00801-<scan>/<scan>.semantic.txt``), with ``<scan>.basis.glb`` and
``<scan>.basis.navmesh`` beside them and the table of proposed room types in the root. The paint is in textures in scans
of even number, as in version 0.2 of the annotation, and in vertex colours in the others, as in version 0.1. What nobody
painted is black: the sides of floors and the upper side of ceilings.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
import trimesh
from PIL import Image

from condvln.arrays import F64, I64
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.layout import Layout
from condvln.samples.models import DECIMALS, ROOT, Z_UP
from condvln.samples.solid import box_corners, floor_boxes, layout_glb, piece_corners, wall_boxes
from condvln.sources.solids import BOX_FACES

__all__ = ["hm3d_files"]

SPLITS: Final = (("train", 0), ("val", 800), ("test", 900))
"""Folders of the splits, and the number of their first scan."""
HEADING: Final = "HM3D Semantic Annotations"
VOTES: Final = "Per_Scene_Region_Weighted_Votes.csv"
PROPOSALS: Final = (
    "Bathroom", "Bedroom", "Dining room", "Garage", "Hall/stairwell", "Kitchen", "Laundry room", "Living room",
    "Office", "Rec room", "Unknown room",
)  # fmt: skip
PROPOSED: Final = {"hallway": "Hall/stairwell"}
"""Proposals for our room types; that of others is our name with a capital letter."""

CEILING_THICKNESS: Final = 0.02
UPPER, LOWER = (6, 8), (4, 6)
"""The faces of a box (`condvln.samples.solid.FACES`) that look up, and those that look down."""
BLACK: Final = 0
TILE: Final = 4
"""Pixels of the square that a texture has for each colour."""


@dataclass(frozen=True, eq=False, slots=True)
class _Instance:
    """Boxes, as corners (n, 8, 3) in metres. Of each, the faces from number `start` to before `end` are painted."""

    label: str
    region: int
    boxes: F64
    start: int = 0
    end: int = 12


def hm3d_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes).

    Parameters
    ----------
    layouts : scene name to layout; the scans' numbers are by their order
    """
    votes = [",".join(("Scene Name", "Region #", *PROPOSALS, "Weighted Room Proposal"))]
    for number, (name, layout) in enumerate(layouts.items()):
        split, first = SPLITS[number % len(SPLITS)]
        folder = f"{first + number:05d}-{name}"
        instances = list(_instances(layout))
        colours = _colours(name, len(instances))
        bare = f"{split}/{folder}/{name}"
        lines = [
            f'{k},{colour:06X},"{one.label}",{one.region}'
            for k, (colour, one) in enumerate(zip(colours, instances, strict=True), start=1)
        ]
        yield f"{bare}.semantic.txt", "\n".join([HEADING, *lines, ""]).encode()
        yield f"{bare}.semantic.glb", _painted(layout, instances, colours, textured=number % 2 == 0)
        yield f"{bare}.basis.glb", layout_glb(layout, Z_UP)
        yield f"{bare}.basis.navmesh", navmesh_of(layout, NavMeshSettings()).to_bytes()
        for region, room in enumerate(layout.rooms):
            proposal = PROPOSED.get(room.label, room.label.capitalize())
            counts = ["10" if known == proposal else "0" for known in PROPOSALS]
            votes.append(",".join((folder, str(region), *counts, f" {proposal}")))
    yield VOTES, "\n".join([*votes, ""]).encode()


def _instances(layout: Layout) -> Iterator[_Instance]:
    """Yield floor and ceiling of each room, its furniture, and its walls. A wall belongs to the nearest room."""
    slabs = floor_boxes(layout)
    walls = wall_boxes(layout)
    middles = shapely.points((walls[:, 0] + walls[:, 1])[:, [0, 2]] / 2)
    nearest = np.array([room.shape.distance(middles) for room in layout.rooms]).argmin(axis=0)
    first = 0
    for region, room in enumerate(layout.rooms):
        last = first + len({x for x, _ in room.polygon}) - 1
        own, above = slabs[first:last], slabs[first:last].copy()
        above[:, :, 1] = [layout.ceiling, layout.ceiling + CEILING_THICKNESS]
        first = last
        yield _Instance("floor", region, box_corners(own), *UPPER)
        yield _Instance("ceiling", region, box_corners(above), *LOWER)
        for piece in layout.in_room(room.room_id):
            yield _Instance(piece.label.replace("_", " "), region, piece_corners(piece))
        if (nearest == region).any():
            yield _Instance("wall", region, box_corners(walls[nearest == region]))


def _colours(name: str, count: int) -> list[int]:
    """Return as many different colours, none of them black."""
    found: dict[int, None] = {}
    seed = 0
    while len(found) < count:
        colour = int.from_bytes(hashlib.sha256(f"{name}/{seed}".encode()).digest()[:3], "big")
        if colour != BLACK:
            found[colour] = None
        seed += 1
    return list(found)


def _painted(layout: Layout, instances: Sequence[_Instance], colours: Sequence[int], textured: bool) -> bytes:
    """Return the painted mesh, a part for each region, as a GLB file."""
    scene = trimesh.Scene()
    scene.graph.update(frame_from="world", frame_to="root", matrix=ROOT)
    matrix = np.round(np.linalg.inv(ROOT) @ Z_UP, DECIMALS)
    for region in range(len(layout.rooms)):
        own = [(one, colour) for one, colour in zip(instances, colours, strict=True) if one.region == region]
        palette = np.array([BLACK, *(colour for _, colour in own)])
        corners = np.concatenate([one.boxes for one, _ in own])
        shades = []
        for k, (one, _) in enumerate(own, start=1):
            shade = np.zeros(12, np.int64)
            shade[one.start : one.end] = k
            shades.append(np.tile(shade, len(one.boxes)))
        faces = (BOX_FACES[None] + 8 * np.arange(len(corners))[:, None, None]).reshape(-1)
        # Each face has corners of its own, since its neighbours have other colours.
        mesh = trimesh.Trimesh(corners.reshape(-1, 3)[faces], np.arange(len(faces)).reshape(-1, 3), process=False)
        mesh.visual = _visual(np.concatenate(shades).repeat(3), palette, textured, f"chunk{region:03d}")
        mesh.metadata.clear()
        name = f"chunk{region:03d}"
        scene.geometry[name] = mesh
        scene.graph.update(frame_from="root", frame_to=f"{name}.0", matrix=matrix, geometry=name)
    return bytes(scene.export(file_type="glb"))


def _visual(
    shade: I64, palette: I64, textured: bool, name: str
) -> trimesh.visual.TextureVisuals | trimesh.visual.ColorVisuals:
    """Return the look of vertices whose colours are entries of the palette."""
    channels = np.stack([palette >> 16, palette >> 8 & 255, palette & 255], axis=-1).astype(np.uint8)
    if not textured:
        opaque = np.full((len(shade), 1), 255, np.uint8)
        return trimesh.visual.ColorVisuals(vertex_colors=np.concatenate([channels[shade], opaque], axis=1))
    edge = int(np.ceil(np.sqrt(len(palette))))
    tiles = np.zeros((edge * edge, 3), np.uint8)
    tiles[: len(palette)] = channels
    picture = tiles.reshape(edge, edge, 3).repeat(TILE, axis=0).repeat(TILE, axis=1)
    # trimesh counts rows of a texture from below.
    places = np.stack([(shade % edge + 0.5) / edge, 1 - (shade // edge + 0.5) / edge], axis=-1)
    material = trimesh.visual.material.PBRMaterial(
        name=name, baseColorTexture=Image.fromarray(picture), metallicFactor=0.0, roughnessFactor=1.0
    )
    return trimesh.visual.TextureVisuals(uv=places, material=material)
