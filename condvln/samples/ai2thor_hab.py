"""Write layouts in the form of Habitat's ProcTHOR dataset (``ai2thor-hab``): scene instances without rooms, plus
houses.

``hab/`` is a Habitat scene dataset with the names and folders of the released one
(``configs/scenes/ProcTHOR/<n>/ProcTHOR-Train-<k>.scene_instance.json``); ``houses/train.jsonl.gz`` has house k in line
k. Both are in the house's own frame, with z mirrored. Only the houses contain rooms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from condvln.samples.catalogue import catalogue
from condvln.samples.layout import Layout
from condvln.samples.native_labels import native_labels
from condvln.samples.procthor import procthor_files
from condvln.samples.replicacad import LEXICON, replicacad_files

__all__ = ["HOUSES", "SCENES", "ai2thor_hab_files"]

SCENES: Final = "hab"
HOUSES: Final = "houses"
"""The two folders of the dataset."""

SCENES_A_FOLDER: Final = 100
DECIMALS: Final = 6

_SCENE: Final = "configs/scenes/"
_LEFT_OUT: Final = ("navmeshes", "configs/semantics/")


def ai2thor_hab_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files as (path relative to the folder that holds ``hab/`` and ``houses/``, bytes). Layout k becomes the
    scene ``ProcTHOR-Train-<k>``.
    """
    for path, content in procthor_files(layouts):
        yield f"{HOUSES}/{path.replace('houses.', 'train.')}", content
    named = {f"ProcTHOR-Train-{k}": in_house_frame(layout) for k, layout in enumerate(layouts.values())}
    for path, content in replicacad_files(named):
        if path.startswith(_LEFT_OUT):
            continue
        if path.startswith(_SCENE):
            name = path.removeprefix(_SCENE)
            folder = int(name.split(".")[0].rsplit("-", 1)[1]) // SCENES_A_FOLDER
            path, content = f"{_SCENE}ProcTHOR/{folder}/{name}", _scene(content)
        elif path.endswith(".scene_dataset_config.json"):
            path, content = "ai2thor-hab.scene_dataset_config.json", _dataset(content)
        elif path == f"configs/ssd/{LEXICON}.json":
            content = _lexicon(content)
        elif path.endswith(".ao_config.json"):
            content = _articulated(path.split("/")[1])
        yield f"{SCENES}/{path}", content


def in_house_frame(layout: Layout) -> Layout:
    """Return `layout` in the coordinate frame of its house. The lowest corner in Unity's frame becomes the origin; then
    z is mirrored.
    """
    (x0, _), (_, z1) = layout.bounds

    def point(x: float, z: float) -> tuple[float, float]:
        return round(x - x0, DECIMALS) + 0.0, round(z - z1, DECIMALS) + 0.0

    def center(at: tuple[float, float, float]) -> tuple[float, float, float]:
        x, z = point(at[0], at[2])
        return x, at[1], z

    return replace(
        layout,
        rooms=tuple(replace(room, polygon=tuple(point(*c) for c in room.polygon)) for room in layout.rooms),
        doors=tuple(replace(door, start=point(*door.start), end=point(*door.end)) for door in layout.doors),
        furniture=tuple(replace(piece, center=center(piece.center)) for piece in layout.furniture),
    )


def _scene(content: bytes) -> bytes:
    document = orjson.loads(content)
    del document["navmesh_instance"], document["semantic_scene_instance"]
    return orjson.dumps(document)


def _dataset(content: bytes) -> bytes:
    document: dict[str, Any] = orjson.loads(content)
    del document["navmesh_instances"]
    document["scene_instances"]["paths"] = {".json": ["configs/scenes/ProcTHOR/*"]}
    document["articulated_objects"]["paths"] = {".json": ["urdf/*/"]}
    del document["semantic_scene_descriptor_instances"]["paths"]
    return orjson.dumps(document)


def _lexicon(content: bytes) -> bytes:
    """Return the semantic lexicon with each of the catalogue's words replaced by AI2-THOR's object type."""
    classes = [{**c, "name": native_labels()[c["name"]].ai2thor} for c in orjson.loads(content)["classes"]]
    return orjson.dumps({"classes": classes})


def _articulated(name: str) -> bytes:
    """Return the configuration of the articulated body `name`. Habitat's ProcTHOR has no names for the types of such
    bodies, so the semantic id is the position (from 1) of the body's label among the catalogue's sorted labels.
    """
    (label,) = {kind.label for kind in catalogue().values() if kind.urdf == name}
    number = sorted({kind.label for kind in catalogue().values()}).index(label) + 1
    return orjson.dumps({"urdf_filepath": f"{name}.urdf", "semantic_id": number})
