"""Write layouts in the form of HSSD (``hssd-hab``): models by hash, a table of their categories, a lexicon that the
scenes' descriptors link to.

Names and folders are those of the released dataset: ``scenes/<scene>.scene_instance.json``, ``stages/``,
``objects/<first character>/<hash>.glb``, ``semantics/objects.csv``. Doors and windows are not made. Articulated bodies
are in ``urdf/``, as in the dataset's variants. The navmeshes in ``navmeshes/`` are not part of the release.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import orjson

from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import VARIANTS, catalogue
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.glb import glb_of_boxes
from condvln.samples.layout import Furniture, Layout
from condvln.samples.models import Model, articulated_files, model_of
from condvln.samples.replicacad import articulated_record, numbers, region_record, wxyz
from condvln.samples.stage import floor_boxes, wall_boxes

__all__ = ["hssd_files"]

NAME: Final = "hssd-hab"

Json = dict[str, Any]


def hssd_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes), the dataset configuration first.

    Parameters
    ----------
    layouts : scene name to layout; a scene's files depend only on its own layout and name
    """
    yield f"{NAME}.scene_dataset_config.json", _json(_dataset_config())
    classes = [{"name": "unknown", "id": 0}, *({"name": name, "id": number} for name, number in _class_ids().items())]
    yield f"semantics/{NAME}_semantic_lexicon.json", _json({"classes": classes})
    yield "semantics/objects.csv", _table()
    models: dict[tuple[str, int], Model] = {}
    for kind, variant in sorted({(p.kind, p.variant) for layout in layouts.values() for p in layout.furniture}):
        row = catalogue()[kind]
        if row.urdf is None:
            model = models[kind, variant] = model_of(row, variant)
            name = _hash(kind, variant)
            yield f"objects/{name[0]}/{name}.glb", model.glb
            yield f"objects/{name[0]}/{name}.object_config.json", _json(_object_config(name, row.label))
    for row in catalogue().values():
        if row.urdf is not None:
            for file, content in articulated_files(row).items():
                yield f"urdf/{row.urdf}/{file}", content
            described = {"urdf_filepath": f"{row.urdf}.urdf", "semantic_id": _class_ids()[row.label]}
            yield f"urdf/{row.urdf}/{row.urdf}.ao_config.json", _json(described)
    for name, layout in layouts.items():
        yield f"stages/{name}.glb", glb_of_boxes({"floor": floor_boxes(layout), "walls": wall_boxes(layout)})
        yield f"stages/{name}.stage_config.json", _json(_stage_config(name))
        yield f"scenes/{name}.scene_instance.json", _json(_scene_instance(name, layout, models))
        regions = {"region_annotations": [region_record(room, layout.ceiling) for room in layout.rooms]}
        yield f"semantics/scenes/{name}.semantic_config.json", _json(regions)
        yield f"navmeshes/{name}.navmesh", navmesh_of(layout, NavMeshSettings(include_static_objects=True)).to_bytes()


def _json(document: Json) -> bytes:
    return orjson.dumps(document)


def _hash(kind: str, variant: int) -> str:
    """Return a model's name: 40 hexadecimal digits, as those of the release."""
    return hashlib.sha1(f"{kind}/{variant}".encode(), usedforsecurity=False).hexdigest()


def _class_ids() -> dict[str, int]:
    return {name: number for number, name in enumerate(sorted({k.label for k in catalogue().values()}), start=1)}


def _dataset_config() -> Json:
    return {
        "stages": {"paths": {".json": ["stages"]}},
        "objects": {"paths": {".json": ["objects/*", "objects/decomposed/*"]}},
        "articulated_objects": {"paths": {".json": ["urdf/*/"]}},
        "scene_instances": {
            "default_attributes": {
                "default_lighting": "",
                "semantic_scene_instance": "%%CONFIG_NAME_AS_ASSET_FILENAME%%.semantic_config.json",
            },
            "paths": {".json": ["scenes"]},
        },
        "semantic_scene_descriptor_instances": {
            "default_attributes": {"semantic_descriptor_filename": f"../{NAME}_semantic_lexicon.json"},
            "paths": {".json": ["semantics/scenes/*"]},
        },
    }


def _table() -> bytes:
    """Return the table of all models of the catalogue, whether a scene has them or not."""
    rows = [
        f"{_hash(row.kind, variant)},{row.kind},{row.label}"
        for row in catalogue().values()
        if row.urdf is None
        for variant in range(VARIANTS)
    ]
    return "\n".join(["id,name,main_category", *sorted(rows), ""]).encode()


def _object_config(name: str, label: str) -> Json:
    # The class is coarse in the release; here every second model has one, and the table has the category of all.
    semantic = {"semantic_id": _class_ids()[label]} if int(name[-1], 16) % 2 else {}
    return {"render_asset": f"{name}.glb", "up": [0, 1, 0], "front": [0, 0, -1], **semantic}


def _stage_config(name: str) -> Json:
    return {
        "render_asset": f"{name}.glb",
        "up": [0, 1, 0],
        "front": [0, 0, -1],
        "margin": 0.01,
        "friction_coefficient": 0.8,
        "restitution_coefficient": 0.0,
    }


def _scene_instance(name: str, layout: Layout, models: Mapping[tuple[str, int], Model]) -> Json:
    rigid = [p for p in layout.furniture if catalogue()[p.kind].urdf is None]
    bodies = [p for p in layout.furniture if catalogue()[p.kind].urdf is not None]
    return {
        "stage_instance": {"template_name": f"stages/{name}"},
        "translation_origin": "asset_local",
        "object_instances": [_placed(piece, models[piece.kind, piece.variant]) for piece in rigid],
        "articulated_object_instances": [articulated_record(piece) for piece in bodies],
    }


def _placed(piece: Furniture, model: Model) -> Json:
    return {
        "template_name": _hash(piece.kind, piece.variant),
        "translation": numbers(np.array(piece.center) - piece.yaw.matrix @ model.center),
        "rotation": wxyz(piece),
        "non_uniform_scale": [1.0, 1.0, 1.0],
        "motion_type": "STATIC",
    }
