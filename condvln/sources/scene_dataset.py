"""Read a Habitat scene dataset: its configuration, its templates by name, its scenes, its semantic classes.

The format is that of habitat-sim's ``<name>.scene_dataset_config.json``: for each kind of template a list of search
paths, default attributes, and entries that define or modify a template.
"""

from __future__ import annotations

import glob
import os
import posixpath
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from condvln.formats.dataset_root import DatasetRoot, FileListing, list_files
from condvln.formats.json_document import JsonNode, parse_json
from condvln.kept import kept
from condvln.sources.source import InputLedger
from condvln.sources.urdf import MAX_URDF_BYTES, LinkMesh, read_urdf
from schemas.errors import ConfigError, MissingFileError, PathEscapeError

__all__ = [
    "CONFIG_SUFFIX",
    "Attribute",
    "Lexicon",
    "SceneDataset",
    "Template",
    "read_descriptors",
]

CONFIG_SUFFIX: Final = ".scene_dataset_config.json"
MAX_JSON_BYTES: Final = 64 << 20
"""Size limit in bytes of a document: ReplicaCAD's largest has 50 kB, the largest scene dataset config known 20 MB."""

_KINDS: Final[dict[str, tuple[str, ...]]] = {
    "stages": (".stage_config.json",),
    "objects": (".object_config.json",),
    "articulated_objects": (".ao_config.json", ".urdf"),
    "scene_instances": (".scene_instance.json",),
    "semantic_scene_descriptor_instances": (".semantic_config.json",),
}
_ASSETS: Final = (".glb",)


@dataclass(frozen=True, slots=True)
class Attribute:
    """The value of an attribute, and the folder to which a path in this value is relative."""

    node: JsonNode
    folder: str


@dataclass(frozen=True)
class Template:
    """The description of a stage, object or articulated object, which scenes place by name.

    handle : its name without folder and suffix
    path : its file, relative to the root
    layers : the documents with its attributes, highest priority first
    """

    handle: str
    path: str
    layers: tuple[Attribute, ...] = ()

    def get(self, key: str) -> Attribute | None:
        """Return an attribute; None if no layer sets it."""
        for layer in self.layers:
            node = layer.node.get(key)
            if node is not None:
                return Attribute(node, layer.folder)
        return None


@dataclass(frozen=True, slots=True)
class _Entry:
    """A template that is known by name, but not read yet."""

    handle: str
    path: str
    made: JsonNode | None = None


@dataclass
class _Index:
    """The templates of one kind, such as all stages."""

    kind: str
    defaults: JsonNode | None = None
    entries: list[_Entry] = field(default_factory=list)
    by_handle: dict[str, list[_Entry]] = field(default_factory=dict)


