"""Read a Habitat scene dataset: its configuration, its templates by name, its scenes.

The format is that of habitat-sim's ``<name>.scene_dataset_config.json``: for each kind of template a list of search
paths, default attributes, and entries that define or modify a template.
"""

from __future__ import annotations

import glob
import os
import posixpath
import time
from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

from condvln.formats.dataset_root import DatasetRoot
from condvln.formats.json_document import JsonNode, parse_json
from condvln.sources.file_listing import FileListing, list_files
from condvln.sources.input_ledger import InputLedger
from condvln.sources.urdf import MAX_URDF_BYTES, LinkMesh, read_urdf
from schemas.errors import ConfigError, PathEscapeError

__all__ = ["CONFIG_SUFFIX", "Attribute", "SceneDataset", "Template"]

CONFIG_SUFFIX: Final = ".scene_dataset_config.json"
MAX_JSON_BYTES: Final = 64 << 20
"""Size limit in bytes of a document: ReplicaCAD's largest has 50 kB, the largest scene dataset config known 20 MB."""

KEPT_JSON_BYTES: Final = 1 << 13
"""Largest document in bytes whose parsed content is cached; templates have 1 kB."""

KEPT_URDF_BYTES: Final = 1 << 18
"""Largest URDF file in bytes whose parsed content is cached; ReplicaCAD's have 10 kB."""

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


@dataclass(frozen=True)
class _Listed:
    """The templates of a dataset by name, the problems found while listing them, and the stamp of each folder that was
    looked into.
    """

    indices: dict[str, _Index]
    listing: FileListing
    stamps: dict[str, tuple[int, int, int]]

    def is_current(self) -> bool:
        """Return whether all folders have the stamps that they had when they were listed."""
        return all(_stamp(folder) == stamp for folder, stamp in self.stamps.items())


_known_json = lru_cache(maxsize=1024)(parse_json)
"""Cached small documents, most of them templates shared by scenes, keyed by the file's bytes as well."""

_known_urdf = lru_cache(maxsize=64)(read_urdf)
"""Cached meshes of bodies shared by scenes, keyed by the file's bytes, so that a changed file is read again."""


_LISTED_KEPT: Final = 4
"""Number of datasets whose lists of templates are kept."""

_SETTLED: Final = 2_000_000_000
"""Nanoseconds. The list of a folder that has changed more recently is not kept, since another change might give it the
same stamp.
"""

_known_lists: OrderedDict[tuple[str, str, bytes], _Listed] = OrderedDict()
"""Kept lists of templates, by root folder, name of the configuration, and the configuration's bytes. To list the 200
files of ReplicaCAD takes an eighth of what a scene does.
"""


class SceneDataset:
    """The dataset under `root`, as it is on disk at construction.

    Raises
    ------
    ConfigError : the root folder has no dataset configuration, or several that are no variants of one
    """

    def __init__(self, root: DatasetRoot) -> None:
        self.root = root
        self.config_path = self._config_path()
        data = root.read(self.config_path, MAX_JSON_BYTES)
        self.config = self._parsed(self.config_path, data).object()
        listed = self._listed(data)
        self.listing = FileListing([], dict(listed.listing.passed_over), dict(listed.listing.faults))
        self._indices = listed.indices
        self._loaded: dict[str, Attribute] = {}
        self._present: dict[str, bool] = {}
        self._bodies: dict[str, tuple[LinkMesh, ...]] = {}

    def document(self, path: str) -> JsonNode:
        """Return a JSON document of the dataset.

        Raises
        ------
        InputError : it is missing or malformed
        """
        return self._parsed(path, self.root.read(path, MAX_JSON_BYTES))

    def _parsed(self, path: str, data: bytes) -> JsonNode:
        return (_known_json if len(data) <= KEPT_JSON_BYTES else parse_json)(data, str(self.root.folder / path))

    def has(self, path: str) -> bool:
        """Return whether a file exists; cached."""
        if path not in self._present:
            self._present[path] = self.root.has(path)
        return self._present[path]

    def links(self, path: str) -> tuple[LinkMesh, ...]:
        """Return the visual meshes of a URDF file.

        Raises
        ------
        InputError : it is missing or malformed
        """
        if path not in self._bodies:
            data, where = self.root.read(path, MAX_URDF_BYTES), str(self.root.folder / path)
            self._bodies[path] = (_known_urdf if len(data) <= KEPT_URDF_BYTES else read_urdf)(data, where)
        return self._bodies[path]

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

    def _listed(self, config: bytes) -> _Listed:
        """Return the templates of all kinds. They are listed again if the configuration or a folder has changed."""
        key = (self._full(""), self.config_path, config)
        known = _known_lists.get(key)
        if known is not None and known.is_current():
            _known_lists.move_to_end(key)
            return known
        begun, folders, listing = time.time_ns(), {""}, FileListing()
        indices = {kind: self._index(kind, listing, folders) for kind in _KINDS}
        listed = _Listed(indices, listing, {path: _stamp(path) for path in map(self._full, sorted(folders))})
        if all(changed < begun - _SETTLED for *_, changed in listed.stamps.values()):
            _known_lists[key] = listed
            while len(_known_lists) > _LISTED_KEPT:
                _known_lists.popitem(last=False)
        return listed

    def _full(self, folder: str) -> str:
        return str(self.root.folder / folder)

    def _index(self, kind: str, listing: FileListing, folders: set[str]) -> _Index:
        """Return the templates of one kind, and add the folders that were looked into to `folders`."""
        section = self.config.get(kind)
        index = _Index(kind)
        if section is None:
            return index
        index.defaults = section.get("default_attributes")
        paths = section.get("paths")
        found: set[str] = set()
        for extension, patterns in paths.items() if paths is not None else ():
            for pattern in patterns.elements():
                found |= self._search(kind, extension, pattern, folders)
        listing.take(self.root, found)
        kept = [path for path in listing.paths if path in found]
        listing.paths.clear()
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

    def _search(self, kind: str, extension: str, pattern: JsonNode, folders: set[str]) -> set[str]:
        """Return the files on a search path, and add the folders that were looked into to `folders`. A search path that
        leads out of the dataset is ignored, since configurations name folders of robots beside the dataset.
        """
        try:
            relative = self.root.join("", pattern.text(), where=pattern.where, place=pattern.place)
        except PathEscapeError:
            return set()
        suffixes = _ASSETS if extension in _ASSETS else tuple(s for s in _KINDS[kind] if s.endswith(extension))
        found: set[str] = set()
        parts = relative.split("/")
        for count in range(1, len(parts)):
            folders.update(glob.glob("/".join(parts[:count]), root_dir=self.root.folder))
        for path in glob.glob(relative, root_dir=self.root.folder):
            try:
                names = os.listdir(self.root.folder / path)
                folders.add(path)
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


def _stamp(folder: str) -> tuple[int, int, int]:
    """Return which folder is at a path, and when something was last added to it, renamed or taken away (nanoseconds);
    zeros if it can't be looked at.
    """
    try:
        status = os.stat(folder)
    except OSError:
        return 0, 0, 0
    return status.st_dev, status.st_ino, max(status.st_mtime_ns, status.st_ctime_ns)


def _stem(name: str, *suffixes: str) -> str:
    for suffix in suffixes:
        if name.endswith(suffix):
            return name[: -len(suffix)]
    return name
