"""Collect the surfaces that a camera sees: textured meshes of GLB files, or walls and boxes in one colour per label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64, I64
from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.glb_part import GlbPart, MaterialReader, Primitive, read_part
from condvln.labels import vocabulary
from condvln.scene import MeshPart, Scene, SceneObject
from condvln.scene.boxes import transform_points
from condvln.scene.meshes import coordinates_of, world_transforms
from condvln.scene.scene import FLOOR_COLOUR, STRUCTURE, WALL_COLOUR, Colour, SceneGeometry, label_colour
from condvln.sensors.raster import CLAMP
from condvln.sensors.surfaces import Material, SurfaceBuilder, Surfaces
from condvln.sensors.textures import KTX2, allowed_edge, is_readable, read_picture
from condvln.sources.solids import floor, joined, object_boxes

__all__ = ["BOXES", "MARGIN", "NO_STAGE", "NO_WALLS", "OWNERS_BY_BOX", "DrawnFile", "drawn_file", "scene_surfaces"]

_WRAPS: Final = {10497: 0, 33071: 1, 33648: 2}
"""glTF's codes of the wrap modes repeat, clamp to edge and mirrored repeat, in the order of `Material.wrap`."""
_IMAGE_EXTENSIONS: Final = ("EXT_texture_webp", "KHR_texture_basisu")

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
    meshes = [[_faces(primitive, painter) for primitive in primitives] for primitives in part.meshes]
    world = world_transforms(part)
    found: list[tuple[F64, Floats, Bytes, NDArray[np.int32]]] = []
    for number, node in enumerate(part.nodes):
        for corners, coordinates, colours, material in meshes[node.mesh] if node.mesh is not None else ():
            placed = transform_points(world[number], corners.reshape(-1, 3)).reshape(-1, 3, 3)
            turn = slice(None, None, -1 if np.linalg.det(world[number][:3, :3]) < 0 else 1)
            own = np.full(len(corners), material, np.int32)
            found.append((placed[:, turn], coordinates[:, turn], colours[:, turn], own))
    # A file without triangles was rejected when it was read.
    corners, coordinates, colours, materials = map(np.concatenate, zip(*found, strict=True))
    return DrawnFile(corners, coordinates, colours, materials, painter.unread, painter.undecoded)


def _faces(own: Primitive, painter: _Painter) -> tuple[F64, Floats, Bytes, int]:
    """Return corners (n, 3, 3), texture coordinates (n, 3, 2), colours (n, 3, 3) and the material index of a
    primitive.
    """

    points, triangles = own.points.astype(np.float64), own.faces
    material, wrap, name, moved = painter.material(own.material)
    places = own.rows(name)
    coordinates = np.zeros((len(points), 2)) if places is None else np.asarray(places, np.float64)
    coordinates = coordinates @ moved[:2, :2].T + moved[:2, 2]
    places_of = np.nan_to_num(coordinates[triangles], nan=0.0, posinf=0.0, neginf=0.0)
    # Whole repeats are subtracted, two at a time because of mirrored wrapping, so that float32 keeps its precision.
    endless = np.array(wrap) != CLAMP
    places_of -= np.where(endless, 2 * np.floor(places_of.min(axis=1, keepdims=True) / 2), 0.0)
    tints = own.rows("COLOR_0")
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


BOXES: Final = (
    "drawn: walls, doors and boxes in one colour per label replace surfaces; boxes that contain objects are open"
)
NO_STAGE: Final = "incomplete: the building's mesh is missing, so floors and walls are not visible"
NO_WALLS: Final = "incomplete: walls are unknown, so rooms are visible through them"
OWNERS_BY_BOX: Final = "instances: the scan's mesh has no object ids; a surface belongs to the smallest box around it"
SIDES: Final = (0.86, 1.0, 0.72)
"""Brightness of the faces of a drawn box that face along x, y and z, so that its edges are visible."""
HELD: Final = 0.05
"""Least share of a thing's box within a larger box for which the larger box is drawn open. Lines of sight to what is in
a box are not blocked by it, and a thing counts as seen from the same share on.
"""
OFF_FLOOR: Final = 0.15
"""Height in metres above the bottom of a piece of furniture from which a thing in its box is on it, not under it."""
NAMED: Final = 3
"""Largest number of files that a note names."""
MARGIN: Final = 0.05
"""Tolerance in metres of a scan's boxes, which may end before the surface; about the size of a triangle."""


def scene_surfaces(scene: Scene, geometry: SceneGeometry | None) -> Surfaces:
    """Return all visible surfaces of a scene.

    Parameters
    ----------
    geometry : the scene's triangles, from its source

    Raises
    ------
    InputError : a mesh can't be read
    """
    if geometry is not None and geometry.approximate:
        return _drawn(scene, geometry, (BOXES,))
    if scene.stage or any(item.mesh for item in scene.objects):
        return _assembled(scene)
    things = [(k, o) for k, o in enumerate(scene.objects) if not vocabulary.is_structure(o.label)]
    floors = [floor(room.polygon, room.floor_y) for room in scene.rooms if room.polygon is not None]
    return _drawn(scene, joined([*floors, object_boxes(things)], approximate=True), (BOXES, NO_WALLS))


def _assembled(scene: Scene) -> Surfaces:
    files = DatasetRoot(scene.root)
    builder = SurfaceBuilder()
    known: dict[str, DrawnFile] = {}

    def place(part: MeshPart, owner: int) -> None:
        if part.path not in known:
            read = read_part(files.read(part.path, MAX_GLB_BYTES), str(files.folder / part.path))
            known[part.path] = drawn_file(read, builder)
        known[part.path].place(builder, owner, part.transform)

    for part in scene.stage:
        place(part, STRUCTURE)
    for number, item in enumerate(scene.objects):
        for part in item.mesh:
            place(part, number)
    notes = [*([] if scene.stage else [NO_STAGE]), *_unread(known)]
    scan = not any(item.mesh for item in scene.objects)
    surfaces = builder.surfaces([*notes, OWNERS_BY_BOX] if scan else notes)
    return replace(surfaces, owner=_owners_by_box(surfaces, scene)) if scan else surfaces


