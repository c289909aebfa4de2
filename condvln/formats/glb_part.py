"""Read a GLB file with its vertex attributes and materials: as a part of a larger file, or for rendering.

trimesh decodes the geometry, after `condvln.formats.gltf_tree` has checked it. Materials, samplers and encoded images
are those of the file's JSON: trimesh has no place for wrap modes, texture transforms and KTX2 images. Skins,
animations, cameras and lights are dropped. A texture whose image is not embedded in the file is left out and counted;
its material keeps its colours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.formats.glb import decoded, glb_chunks, own_buffers
from condvln.formats.gltf_tree import ATTRIBUTES, CheckedNode, checked_tree
from condvln.formats.json_document import JsonNode
from schemas.base import Json
from schemas.errors import FormatError

if TYPE_CHECKING:
    import trimesh

__all__ = [
    "GlbPart",
    "Image",
    "MaterialReader",
    "Primitive",
    "read_part",
    "shifted",
]

_MIME: Final = frozenset({"image/png", "image/jpeg", "image/webp", "image/ktx2", "image/vnd-ms.dds", "image/x-basis"})
_IMAGE_EXTENSIONS: Final = ("KHR_texture_basisu", "EXT_texture_webp", "GOOGLE_texture_basis")
"""Extensions by which a texture uses an image format other than PNG and JPEG."""
_TRANSFORM: Final = "KHR_texture_transform"
_UNLIT: Final = "KHR_materials_unlit"
_FILTERS, _WRAPS = frozenset({9728, 9729, 9984, 9985, 9986, 9987}), frozenset({10497, 33071, 33648})
_SAMPLER: Final = {"magFilter": _FILTERS, "minFilter": _FILTERS, "wrapS": _WRAPS, "wrapT": _WRAPS}
_COORDINATES: Final = frozenset({0, 1})
"""Largest number of texture coordinate sets that are copied."""
_SLOTS: Final = ("normalTexture", "occlusionTexture", "emissiveTexture")
_PBR_SLOTS: Final = ("baseColorTexture", "metallicRoughnessTexture")
_ALPHA_MODES: Final = frozenset({"OPAQUE", "MASK", "BLEND"})
_LIMIT: Final = 1e6
MAX_COPIES: Final = 2
"""Largest ratio of the bytes that all images read to the file's bytes."""


@dataclass(frozen=True, slots=True)
class Image:
    """An encoded image, never decoded here."""

    mime: str
    data: bytes


