"""A small scene dataset in Habitat's form, written anew for each test, with numbers that can be checked by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.navigation.navmesh_file import NavMeshFile, write_navmesh
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from tests.condvln.glb_boxes import box_glb

SCENE = "flat"
FLOOR = [[0, 0, 0], [6, 0, 0], [6, 0, 4], [0, 0, 4]]


class MadeDataset:
    """The dataset's folder, and hands to change it with.

    The scene ``flat``: a table at (1, 0.4, 1), size (1, 0.8, 0.6); two chairs at (3, 0.5, 1) and, turned by 90°, at
    (3, 0.5, 3), size (0.5, 1, 0.4); a fridge of a body and a door at (5, 0.9, 2).
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.config: dict[str, Any] = {
            "stages": {"paths": {".json": ["configs/stages"]}},
            "objects": {"paths": {".json": ["configs/objects"]}},
            "articulated_objects": {"paths": {".urdf": ["urdf/*/", "../robots/fetch.urdf"]}},
            "scene_instances": {
                "default_attributes": {"semantic_scene_instance": "map"},
                "paths": {".json": ["configs/scenes"]},
            },
            "navmesh_instances": {SCENE: f"navmeshes/{SCENE}.navmesh", "withheld": "navmeshes/withheld.navmesh"},
            "semantic_scene_descriptor_instances": {"map": "configs/ssd/lexicon.json"},
        }
        self.write_config()
        self.lexicon([("table", 1), ("chair", 2), ("refrigerator", 3)])
        self.object("table_01", size=[1, 0.8, 0.6], semantic_id=1, COM=[0, 0, 0])
        self.object("chair_01", size=[0.5, 1, 0.4], semantic_id=2, COM=[0, 0, 0])
        self.json("configs/stages/stage.stage_config.json", {"render_asset": "../../stages/stage.glb"})
        self.write("stages/stage.glb", box_glb([6, 0.1, 4], [3, -0.05, 2]))
        self.fridge()
        self.scene: dict[str, Any] = {
            "stage_instance": {"template_name": "stages/stage"},
            "object_instances": [
                {"template_name": "objects/table_01", "translation": [1, 0.4, 1], "motion_type": "STATIC"},
                {"template_name": "chair_01", "translation": [3, 0.5, 1], "motion_type": "DYNAMIC"},
                {
                    "template_name": "chair_01",
                    "translation": [3, 0.5, 3],
                    "rotation": [np.sqrt(0.5), 0, np.sqrt(0.5), 0],
                    "motion_type": "STATIC",
                },
            ],
            "articulated_object_instances": [
                {"template_name": "fridge", "translation": [5, 0.9, 2], "fixed_base": True, "uniform_scale": 0.5}
            ],
            "navmesh_instance": SCENE,
        }
        self.write_scene()
        self.navmesh(f"navmeshes/{SCENE}.navmesh", 0.3)
        self.navmesh(f"navmeshes_default/{SCENE}.navmesh", 0.1)

    def write(self, path: str, data: bytes) -> Path:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        return file

    def json(self, path: str, document: Any) -> Path:
        return self.write(path, json.dumps(document).encode())

    def write_config(self) -> None:
        self.json("made.scene_dataset_config.json", self.config)

    def write_scene(self, name: str = SCENE) -> None:
        self.json(f"configs/scenes/{name}.scene_instance.json", self.scene)

    def lexicon(self, classes: list[tuple[str, int]], **more: Any) -> None:
        named = [{"name": name, "id": number} for name, number in classes]
        self.json("configs/ssd/lexicon.json", {"classes": named, **more})

    def object(self, name: str, size: list[float], centre: list[float] | None = None, **more: Any) -> None:
        self.json(f"configs/objects/{name}.object_config.json", {"render_asset": f"../../objects/{name}.glb", **more})
        self.write(f"objects/{name}.glb", box_glb(size, centre))

    def fridge(self) -> None:
        """A z-up body of 0.8 × 0.6 × 1.6 and a door before it; a quarter turn about x sets it upright."""
        self.write("urdf/fridge/body.glb", box_glb([0.8, 0.6, 1.6]))
        self.write("urdf/fridge/door.glb", box_glb([0.1, 0.6, 0.8], [0.05, 0, 0]))
        self.write(
            "urdf/fridge/fridge.urdf",
            b"""<robot name="fridge"><link name="root"/>
            <joint name="up" type="fixed"><origin rpy="1.5707963267948966 0 0" xyz="0 0 0"/>
              <parent link="root"/><child link="body"/></joint>
            <link name="body"><visual><geometry><mesh filename="body.glb" scale="1, 1, 1"/></geometry></visual></link>
            <joint name="hinge" type="revolute"><origin xyz="0.4 0 0.4"/>
              <parent link="body"/><child link="door"/></joint>
            <link name="door"><visual><geometry><mesh filename="door.glb"/></geometry></visual></link></robot>""",
        )

    def navmesh(self, path: str, radius: float) -> None:
        settings = NavMeshSettings(agent_radius=radius)
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        write_navmesh(file, NavMeshFile.of_tile(tile_of_polygons(FLOOR, [[0, 1, 2, 3]], settings), settings))

    def source(self, **options: Any) -> Source:
        return open_source("replicacad", self.root, **options)


@pytest.fixture
def made(tmp_path: Path) -> MadeDataset:
    return MadeDataset(tmp_path / "made")