class SceneDataset:
    """The dataset under `root`, as it is on disk at construction.

    Raises
    ------
    ConfigError : the root folder has no dataset configuration, or several that are no variants of one
    """

    def __init__(self, root: DatasetRoot) -> None:
        self.root = root
        self.config_path = self._config_path()
        self.config = self.document(self.config_path).object()
        self.listing = FileListing()
        self._indices = {kind: self._index(kind) for kind in _KINDS}
        self._loaded: dict[str, Attribute] = {}

    def document(self, path: str) -> JsonNode:
        """Return a JSON document of the dataset.

        Raises
        ------
        InputError : it is missing or malformed
        """
        return parse_json(self.root.read(path, MAX_JSON_BYTES), str(self.root.folder / path))

    @kept
    def has(self, path: str) -> bool:
        """Return whether a file exists; cached."""
        return self.root.has(path)

    @kept
    def links(self, path: str) -> tuple[LinkMesh, ...]:
        """Return the visual meshes of a URDF file.

        Raises
        ------
        InputError : it is missing or malformed
        """
        data, where = self.root.read(path, MAX_URDF_BYTES), str(self.root.folder / path)
        return read_urdf(data, where)

    def scenes(self) -> dict[str, str]:
        """Return the path of each scene instance by scene id. The id is the file's name, with the folder in front if
        several files have the same name.
        """
        entries = [e for e in self._indices["scene_instances"].entries if e.made is None]
        times = Counter(e.handle for e in entries)
        return {e.handle if times[e.handle] == 1 else _stem(e.path, ".scene_instance.json"): e.path for e in entries}

    def default(self, kind: str, key: str) -> JsonNode | None:
        """Return the dataset's default value of the attribute `key` for a kind of template; None if there is none."""
        defaults = self._indices[kind].defaults
        return None if defaults is None else defaults.get(key)

    def template(self, kind: str, name: str, ledger: InputLedger) -> tuple[Template | None, int]:
        """Return the template that a scene refers to by `name`, and the number of templates that match this name.

        As in habitat-sim, an exact match is preferred, then names that contain `name`; of several, the first by path.

        Raises
        ------
        InputError : its file is missing or malformed
        """
        index = self._indices[kind]
        wanted = posixpath.basename(_stem(name, *_KINDS[kind], *_ASSETS))
        meant = index.by_handle.get(wanted, [])
        if len(meant) > 1:
            meant = [e for e in meant if name in e.path] or meant
        if not meant:
            meant = [e for e in index.entries if name in e.path or wanted in e.handle]
        if not meant:
            return None, 0
        return self._load(index, meant[0], ledger), len(meant)

    def entry(self, kind: str, name: str) -> JsonNode | None:
        """Return the path listed under `name` in the section `kind` (``navmesh_instances`` or
        ``semantic_scene_descriptor_instances``); None if there is none.
        """
        section = self.config.get(kind)
        return None if section is None or name in ("paths", "configs", "default_attributes") else section.get(name)

    def described(self, kind: str, name: str) -> str | None:
        """Return the path of the file named `name` on the search paths for this `kind`; None if there is none."""
        wanted = posixpath.basename(_stem(name, *_KINDS[kind]))
        return next((e.path for e in self._indices[kind].entries if e.handle == wanted), None)

    def _config_path(self) -> str:
        found = list_files(self.root, [f"*{CONFIG_SUFFIX}"]).paths
        # HSSD has hssd-hab-uncluttered.scene_dataset_config.json beside hssd-hab.scene_dataset_config.json.
        plain = min(found, key=len, default="").removesuffix(CONFIG_SUFFIX)
        if not found or any(path != f"{plain}{CONFIG_SUFFIX}" and not path.startswith(f"{plain}-") for path in found):
            raise ConfigError(
                f"{len(found)} files *{CONFIG_SUFFIX} are in this folder, but exactly one is expected, or one and "
                "variants of it whose names begin with its name and a hyphen",
                where=self.root.folder,
                remedy="Set the source's 'root' to the folder that holds the dataset's configuration",
            )
        return f"{plain}{CONFIG_SUFFIX}"

    def _index(self, kind: str) -> _Index:
        """Return the templates of one kind."""
        section = self.config.get(kind)
        index = _Index(kind)
        if section is None:
            return index
        index.defaults = section.get("default_attributes")
        paths = section.get("paths")
        found: set[str] = set()
        for extension, patterns in paths.items() if paths is not None else ():
            for pattern in patterns.elements():
                found |= self._search(kind, extension, pattern)
        self.listing.take(self.root, found)
        kept = [path for path in self.listing.paths if path in found]
        self.listing.paths.clear()
        index.entries = [_Entry(posixpath.basename(_stem(p, *_KINDS[kind], *_ASSETS)), p) for p in kept]
        for made in section.array("configs"):
            handle = made.get("template_handle") or made.get("original_file")
            if handle is None:
                made.fail("an entry needs 'template_handle' or 'original_file'")
            else:
                index.entries.append(_Entry(posixpath.basename(_stem(handle.text(), *_KINDS[kind])), "", made))
        for entry in index.entries:
            index.by_handle.setdefault(entry.handle, []).append(entry)
        return index

    def _search(self, kind: str, extension: str, pattern: JsonNode) -> set[str]:
        """Return the files on a search path. One that leads out of the dataset is ignored, since configurations name
        folders of robots beside the dataset.
        """
        try:
            relative = self.root.join("", pattern.text(), where=pattern.where, place=pattern.place)
        except PathEscapeError:
            return set()
        suffixes = _ASSETS if extension in _ASSETS else tuple(s for s in _KINDS[kind] if s.endswith(extension))
        found: set[str] = set()
        for path in glob.glob(relative, root_dir=self.root.folder):
            try:
                names = os.listdir(self.root.folder / path)
            except OSError:
                names = []
            inside = [f"{path}/{name}" for name in names if not name.startswith(".")]
            found.update(p for p in (path, *inside) if p.endswith(suffixes))
        return found

    def _load(self, index: _Index, entry: _Entry, ledger: InputLedger) -> Template:
        layers: list[Attribute] = []
        path = entry.path
        if entry.made is not None:
            ledger.entry(self.config_path, f"{index.kind}.configs.{entry.handle}", entry.made.value)
            attributes = entry.made.get("attributes")
            if attributes is not None:
                layers.append(Attribute(attributes, ""))
            original = entry.made.get("original_file")
            if original is not None:
                path = self.root.join("", original.text(), where=original.where, place=original.place)
        if path.endswith(".json"):
            ledger.file(path)
            if path not in self._loaded:
                document = self.document(path).object()
                self._loaded[path] = Attribute(document, posixpath.dirname(path))
            layers.append(self._loaded[path])
        if index.defaults is not None:
            ledger.entry(self.config_path, f"{index.kind}.default_attributes", index.defaults.value)
            layers.append(Attribute(index.defaults, ""))
        return Template(entry.handle, path, tuple(layers))


