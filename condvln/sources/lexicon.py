"""Read the semantic classes (id → name) of a Habitat dataset, and the region annotations in the same files."""

from __future__ import annotations

import posixpath

from condvln.formats.json_document import JsonNode
from condvln.sources.input_ledger import InputLedger
from condvln.sources.scene_dataset import SceneDataset
from schemas.errors import MissingFileError

__all__ = ["Lexicon", "read_descriptors"]

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
    if not dataset.root.has(linked):
        raise MissingFileError(
            "the semantic lexicon file does not exist",
            where=dataset.root.folder / linked,
            remedy=f"Download it again, or correct {key!r} in {named.where}",
        )
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
    if not dataset.root.has(path):
        raise MissingFileError(
            "the semantic lexicon file does not exist",
            where=dataset.root.folder / path,
            remedy=f"Download it again, or correct {named.place or kind!r} in {named.where}",
        )
    return path
