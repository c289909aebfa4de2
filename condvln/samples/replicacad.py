"""Write layouts as a ReplicaCAD dataset: stages, objects, articulated bodies, scene instances, regions, navmeshes.

The format follows the files of ReplicaCAD (Szot et al. 2021) and habitat-sim's documentation of attributes: object
rotations are [w, x, y, z]; region annotations are in one semantic configuration per scene, found through the search
path of ``semantic_scene_descriptor_instances``; ``navmeshes/`` is for a robot of radius 0.3 m and named by the dataset
configuration, ``navmeshes_default/`` is for Habitat's default agent of 0.1 m.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import numpy as np

from condvln.arrays import F64
from condvln.formats.streams import indented
from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import catalogue, class_ids, record
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.layout import Furniture, Layout, Room
from condvln.samples.models import Model, articulated_files, bodies, glb_of_boxes, models_of
from condvln.samples.solid import floor_boxes, wall_boxes
from schemas.base import Json

__all__ = ["articulated_records", "numbers", "region_record", "replicacad_files", "wxyz"]

DATASET: Final = "made"
"""Name of the dataset and prefix of its models."""

RADII: Final = {"navmeshes": 0.3, "navmeshes_default": 0.1}
"""Agent radius in metres of each navmesh folder."""

LEXICON: Final = "made_semantic_lexicon"


def replicacad_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes), the dataset configuration first.

    Parameters
    ----------
    layouts : scene name to layout; a scene's files depend only on its own layout and name
    """
    yield f"{DATASET}.scene_dataset_config.json", indented(_dataset_config(layouts))
    yield f"configs/ssd/{LEXICON}.json", indented({"classes": [{"name": n, "id": i} for n, i in class_ids().items()]})
    yield f"configs/lighting/{DATASET}.lighting_config.json", indented(record("replicacad lighting"))
    models = models_of(layouts.values())
    for (kind, variant), model in models.items():
        name, number = f"{DATASET}_{kind}_{variant:02d}", class_ids()[catalogue()[kind].label]
        yield f"objects/{name}.glb", model.glb
        config = record("replicacad object", name=name, com=numbers(model.com), number=number)
        yield f"configs/objects/{name}.object_config.json", indented(config)
    for body in bodies():
        for file, content in articulated_files(body).items():
            yield f"urdf/{body.urdf}/{file}", content
        yield f"urdf/{body.urdf}/{body.urdf}.ao_config.json", indented({"user_defined": {}})
    for name, layout in layouts.items():
        yield from _scene_files(name, layout, models)


def _scene_files(name: str, layout: Layout, models: Mapping[tuple[str, int], Model]) -> Iterator[tuple[str, bytes]]:
    stage = f"Stage_{name}"
    shell = glb_of_boxes({"floor": floor_boxes(layout), "walls": wall_boxes(layout)})
    yield f"stages/{stage}.glb", shell
    yield f"configs/stages/{stage}.stage_config.json", indented(record("replicacad stage", stage=stage))
    yield f"configs/scenes/{name}.scene_instance.json", indented(_scene_instance(name, layout, models))
    regions = {"region_annotations": [region_record(room, layout.ceiling) for room in layout.rooms]}
    described = {"semantic_descriptor_filename": f"../ssd/{LEXICON}.json", **regions}
    yield f"configs/semantics/{name}.semantic_config.json", indented(described)
    for folder, radius in RADII.items():
        settings = NavMeshSettings(agent_radius=radius, include_static_objects=True)
        yield f"{folder}/{name}.navmesh", navmesh_of(layout, settings).to_bytes()


def _dataset_config(names: Iterable[str]) -> Json:
    navmeshes = {name: f"navmeshes/{name}.navmesh" for name in names}
    return record("replicacad dataset", dataset=DATASET, lexicon=LEXICON, navmeshes=navmeshes)


def _scene_instance(name: str, layout: Layout, models: Mapping[tuple[str, int], Model]) -> Json:
    rigid = [p for p in layout.furniture if catalogue()[p.kind].urdf is None]
    placed = [_placed(piece, models[piece.kind, piece.variant], number) for number, piece in enumerate(rigid)]
    return record("replicacad scene", name=name, dataset=DATASET, rigid=placed, bodies=articulated_records(layout))


def _placed(piece: Furniture, model: Model, number: int) -> Json:
    """Return the record of a piece of furniture in the scene instance. Records alternate between three ways of
    placement: by centre of mass, by asset origin, and by default.
    """
    center = np.array(piece.center)
    asset_origin = center - piece.yaw.matrix @ model.center
    at_com = number % 3 == 0
    instance: Json = {
        # ReplicaCAD has both forms.
        "template_name": f"objects/{DATASET}_{piece.model}" if number % 5 == 0 else f"{DATASET}_{piece.model}",
        "translation": numbers(asset_origin + piece.yaw.matrix @ model.com if at_com else asset_origin),
        "rotation": wxyz(piece),
        "motion_type": "STATIC",
    }
    if number % 3 < 2:
        instance["translation_origin"] = "COM" if at_com else "asset_local"
    return instance


def articulated_records(layout: Layout) -> list[Json]:
    """Return the records of the articulated pieces of furniture in a scene instance."""
    return [
        record(
            "articulated piece",
            urdf=kind.urdf,
            center=numbers(np.array(piece.center)),
            rotation=wxyz(piece),
            scale=kind.scales[piece.variant],
        )
        for piece in layout.furniture
        if (kind := catalogue()[piece.kind]).urdf is not None
    ]


def wxyz(piece: Furniture) -> list[float]:
    """Return the rotation of a piece of furniture as [w, x, y, z]."""
    x, y, z, w = piece.yaw.quaternion
    return [w, x, y, z]


def region_record(room: Room, ceiling: float) -> Json:
    """Return a room as an entry of ``region_annotations``; `ceiling` is its height in metres."""
    low_x, low_z, high_x, high_z = room.shape.bounds
    return record(
        "region",
        name=room.room_id,
        label=room.label,
        loop=[[x, 0.0, z] for x, z in room.polygon],
        ceiling=ceiling,
        low=[low_x, 0.0, low_z],
        high=[high_x, ceiling, high_z],
    )


def numbers(vector: F64) -> list[float]:
    """Return coordinates without floating-point noise in the last bits; −0 becomes 0."""
    return [float(v) for v in np.round(vector, 6) + 0.0]
