"""Write layouts as a ReplicaCAD dataset: stages, objects, articulated bodies, scene instances, regions, navmeshes.

The format follows the files of ReplicaCAD (Szot et al. 2021) and habitat-sim's documentation of attributes: object
rotations are [w, x, y, z]; region annotations are in one semantic configuration per scene, found through the search
path of ``semantic_scene_descriptor_instances``; ``navmeshes/`` is for a robot of radius 0.3 m and named by the dataset
configuration, ``navmeshes_default/`` is for Habitat's default agent of 0.1 m.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import orjson
from numpy.typing import NDArray

from condvln.navigation.settings import NavMeshSettings
from condvln.samples.catalogue import catalogue
from condvln.samples.floor_mesh import NavmeshEngine, navmesh_of
from condvln.samples.glb import glb_of_boxes
from condvln.samples.layout import Furniture, Layout, Room
from condvln.samples.models import Model, articulated_files, model_of
from condvln.samples.stage import floor_boxes, wall_boxes

__all__ = ["articulated_record", "numbers", "region_record", "replicacad_files", "wxyz"]

DATASET: Final = "made"
"""Name of the dataset and prefix of its models."""

RADII: Final = {"navmeshes": 0.3, "navmeshes_default": 0.1}
"""Agent radius in metres of each navmesh folder."""

LEXICON: Final = "made_semantic_lexicon"

F64 = NDArray[np.float64]
Json = dict[str, Any]


def replicacad_files(layouts: Mapping[str, Layout], navmesh: NavmeshEngine = "polygons") -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes), the dataset configuration first.

    Parameters
    ----------
    layouts : scene name to layout; a scene's files depend only on its own layout and name
    navmesh : how the navmeshes are made, see ``navmesh_of``
    """
    yield f"{DATASET}.scene_dataset_config.json", _json(_dataset_config(list(layouts)))
    yield f"configs/ssd/{LEXICON}.json", _json({"classes": [{"name": n, "id": i} for n, i in _class_ids().items()]})
    yield f"configs/lighting/{DATASET}.lighting_config.json", _json(_lighting())
    models: dict[str, Model] = {}
    for kind, variant in sorted({(p.kind, p.variant) for layout in layouts.values() for p in layout.furniture}):
        row = catalogue()[kind]
        if row.urdf is None:
            model = models[f"{kind}_{variant:02d}"] = model_of(row, variant)
            name = f"{DATASET}_{kind}_{variant:02d}"
            yield f"objects/{name}.glb", model.glb
            yield f"configs/objects/{name}.object_config.json", _json(_object_config(name, row.label, model))
    for row in catalogue().values():
        if row.urdf is not None:
            for file, content in articulated_files(row).items():
                yield f"urdf/{row.urdf}/{file}", content
            yield f"urdf/{row.urdf}/{row.urdf}.ao_config.json", _json({"user_defined": {}})
    for name, layout in layouts.items():
        yield from _scene_files(name, layout, models, navmesh)


def _scene_files(
    name: str, layout: Layout, models: Mapping[str, Model], navmesh: NavmeshEngine
) -> Iterator[tuple[str, bytes]]:
    stage = f"Stage_{name}"
    shell = glb_of_boxes({"floor": floor_boxes(layout), "walls": wall_boxes(layout)})
    yield f"stages/{stage}.glb", shell
    yield f"configs/stages/{stage}.stage_config.json", _json(_stage_config(stage))
    yield f"configs/scenes/{name}.scene_instance.json", _json(_scene_instance(name, layout, models))
    regions = {"region_annotations": [region_record(room, layout.ceiling) for room in layout.rooms]}
    described = {"semantic_descriptor_filename": f"../ssd/{LEXICON}.json", **regions}
    yield f"configs/semantics/{name}.semantic_config.json", _json(described)
    for folder, radius in RADII.items():
        settings = NavMeshSettings(agent_radius=radius, include_static_objects=True)
        yield f"{folder}/{name}.navmesh", navmesh_of(layout, settings, navmesh).to_bytes()


def _json(document: Json) -> bytes:
    return orjson.dumps(document, option=orjson.OPT_INDENT_2) + b"\n"