def _stem(name: str, *suffixes: str) -> str:
    for suffix in suffixes:
        if name.endswith(suffix):
            return name[: -len(suffix)]
    return name


_TAG = "%%CONFIG_NAME_AS_ASSET_FILENAME%%"


class Lexicon:
    """The names of a dataset's semantic classes, by id."""

    def __init__(self, path: str, document: JsonNode) -> None:
        self._path = path
        self._classes: dict[int, tuple[str, JsonNode]] = {}
        for node in document["classes"].elements():
            number, name = node["id"].integer(), node["name"].text()
            if number in self._classes:
                node.fail(f"two classes have the id {number}")
            if not name.strip():
                node["name"].fail("the class has no name")
            self._classes[number] = (name, node)

    def name(self, number: int, ledger: InputLedger) -> str | None:
        """Return the name of a class; None if no class has this id."""
        name, node = self._classes.get(number, (None, None))
        ledger.entry(self._path, f"classes.{number}", None if node is None else node.value)
        return name


def read_descriptors(
    dataset: SceneDataset, scene_name: str, own: JsonNode | None, ledger: InputLedger
) -> tuple[Lexicon, tuple[str, JsonNode] | None]:
    """Return a scene's lexicon and its region annotations. The annotations come as (path of their file, annotations),
    or as None if the scene has none.

    The scene's own semantic descriptor is read first, then the dataset's default one, which fills in what the first
    lacks, then the lexicon that one of them links to.

    Raises
    ------
    MissingFileError : a named descriptor does not exist, or none holds classes
    FormatError : a descriptor is malformed
    """
    lexicon: Lexicon | None = None
    regions: tuple[str, JsonNode] | None = None
    looked_at: list[str] = []
    for named in (own, dataset.default("scene_instances", "semantic_scene_instance")):
        if named is None:
            continue
        path = _descriptor_path(dataset, scene_name, named, ledger)
        if path in looked_at:
            continue
        looked_at.append(path)
        document = dataset.document(path).object()
        annotations = document.get("region_annotations")
        if regions is None and annotations is not None:
            regions = (path, annotations)
            ledger.entry(path, "region_annotations", annotations.value)
        if lexicon is None and "classes" in document:
            lexicon = Lexicon(path, document)
    if lexicon is None:
        lexicon = next(filter(None, (_linked_lexicon(dataset, path, ledger) for path in looked_at)), None)
    if lexicon is None:
        raise MissingFileError(
            "no semantic lexicon ('classes') is named for this scene",
            where=dataset.root.folder / dataset.config_path,
            place="semantic_scene_descriptor_instances",
            remedy="Put the dataset's lexicon back and name it there",
        )
    return lexicon, regions


def _linked_lexicon(dataset: SceneDataset, path: str, ledger: InputLedger) -> Lexicon | None:
    """Return the lexicon that the descriptor at `path` names in ``semantic_descriptor_filename``, or the dataset's
    default for descriptors; None if there is none. The name is relative to the descriptor's folder.
    """
    key = "semantic_descriptor_filename"
    named = dataset.document(path).get(key) or dataset.default("semantic_scene_descriptor_instances", key)
    if named is None:
        return None
    linked = dataset.root.join(posixpath.dirname(path), named.text(), where=named.where, place=named.place)
    _require(dataset, linked, key, named)
    ledger.entry(path, key, named.value)
    document = dataset.document(linked).object()
    return Lexicon(linked, document) if "classes" in document else None


def _descriptor_path(dataset: SceneDataset, scene_name: str, named: JsonNode, ledger: InputLedger) -> str:
    """Return the path of the named descriptor file, relative to the root."""
    kind = "semantic_scene_descriptor_instances"
    handle = named.text().replace(_TAG, scene_name)
    entry = dataset.entry(kind, handle)
    if entry is not None:
        ledger.entry(dataset.config_path, f"{kind}.{handle}", entry.value)
        path = dataset.root.join("", entry.text(), where=entry.where, place=entry.place)
    else:
        path = dataset.described(kind, handle) or dataset.root.join("", handle, where=named.where, place=named.place)
    _require(dataset, path, named.place or kind, named)
    return path


def _require(dataset: SceneDataset, path: str, key: str, named: JsonNode) -> None:
    if not dataset.root.has(path):
        raise MissingFileError(
            "the semantic lexicon file does not exist",
            where=dataset.root.folder / path,
            remedy=f"Download it again, or correct {key!r} in {named.where}",
        )