def _unread(files: Mapping[str, DrawnFile]) -> list[str]:
    """Return the notes on textures that can't be read; `files` by path."""
    faulty = [path for path, file in files.items() if file.unread]
    if not faulty:
        return []
    count = sum(file.unread for file in files.values())
    more = f" and {len(faulty) - NAMED} more files" if len(faulty) > NAMED else ""
    notes = [
        f"textures: {count} can't be read, in {', '.join(faulty[:NAMED])}{more}; their surfaces have their material's "
        "colour"
    ]
    undecoded = sum(file.undecoded for file in files.values())
    if undecoded:
        notes.append(f"textures: {undecoded} are KTX2 images, which the extra 'ktx2' of condvln reads")
    return notes


def _owners_by_box(surfaces: Surfaces, scene: Scene) -> NDArray[np.int32]:
    """Return for each triangle (m,) the index of the object whose box contains the triangle. If several boxes contain
    it, the smallest box counts; if none does, the index is `STRUCTURE`.
    """
    corners = surfaces.corners + surfaces.origin
    along = np.argsort(corners[:, 0, 0], kind="stable")
    sorted_x = corners[along, 0, 0]
    owner = np.full(len(corners), STRUCTURE, np.int32)
    boxes = [
        (float(np.prod(half)), number, centre, half, axes)
        for number, item in enumerate(scene.objects)
        if not vocabulary.is_structure(item.label)
        for centre, half, axes in item.solids
    ]
    for _, number, centre, half, axes in sorted(boxes, key=lambda box: (-box[0], box[1])):
        reach = float(np.abs(axes[0]) @ half) + MARGIN
        first, last = np.searchsorted(sorted_x, [centre[0] - reach, centre[0] + reach])
        near = along[first:last]
        inside = (np.abs((corners[near] - centre) @ axes) <= half + MARGIN).all(axis=(1, 2))
        owner[near[inside]] = number
    return owner


def _drawn(scene: Scene, geometry: SceneGeometry, notes: Sequence[str]) -> Surfaces:
    builder = SurfaceBuilder()
    corners = geometry.vertices[geometry.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.ptp(corners[:, :, 1], axis=1) == 0
    light = (normals**2 @ np.array(SIDES)) / np.maximum((normals**2).sum(axis=1), 1e-30)
    holders = _holders(scene.objects)
    order = np.argsort(geometry.owner, kind="stable")
    owners, starts = np.unique(geometry.owner[order], return_index=True)
    ends = np.append(starts[1:], len(order))
    for owner, start, end in zip(owners.tolist(), starts, ends[: len(starts)], strict=True):
        rows = order[start:end]
        if owner == STRUCTURE:
            upright = np.flatnonzero(~level[rows])
            # Floors come first, since walls have horizontal tops, too.
            floors = int(upright[0]) if len(upright) else len(rows)
            _add(builder, corners, rows[:floors], light, STRUCTURE, FLOOR_COLOUR)
            _add(builder, corners, rows[floors:], light, STRUCTURE, WALL_COLOUR)
            continue
        item = scene.objects[owner]
        colour = label_colour(item.label)
        if owner not in holders:
            _add(builder, corners, rows, light, owner, colour)
            continue
        _add(builder, corners[:, ::-1], rows, light, owner, colour)
        if vocabulary.is_frame(item.label):
            tops = rows[level[rows] & (normals[rows, 1] > 0)]
            lowered = corners[tops]
            lowered[:, :, 1] = np.minimum(lowered[:, :, 1], holders[owner])
            _add(builder, lowered, np.arange(len(tops)), light[tops], owner, colour)
    return builder.surfaces(notes)


def _holders(objects: Sequence[SceneObject]) -> dict[int, float]:
    """Return the indices of the objects whose boxes contain at least the share `HELD` of a smaller object's box, each
    with the height in metres on which the lowest of these rests, such as that of a seat; infinite if all are on the
    floor. A smaller object in a shut container does not count.
    """
    found: dict[int, float] = {}
    boxes = np.array([np.full((2, 3), np.nan) if o.box is None else o.box for o in objects]).reshape(-1, 2, 3)
    volume = np.prod(boxes[:, 1] - boxes[:, 0], axis=1)
    raised = boxes[:, 0, 1]
    for number, item in enumerate(objects):
        if not item.hidden and item.box is not None:
            low, high = boxes[number]
            # A flat box lies wholly in another one along its thin axis, or not at all.
            thin = np.maximum(high - low, 1e-9)
            within = (np.minimum(boxes[:, 1], low + thin) - np.maximum(boxes[:, 0], low)) / thin
            held = np.maximum(within, 0.0).prod(axis=1) >= HELD
            for holder in np.flatnonzero(held & (volume > volume[number])).tolist():
                rests = float(raised[number]) if raised[number] - raised[holder] > OFF_FLOOR else np.inf
                found[holder] = min(rests, found.get(holder, np.inf))
    return found


def _add(builder: SurfaceBuilder, corners: F64, rows: I64, light: F64, owner: int, colour: Colour) -> None:
    if len(rows):
        tint = np.round(light[rows, None, None] * 255).astype(np.uint8)
        tints = np.broadcast_to(tint, (len(rows), 3, 3))
        builder.add(corners[rows], owner, builder.material(Material(colour)), colours=tints)
