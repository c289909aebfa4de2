"""Collect the surfaces that a camera sees: textured meshes, or walls and boxes in one colour per label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.glb import MAX_GLB_BYTES
from condvln.formats.glb_part import read_part
from condvln.labels import Vocabulary, vocabulary
from condvln.scene import MeshPart, OrientedBox, Scene, SceneObject
from condvln.scene.geometry import STRUCTURE, SceneGeometry
from condvln.scene.palette import FLOOR_COLOUR, WALL_COLOUR, Colour, label_colour
from condvln.sensors.gltf_faces import DrawnFile, drawn_file
from condvln.sensors.surfaces import Material, SurfaceBuilder, Surfaces
from condvln.sources.solids import floor, joined, object_boxes

__all__ = ["BOXES", "MARGIN", "NO_STAGE", "NO_WALLS", "OWNERS_BY_BOX", "scene_surfaces"]

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

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def scene_surfaces(scene: Scene, geometry: SceneGeometry | None, words: Vocabulary = vocabulary) -> Surfaces:
    """Return all visible surfaces of a scene.

    Parameters
    ----------
    geometry : the scene's triangles, from its source

    Raises
    ------
    InputError : a mesh can't be read
    """
    if geometry is not None and geometry.approximate:
        return _drawn(scene, geometry, (BOXES,), words)
    if scene.stage or any(item.mesh for item in scene.objects):
        return _assembled(scene, words)
    things = [(k, o) for k, o in enumerate(scene.objects) if not _is_structure(o.label, words)]
    floors = [floor(room.polygon, room.floor_y) for room in scene.rooms if room.polygon is not None]
    return _drawn(scene, joined([*floors, object_boxes(things)], approximate=True), (BOXES, NO_WALLS), words)


def _assembled(scene: Scene, words: Vocabulary) -> Surfaces:
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
    return replace(surfaces, owner=_owners_by_box(surfaces, scene, words)) if scan else surfaces


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


def _owners_by_box(surfaces: Surfaces, scene: Scene, words: Vocabulary) -> NDArray[np.int32]:
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
        if not _is_structure(item.label, words)
        for centre, half, axes in _boxes(item.obb, item.box)
    ]
    for _, number, centre, half, axes in sorted(boxes, key=lambda box: (-box[0], box[1])):
        reach = float(np.abs(axes[0]) @ half) + MARGIN
        first, last = np.searchsorted(sorted_x, [centre[0] - reach, centre[0] + reach])
        near = along[first:last]
        inside = (np.abs((corners[near] - centre) @ axes) <= half + MARGIN).all(axis=(1, 2))
        owner[near[inside]] = number
    return owner


def _boxes(obb: OrientedBox | None, box: F64 | None) -> list[tuple[F64, F64, F64]]:
    """Return (centre, half extents, axes) of the oriented box if it is known, else of the axis-aligned box; empty if
    neither is known.
    """
    if obb is not None:
        return [(obb.center, obb.half_extents, obb.rotation)]
    return [] if box is None else [(box.mean(axis=0), (box[1] - box[0]) / 2, np.eye(3))]


def _drawn(scene: Scene, geometry: SceneGeometry, notes: Sequence[str], words: Vocabulary) -> Surfaces:
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
        if words.is_frame(item.label):
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


def _is_structure(label: str, words: Vocabulary) -> bool:
    return label in words.labels and words.entry(label).kind == "structure"
