"""Read the materials of a GLB file with their textures.

A texture whose image is not embedded in the file is left out and counted; its material keeps its colours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from condvln.formats.json_document import JsonNode

__all__ = ["Image", "MaterialReader", "shifted"]

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

Tree = dict[str, Any]


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
        self.materials: list[Tree] = []
        self.textures: list[Tree] = []
        self.samplers: list[Tree] = []
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

    def _material(self, source: JsonNode) -> Tree:
        made: Tree = {}
        shine = source.get("pbrMetallicRoughness")
        if shine is not None:
            inner: Tree = {}
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

    def _slots(self, source: JsonNode, names: tuple[str, ...]) -> Tree:
        found: Tree = {}
        for name in names:
            slot = source.get(name)
            texture = None if slot is None else self._texture(slot["index"])
            if slot is not None and texture is not None:
                found[name] = {"index": texture} | self._placement(slot)
        return found

    def _placement(self, slot: JsonNode) -> Tree:
        """Return the settings of a texture reference, without its index."""
        made: Tree = {"texCoord": _one_of(slot["texCoord"], _COORDINATES)} if "texCoord" in slot else {}
        made |= {key: slot[key].number(_LIMIT) for key in ("scale", "strength") if key in slot}
        extensions = slot.get("extensions")
        moved = None if extensions is None else extensions.get(_TRANSFORM)
        if moved is not None:
            own: Tree = {k: moved[k].vector(2, _LIMIT).tolist() for k in ("offset", "scale") if k in moved}
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

    def _image_of(self, source: JsonNode) -> Tree | None:
        made: Tree = {}
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


def shifted(material: Tree, textures: int) -> Tree:
    """Return a copy of a material whose texture numbers are increased by `textures`."""

    def moved(inner: Tree, names: tuple[str, ...]) -> Tree:
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