class MaterialReader:
    """Reads materials of one file with their textures, samplers and images. Only what is requested is kept, and each
    kind is renumbered from 0.
    """

    def __init__(self, root: JsonNode, binary: bytes) -> None:
        self._root, self._binary = root, binary
        self.materials: list[Json] = []
        self.textures: list[Json] = []
        self.samplers: list[Json] = []
        self.images: list[Image] = []
        self.used: set[str] = set()
        self.required: set[str] = set()
        self.lost = 0
        self._number: dict[tuple[str, int], int | None] = {}
        self._copied = 0
        self._asked = {node.text() for node in root.array("extensionsRequired")}

    def material(self, node: JsonNode) -> int:
        """Return the number of a material in `materials`. The integer in `node` is the material's index in the file.

        Raises
        ------
        FormatError : an index is out of range, a type is wrong, or bytes are missing
        """
        index = node.index(len(self._root.array("materials")))
        if ("materials", index) not in self._number:
            made = self._material(self._root.array("materials")[index])
            self._number["materials", index] = len(self.materials)
            self.materials.append(made)
        return self._number["materials", index] or 0

    def _material(self, source: JsonNode) -> Json:
        made: Json = {}
        shine = source.get("pbrMetallicRoughness")
        if shine is not None:
            inner: Json = {}
            if "baseColorFactor" in shine:
                inner["baseColorFactor"] = shine["baseColorFactor"].vector(4, _LIMIT).tolist()
            inner |= {k: shine[k].number(_LIMIT) for k in ("metallicFactor", "roughnessFactor") if k in shine}
            made["pbrMetallicRoughness"] = inner | self._slots(shine, _PBR_SLOTS)
        made |= self._slots(source, _SLOTS)
        if "emissiveFactor" in source:
            made["emissiveFactor"] = source["emissiveFactor"].vector(3, _LIMIT).tolist()
        if source.get("alphaMode") is not None:
            mode = source["alphaMode"].text()
            if mode not in _ALPHA_MODES:
                source["alphaMode"].fail(f"{mode!r} is not an alpha mode")
            made["alphaMode"] = mode
        if "alphaCutoff" in source:
            made["alphaCutoff"] = source["alphaCutoff"].number(_LIMIT)
        if "doubleSided" in source:
            made["doubleSided"] = source["doubleSided"].boolean()
        extensions = source.get("extensions")
        if extensions is not None and _UNLIT in extensions:
            made["extensions"] = {_UNLIT: {}}
            self._uses(_UNLIT)
        return made

    def _slots(self, source: JsonNode, names: tuple[str, ...]) -> Json:
        found: Json = {}
        for name in names:
            slot = source.get(name)
            texture = None if slot is None else self._texture(slot["index"])
            if slot is not None and texture is not None:
                found[name] = {"index": texture} | self._placement(slot)
        return found

    def _placement(self, slot: JsonNode) -> Json:
        """Return the settings of a texture reference, without its index."""
        made: Json = {"texCoord": _one_of(slot["texCoord"], _COORDINATES)} if "texCoord" in slot else {}
        made |= {key: slot[key].number(_LIMIT) for key in ("scale", "strength") if key in slot}
        extensions = slot.get("extensions")
        moved = None if extensions is None else extensions.get(_TRANSFORM)
        if moved is not None:
            own: Json = {k: moved[k].vector(2, _LIMIT).tolist() for k in ("offset", "scale") if k in moved}
            if "rotation" in moved:
                own["rotation"] = moved["rotation"].number(_LIMIT)
            if "texCoord" in moved:
                own["texCoord"] = _one_of(moved["texCoord"], _COORDINATES)
            made["extensions"] = {_TRANSFORM: own}
            self._uses(_TRANSFORM)
        return made

    def _texture(self, node: JsonNode) -> int | None:
        index = node.index(len(self._root.array("textures")))
        if ("textures", index) not in self._number:
            source = self._root.array("textures")[index]
            made = self._image_of(source)
            if made is None:
                self.lost += 1
                self._number["textures", index] = None
            else:
                if "sampler" in source:
                    made["sampler"] = self._sampler(source["sampler"])
                self._number["textures", index] = len(self.textures)
                self.textures.append(made)
        return self._number["textures", index]

    def _image_of(self, source: JsonNode) -> Json | None:
        made: Json = {}
        if source.get("source") is not None:
            image = self._image(source["source"])
            if image is not None:
                made["source"] = image
        extensions = source.get("extensions")
        for name in _IMAGE_EXTENSIONS:
            other = None if extensions is None else extensions.get(name)
            image = None if other is None else self._image(other["source"])
            if image is not None:
                made.setdefault("extensions", {})[name] = {"source": image}
                self._uses(name)
        return made or None

    def _image(self, node: JsonNode) -> int | None:
        """Return the new number of an image; None if the image's bytes are not in the file."""
        index = node.index(len(self._root.array("images")))
        if ("images", index) not in self._number:
            source = self._root.array("images")[index]
            inside = source.get("bufferView") is not None
            self._number["images", index] = len(self.images) if inside else None
            if inside:
                self.images.append(Image(self._mime(source), self._bytes(source["bufferView"])))
        return self._number["images", index]

    def _mime(self, source: JsonNode) -> str:
        mime = source["mimeType"].text()
        if mime not in _MIME:
            source["mimeType"].fail(f"{mime!r:.60} is not a supported image type")
        return mime

    def _bytes(self, node: JsonNode) -> bytes:
        views = self._root.array("bufferViews")
        view = views[node.index(len(views))]
        start = view["byteOffset"].integer() if "byteOffset" in view else 0
        length = view["byteLength"].integer()
        if view["buffer"].integer() != 0 or min(start, length) < 0 or start + length > len(self._binary):
            view.fail(
                f"the image claims bytes {start} to {start + length}, but the binary chunk has {len(self._binary)}"
            )
        self._copied += length
        if self._copied > MAX_COPIES * len(self._binary):
            view.fail(f"images read the same bytes more than {MAX_COPIES} times")
        return self._binary[start : start + length]

    def _sampler(self, node: JsonNode) -> int:
        index = node.index(len(self._root.array("samplers")))
        if ("samplers", index) not in self._number:
            source = self._root.array("samplers")[index]
            self._number["samplers", index] = len(self.samplers)
            self.samplers.append({k: _one_of(source[k], values) for k, values in _SAMPLER.items() if k in source})
        return self._number["samplers", index] or 0

    def _uses(self, extension: str) -> None:
        self.used.add(extension)
        if extension in self._asked:
            self.required.add(extension)