def _class_ids() -> dict[str, int]:
    """Return semantic ids by class name, the same for every dataset of this kind."""
    return {name: number for number, name in enumerate(sorted({k.label for k in catalogue().values()}), start=1)}


def _dataset_config(names: list[str]) -> Json:
    return {
        "stages": {"paths": {".json": ["configs/stages"]}},
        "objects": {"paths": {".json": ["configs/objects"]}},
        "articulated_objects": {"paths": {".urdf": ["urdf/*/"]}},
        "light_setups": {"paths": {".json": ["configs/lighting"]}},
        "scene_instances": {
            "default_attributes": {"semantic_scene_instance": f"{DATASET}_ssd_map"},
            "paths": {".json": ["configs/scenes"]},
        },
        "navmesh_instances": {name: f"navmeshes/{name}.navmesh" for name in names},
        "semantic_scene_descriptor_instances": {
            "paths": {".json": ["configs/semantics"]},
            f"{DATASET}_ssd_map": f"configs/ssd/{LEXICON}.json",
        },
    }


def _lighting() -> Json:
    return {"lights": {"0": {"type": "point", "position": [0.0, 2.3, 0.0], "intensity": 1.2, "color": [1.0, 1.0, 1.0]}}}


def _object_config(name: str, label: str, model: Model) -> Json:
    return {
        "render_asset": f"../../objects/{name}.glb",
        "collision_asset": f"../../objects/{name}.glb",
        "mass": 10.0,
        "COM": numbers(model.com),
        "join_collision_meshes": False,
        "semantic_id": _class_ids()[label],
    }


def _stage_config(stage: str) -> Json:
    return {
        "render_asset": f"../../stages/{stage}.glb",
        "up": [0, 1, 0],
        "front": [0, 0, -1],
        "requires_lighting": True,
        "margin": 0.01,
        "friction_coefficient": 0.8,
        "restitution_coefficient": 0.0,
    }


def _scene_instance(name: str, layout: Layout, models: Mapping[str, Model]) -> Json:
    rigid = [p for p in layout.furniture if catalogue()[p.kind].urdf is None]
    bodies = [p for p in layout.furniture if catalogue()[p.kind].urdf is not None]
    return {
        "translation_origin": "asset_local",
        "stage_instance": {
            "template_name": f"Stage_{name}",
            "translation": [0.0, 0.0, 0.0],
            "rotation": [1.0, 0.0, 0.0, 0.0],
            "translation_origin": "COM",
        },
        "default_lighting": f"lighting/{DATASET}",
        "navmesh_instance": name,
        "semantic_scene_instance": name,
        "object_instances": [_placed(piece, models[piece.model], number) for number, piece in enumerate(rigid)],
        "articulated_object_instances": [articulated_record(piece) for piece in bodies],
    }


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


def articulated_record(piece: Furniture) -> Json:
    """Return the record of an articulated piece of furniture in a scene instance."""
    kind = catalogue()[piece.kind]
    return {
        "template_name": kind.urdf,
        "fixed_base": True,
        "auto_clamp_joint_limits": True,
        "translation_origin": "COM",
        "motion_type": "DYNAMIC",
        "translation": numbers(np.array(piece.center)),
        "rotation": wxyz(piece),
        "uniform_scale": kind.scales[piece.variant],
    }


def wxyz(piece: Furniture) -> list[float]:
    """Return the rotation of a piece of furniture as [w, x, y, z]."""
    x, y, z, w = piece.yaw.quaternion
    return [w, x, y, z]


def region_record(room: Room, ceiling: float) -> Json:
    """Return a room as an entry of ``region_annotations``; `ceiling` is its height in metres."""
    low_x, low_z, high_x, high_z = room.shape.bounds
    return {
        "name": room.room_id,
        "label": room.label,
        "poly_loop": [[x, 0.0, z] for x, z in room.polygon],
        "floor_height": 0.0,
        "extrusion_height": ceiling,
        "min_bounds": [low_x, 0.0, low_z],
        "max_bounds": [high_x, ceiling, high_z],
    }


def numbers(vector: F64) -> list[float]:
    """Return coordinates without floating-point noise in the last bits; −0 becomes 0."""
    return [float(v) for v in np.round(vector, 6) + 0.0]
