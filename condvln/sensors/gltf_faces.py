"""Read the triangles of a GLB file with their materials, for rendering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.glb_material import MaterialReader
from condvln.formats.glb_part import GlbPart, Primitive
from condvln.scene.boxes import transform_points
from condvln.scene.gltf_arrays import attribute_rows, coordinates_of, primitive_triangles, world_transforms
from condvln.sensors.kernels.shading import CLAMP
from condvln.sensors.surfaces import Material, SurfaceBuilder
from condvln.sensors.textures import KTX2, allowed_edge, is_readable, read_picture

__all__ = ["DrawnFile", "drawn_file"]

_WRAPS: Final = {10497: 0, 33071: 1, 33648: 2}
"""glTF's codes of the wrap modes repeat, clamp to edge and mirrored repeat, in the order of `Material.wrap`."""
_IMAGE_EXTENSIONS: Final = ("EXT_texture_webp", "KHR_texture_basisu")

F64 = NDArray[np.float64]
Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class DrawnFile:
    """The triangles of one file in its root frame, metres. The arrays are as in `Surfaces`.

    unread : number of textures whose image has an unsupported format, is damaged, or is missing
    undecoded : number of those that are KTX2 images for which no decoder is installed
    """

    corners: F64
    coordinates: Floats
    colours: Bytes
    material: NDArray[np.int32]
    unread: int
    undecoded: int

    def place(self, builder: SurfaceBuilder, owner: int, transform: F64) -> None:
        """Add the triangles to a builder, transformed to the scene's frame by a (4, 4) matrix."""
        corners = transform_points(transform, self.corners.reshape(-1, 3)).reshape(-1, 3, 3)
        # A mirroring transform reverses the winding of triangles.
        turn = slice(None, None, -1 if np.linalg.det(transform[:3, :3]) < 0 else 1)
        builder.add(corners[:, turn], owner, self.material, self.coordinates[:, turn], self.colours[:, turn])


def drawn_file(part: GlbPart, builder: SurfaceBuilder) -> DrawnFile:
    """Return the triangles of a file, and add the file's materials and textures to the builder."""
    painter = _Painter(part.look, builder)
    meshes = [[_faces(part, primitive, painter) for primitive in primitives] for primitives in part.meshes]
    world = world_transforms(part)
    found: list[tuple[F64, Floats, Bytes, NDArray[np.int32]]] = []
    for number, node in enumerate(part.nodes):
        for corners, coordinates, colours, material in meshes[node.mesh] if node.mesh is not None else ():
            placed = transform_points(world[number], corners.reshape(-1, 3)).reshape(-1, 3, 3)
            turn = slice(None, None, -1 if np.linalg.det(world[number][:3, :3]) < 0 else 1)
            own = np.full(len(corners), material, np.int32)
            found.append((placed[:, turn], coordinates[:, turn], colours[:, turn], own))
    # A file without triangles was rejected when it was read.
    return DrawnFile(
        np.concatenate([piece[0] for piece in found]),
        np.concatenate([piece[1] for piece in found]),
        np.concatenate([piece[2] for piece in found]),
        np.concatenate([piece[3] for piece in found]),
        painter.unread,
        painter.undecoded,
    )


def _faces(part: GlbPart, own: Primitive, painter: _Painter) -> tuple[F64, Floats, Bytes, int]:
    """Return corners (n, 3, 3), texture coordinates (n, 3, 2), colours (n, 3, 3) and the material index of a
    primitive.
    """

    points = np.asarray(attribute_rows(part, own, "POSITION"), np.float64)
    triangles = primitive_triangles(part, own)
    material, wrap, name, moved = painter.material(own.material)
    places = attribute_rows(part, own, name)
    coordinates = np.zeros((len(points), 2)) if places is None else np.asarray(places, np.float64)
    coordinates = coordinates @ moved[:2, :2].T + moved[:2, 2]
    places_of = np.nan_to_num(coordinates[triangles], nan=0.0, posinf=0.0, neginf=0.0)
    # Whole repeats are subtracted, two at a time because of mirrored wrapping, so that float32 keeps its precision.
    endless = np.array(wrap) != CLAMP
    places_of -= np.where(endless, 2 * np.floor(places_of.min(axis=1, keepdims=True) / 2), 0.0)
    tints = attribute_rows(part, own, "COLOR_0")
    colours = np.full((len(points), 3), 255, np.uint8)
    if tints is not None:
        colours = np.round(np.clip(np.nan_to_num(tints[:, :3]), 0, 1) * 255).astype(np.uint8)
    return points[triangles], places_of.astype(np.float32), colours[triangles], material


class _Painter:
    """The materials of one file, each added to the builder once."""

    def __init__(self, look: MaterialReader | None, builder: SurfaceBuilder) -> None:
        self._look, self._builder = look, builder
        self._textures: dict[int, int] = {}
        self.unread = look.lost if look is not None else 0
        self.undecoded = 0

    def material(self, index: int | None) -> tuple[int, tuple[int, int], str, F64]:
        """Return a material's number, its wrap modes, the attribute that holds its texture coordinates, and the (3, 3)
        transform of these coordinates.
        """
        if index is None or self._look is None:
            return self._builder.material(Material()), (0, 0), "TEXCOORD_0", np.eye(3)
        shine = self._look.materials[index].get("pbrMetallicRoughness", {})
        red, green, blue = (min(max(float(v), 0.0), 1.0) for v in shine.get("baseColorFactor", [1.0] * 4)[:3])
        slot = shine.get("baseColorTexture")
        texture, wrap = (-1, (0, 0)) if slot is None else self._texture(int(slot["index"]))
        number = self._builder.material(Material((red, green, blue), texture, wrap))
        if slot is None:
            return number, wrap, "TEXCOORD_0", np.eye(3)
        return number, wrap, *coordinates_of(slot)

    def _texture(self, index: int) -> tuple[int, tuple[int, int]]:
        assert self._look is not None
        own = self._look.textures[index]
        sampler = self._look.samplers[own["sampler"]] if "sampler" in own else {}
        wrap = _WRAPS[sampler.get("wrapS", 10497)], _WRAPS[sampler.get("wrapT", 10497)]
        extensions = own.get("extensions", {})
        named = [own.get("source"), *(extensions.get(name, {}).get("source") for name in _IMAGE_EXTENSIONS)]
        images = [image for image in named if image is not None]
        known = [image for image in images if is_readable(self._look.images[image].mime)]
        if not known:
            self.unread += 1
            self.undecoded += any(self._look.images[image].mime == KTX2 for image in images)
            return -1, (0, 0)
        if known[0] not in self._textures:
            image = self._look.images[known[0]]
            levels = read_picture(image.data, image.mime, allowed_edge(self._builder.texture_bytes))
            self.unread += levels is None
            self._textures[known[0]] = -1 if levels is None else self._builder.texture(levels)
        return self._textures[known[0]], wrap