def shifted(material: Json, textures: int) -> Json:
    """Return a copy of a material whose texture numbers are increased by `textures`."""

    def moved(inner: Json, names: tuple[str, ...]) -> Json:
        return {
            key: {**value, "index": value["index"] + textures} if key in names else value
            for key, value in inner.items()
        }

    made = moved(material, _SLOTS)
    if "pbrMetallicRoughness" in made:
        made["pbrMetallicRoughness"] = moved(made["pbrMetallicRoughness"], _PBR_SLOTS)
    return made


def _one_of(node: JsonNode, known: frozenset[int]) -> int:
    value = node.integer()
    if value not in known:
        node.fail(f"{value} is none of {', '.join(map(str, sorted(known)))}")
    return value


_REMEDY: Final = "Take the file from its dataset again"


@dataclass(frozen=True, eq=False, slots=True)
class Primitive:
    """Triangles of one material.

    points : (n, 3) float32 positions
    faces : (m, 3) indices of the points
    attributes : other numbers of each vertex (n, width), by glTF's name, as they are stored
    normalized : names of the attributes that are integers to be scaled to [0, 1]
    material : number of the material in the part's `look`, None if there is none
    """

    points: NDArray[np.float32]
    faces: NDArray[np.int64]
    attributes: dict[str, NDArray[Any]]
    normalized: frozenset[str]
    material: int | None

    def rows(self, name: str) -> NDArray[Any] | None:
        """Return an attribute as numbers (n, width), scaled where it is normalized; None if there is none."""
        rows = self.attributes.get(name)
        return rows if rows is None or name not in self.normalized else rows / np.iinfo(rows.dtype).max


@dataclass(slots=True)
class GlbPart:
    """The content of one file. In `nodes`, parents come before their children; `meshes` are lists of primitives; `look`
    has the materials and their textures.
    """

    nodes: list[CheckedNode] = field(default_factory=list)
    meshes: list[list[Primitive]] = field(default_factory=list)
    look: MaterialReader | None = None


def read_part(data: bytes, where: str) -> GlbPart:
    """Read the default scene of a GLB file.

    Raises
    ------
    FormatError : the file is truncated, inconsistent, malicious, in an extension that can't be read, or without
        triangles; `where` names it
    """
    root, binary = glb_chunks(data, where)
    tree = checked_tree(root, own_buffers(root, binary), attributes=True)
    look = MaterialReader(root, binary)
    scene = decoded(tree, where)
    primitives = []
    for number, material in enumerate(tree.materials):
        mesh = scene.geometry[f"p{number}"]
        own = None if material is None else look.material(material)
        primitives.append(_primitive(mesh, tree.normalized[number], own, where))
    return GlbPart(tree.nodes, [[primitives[k] for k in mesh] for mesh in tree.meshes], look)


def _primitive(mesh: trimesh.Trimesh, normalized: frozenset[str], material: int | None, where: str) -> Primitive:
    points = np.asarray(mesh.vertices, np.float32)  # as stored: trimesh has widened them
    if not np.isfinite(points).all():
        raise FormatError("a vertex is not finite", where=where, remedy=_REMEDY)
    found = {
        name: np.asarray(rows) for name in ATTRIBUTES if (rows := mesh.vertex_attributes.get(f"_{name}")) is not None
    }
    return Primitive(points, np.asarray(mesh.faces, np.int64), found, normalized, material)
