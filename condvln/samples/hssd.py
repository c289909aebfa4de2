"""Write layouts in the form of HSSD (``hssd-hab``): models by hash, a table of their categories, a lexicon that the
scenes' descriptors link to.

Names and folders are those of the released dataset: ``scenes/<scene>.scene_instance.json``, ``stages/``,
``objects/<first character>/<hash>.glb``, ``semantics/objects.csv``. Doors and windows are not made. Articulated bodies
are in ``urdf/``, as in the dataset's variants. The navmeshes in ``navmeshes/`` are not part of the release.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import orjson

from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import VARIANTS, catalogue, class_ids, record
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.layout import Furniture, Layout
from condvln.samples.models import Model, articulated_files, bodies, glb_of_boxes, models_of
from condvln.samples.replicacad import articulated_records, numbers, region_record, wxyz
from condvln.samples.solid import floor_boxes, wall_boxes
from schemas.base import Json

__all__ = ["hssd_files"]

NAME: Final = "hssd-hab"


def hssd_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes), the dataset configuration first.

    Parameters
    ----------
    layouts : scene name to layout; a scene's files depend only on its own layout and name
    """
    yield f"{NAME}.scene_dataset_config.json", orjson.dumps(record("hssd dataset", dataset=NAME))
    classes = [{"name": "unknown", "id": 0}, *({"name": name, "id": number} for name, number in class_ids().items())]
    yield f"semantics/{NAME}_semantic_lexicon.json", orjson.dumps({"classes": classes})
    yield "semantics/objects.csv", _table()
    models = models_of(layouts.values())
    for (kind, variant), model in models.items():
        name = _hash(kind, variant)
        yield f"objects/{name[0]}/{name}.glb", model.glb
        yield (
            f"objects/{name[0]}/{name}.object_config.json",
            orjson.dumps(_object_config(name, catalogue()[kind].label)),
        )
    for body in bodies():
        for file, content in articulated_files(body).items():
            yield f"urdf/{body.urdf}/{file}", content
        described = {"urdf_filepath": f"{body.urdf}.urdf", "semantic_id": class_ids()[body.label]}
        yield f"urdf/{body.urdf}/{body.urdf}.ao_config.json", orjson.dumps(described)
    for name, layout in layouts.items():
        yield f"stages/{name}.glb", glb_of_boxes({"floor": floor_boxes(layout), "walls": wall_boxes(layout)})
        yield f"stages/{name}.stage_config.json", orjson.dumps(record("hssd stage", name=name))
        yield f"scenes/{name}.scene_instance.json", orjson.dumps(_scene_instance(name, layout, models))
        regions = {"region_annotations": [region_record(room, layout.ceiling) for room in layout.rooms]}
        yield f"semantics/scenes/{name}.semantic_config.json", orjson.dumps(regions)
        yield f"navmeshes/{name}.navmesh", navmesh_of(layout, NavMeshSettings(include_static_objects=True)).to_bytes()


def _hash(kind: str, variant: int) -> str:
    """Return a model's name: 40 hexadecimal digits, as those of the release."""
    return hashlib.sha1(f"{kind}/{variant}".encode(), usedforsecurity=False).hexdigest()


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
    semantic = {"semantic_id": class_ids()[label]} if int(name[-1], 16) % 2 else {}
    return {**record("hssd object", name=name), **semantic}


def _scene_instance(name: str, layout: Layout, models: Mapping[tuple[str, int], Model]) -> Json:
    rigid = [p for p in layout.furniture if catalogue()[p.kind].urdf is None]
    placed = [_placed(piece, models[piece.kind, piece.variant]) for piece in rigid]
    return record("hssd scene", name=name, rigid=placed, bodies=articulated_records(layout))


def _placed(piece: Furniture, model: Model) -> Json:
    origin = numbers(np.array(piece.center) - piece.yaw.matrix @ model.center)
    return record("hssd piece", model=_hash(piece.kind, piece.variant), origin=origin, rotation=wxyz(piece))
