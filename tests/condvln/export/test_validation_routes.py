"""The linter against navmeshes and graphs: can what a file claims be walked?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from condvln.export.validation import Options, validate
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.polygon_tile import tile_of_polygons
from tests.condvln.export.findings import codes, write
from tests.condvln.viewpoint_graphs import graph_of


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({}, None),
        ({"start_position": [1.0, 3.0, 1.0], "reference_path": [[1.0, 3.0, 1.0], [3.0, 0.0, 1.0]]}, "start-off-mesh"),
        ({"goals": [{"position": [3.0, 0.0, 2.5], "radius": 1.0}]}, "goal-off-mesh"),
        ({"goals": [{"position": [11.0, 0.0, 1.0], "radius": 1.0}]}, "unreachable"),
        ({"info": {"geodesic_distance": 2.5}}, "geodesic-differs"),
    ],
)
def test_against_the_navmesh(tmp_path: Path, change: dict[str, Any], code: str | None) -> None:
    vertices = [[0, 0, 0], [4, 0, 0], [4, 0, 2], [0, 0, 2], [10, 0, 0], [12, 0, 0], [12, 0, 2], [10, 0, 2]]
    pathfinder = Pathfinder.from_tile(tile_of_polygons(vertices, [[0, 1, 2, 3], [4, 5, 6, 7]]))
    episode = {
        "episode_id": 1,
        "trajectory_id": 1,
        "scene_id": "made/a/a.glb",
        "start_position": [1.0, 0.0, 1.0],
        "start_rotation": [0.0, 0.0, 0.0, 1.0],
        "info": {"geodesic_distance": 2.0},
        "goals": [{"position": [3.0, 0.0, 1.0], "radius": 1.0}],
        "instruction": {"instruction_text": "Go.", "instruction_tokens": [2, 3]},
        "reference_path": [[1.0, 0.0, 1.0], [3.0, 0.0, 1.0]],
        **change,
    }
    words = ["<pad>", "<unk>", "go", "."]
    path = write(tmp_path / "x.json.gz", {"episodes": [episode], "instruction_vocab": {"word_list": words}})
    found = codes(validate(path, Options(pathfinder_of=lambda episode: pathfinder)))
    assert found == set() if code is None else code in found
    assert not codes(validate(path, Options(pathfinder_of=lambda episode: None))) & {code}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({}, None),
        ({"path": ["0", "9"]}, "unknown-viewpoint"),
        ({"path": ["0", "2"]}, "path-disconnected"),
        ({"path": ["0"]}, "wrong-type"),
        ({"path": ["0", "0", "1"]}, "duplicate-viewpoint"),
        ({"distance": 3.0}, "distance-differs"),
        ({"distance": None}, "distance-differs"),
        ({"heading": 6.4}, "heading-range"),
        ({"heading": -0.1}, "heading-range"),
        ({"instructions": []}, "wrong-type"),
        ({"instructions": [" "]}, "empty-text"),
    ],
)
def test_r2r_items(tmp_path: Path, change: dict[str, Any], code: str | None) -> None:
    graph = graph_of([[0, 0, 0], [2, 0, 0], [4, 0, 0]], [(0, 1), (1, 2)])
    item = {
        "scan": "s",
        "path_id": 1,
        "path": ["0", "1", "2"],
        "heading": 1.0,
        "instructions": ["Go."],
        "distance": 4.0,
    }
    path = tmp_path / "R2R_x.json"
    path.write_text(json.dumps([{**item, **change}]))
    found = codes(validate(path, Options(graphs={"s": graph})))
    assert found == set() if code is None else code in found
    path.write_text(json.dumps([item, item, {"scan": "s"}]))
    assert {"duplicate-id", "missing-key"} <= codes(validate(path))
