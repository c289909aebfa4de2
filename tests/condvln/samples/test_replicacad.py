"""Made ReplicaCAD datasets: the same bytes everywhere, real geometry, and read back as what was made."""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from condvln.labels import vocabulary
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_shipped_navmesh
from condvln.samples import Layout, SampleReport, make_layout, make_layouts, make_samples, write_replicacad
from condvln.samples.catalogue import catalogue
from condvln.samples.stage import FLOOR_THICKNESS, wall_boxes
from condvln.sources.registry import open_source
from schemas.config import AgentConfig
from schemas.errors import UsageError

SCENES = 7


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(SCENES, seed=11)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> SampleReport:
    return make_samples(tmp_path_factory.mktemp("made"), family="replicacad", scenes=SCENES, seed=11)


def _document(report: SampleReport, path: str) -> dict:
    return json.loads((report.folder / path).read_bytes())


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_the_report_counts_what_was_written(report: SampleReport, layouts: dict[str, Layout]) -> None:
    files = [path for path in report.folder.rglob("*") if path.is_file()]
    assert (report.files, report.bytes) == (len(files), sum(path.stat().st_size for path in files))
    assert report.scenes == tuple(f"made_{k:03d}" for k in range(SCENES))
    assert report.rooms == sum(len(layout.rooms) for layout in layouts.values()) == sum(range(2, 9))
    assert report.objects == sum(len(layout.furniture) for layout in layouts.values())


def test_bytes_repeat_in_processes_with_other_hash_seeds(report: SampleReport, tmp_path: Path) -> None:
    code = (
        "import sys, pathlib; from condvln.samples import make_samples;"
        f"make_samples(pathlib.Path(sys.argv[1]), 'replicacad', {SCENES}, 11)"
    )
    for hash_seed in ("1", "4242"):
        folder = tmp_path / hash_seed
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed}
        subprocess.run([sys.executable, "-c", code, str(folder)], check=True, env=environment)
        assert _digests(folder) == _digests(report.folder)


def test_a_scene_is_the_same_however_many_are_made(report: SampleReport, tmp_path: Path) -> None:
    make_samples(tmp_path, family="replicacad", scenes=3, seed=11)
    few, many = _digests(tmp_path), _digests(report.folder)
    differing = {path for path in few if few[path] != many[path]}
    assert differing == {"made.scene_dataset_config.json"}
    make_samples(tmp_path / "other", family="replicacad", scenes=3, seed=12)
    other = _digests(tmp_path / "other")
    name = "configs/scenes/made_000.scene_instance.json"
    assert other[name] != few[name]


def test_writing_again_changes_nothing_and_never_mixes_datasets(report: SampleReport) -> None:
    before = {path: path.stat().st_mtime_ns for path in report.folder.rglob("*")}
    assert make_samples(report.folder, family="replicacad", scenes=SCENES, seed=11) == report
    with pytest.raises(UsageError, match="another dataset"):
        make_samples(report.folder, family="replicacad", scenes=SCENES + 1, seed=11)
    with pytest.raises(UsageError, match="another dataset"):
        make_samples(report.folder, family="replicacad", scenes=SCENES, seed=12)
    assert {path: path.stat().st_mtime_ns for path in report.folder.rglob("*")} == before


def test_unknown_families_and_empty_orders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="replicacad"):
        make_samples(tmp_path, family="lego")
    with pytest.raises(UsageError, match="at least one"):
        make_samples(tmp_path, scenes=0)


def test_models_measure_what_the_layouts_say(report: SampleReport, layouts: dict[str, Layout]) -> None:
    seen = {}
    for layout in layouts.values():
        for piece in layout.furniture:
            seen[piece.model] = piece
    files = sorted((report.folder / "objects").glob("*.glb"))
    rigid = {piece.model for piece in seen.values() if catalogue()[piece.kind].urdf is None}
    assert {path.stem.removeprefix("made_") for path in files} == rigid
    for path in files:
        scene = trimesh.load_scene(path)
        assert scene.extents == pytest.approx(seen[path.stem.removeprefix("made_")].size, abs=1e-6)
        # Neither bare vertices nor the origin give the box away.
        assert all(not np.allclose(scene.graph[node][0], np.eye(4)) for node in scene.graph.nodes_geometry)
        assert np.abs(scene.bounds.mean(axis=0)).max() > 0.005


def test_the_stage_has_floors_walls_and_open_doorways(report: SampleReport, layouts: dict[str, Layout]) -> None:
    for name, layout in layouts.items():
        scene = trimesh.load_scene(report.folder / f"stages/Stage_{name}.glb")
        (x0, z0), (x1, z1) = layout.bounds
        low, high = scene.bounds
        assert low == pytest.approx([x0 - 0.05, -FLOOR_THICKNESS, z0 - 0.05], abs=1e-6)
        assert high == pytest.approx([x1 + 0.05, layout.ceiling, z1 + 0.05], abs=1e-6)
        mesh = scene.to_mesh()
        rays = [(door.center, door.along_x) for door in layout.doors]
        origins = np.array([(x - 0.3 * (not along), 1.0, z - 0.3 * along) for (x, z), along in rays])
        across = np.array([(0.0, 0.0, 1.0) if along else (1.0, 0.0, 0.0) for _, along in rays])
        hits, ray, _ = mesh.ray.intersects_location(origins, across)
        distance = np.full(len(rays), np.inf)
        np.minimum.at(distance, ray, np.linalg.norm(hits - origins[ray], axis=1))
        assert (distance > 0.5).all(), "a doorway is walled up"
        # … and over the opening there is wall again.
        lintel = origins + np.array([0, layout.ceiling - 0.2 - 1.0, 0])
        assert mesh.ray.intersects_any(lintel, across).all()


def test_walls_enclose_each_room() -> None:
    layout = make_layout(5, 6)
    walls = wall_boxes(layout)
    for room in layout.rooms:
        ring = room.shape.exterior
        for share in np.linspace(0, 1, 97):
            x, z = ring.interpolate(share, normalized=True).coords[0]
            on = (walls[:, 0, [0, 2]] <= [x + 1e-9, z + 1e-9]).all(1) & (
                walls[:, 1, [0, 2]] >= [x - 1e-9, z - 1e-9]
            ).all(1)
            assert on.any()
            assert walls[on][:, 1, 1].max() == layout.ceiling


def test_read_back_it_is_the_same_scene(report: SampleReport, layouts: dict[str, Layout]) -> None:
    source = open_source("replicacad", report.folder)
    handles = source.handles()
    assert [handle.scene_id for handle in handles] == list(layouts)
    assert all(handle.fault is None for handle in handles)
    for name, layout in layouts.items():
        scene = with_shipped_navmesh(source.read(name), AgentConfig())
        assert scene.warnings == ()
        assert {room.room_id: room.label for room in scene.rooms} == {room.room_id: room.label for room in layout.rooms}
        for room in scene.rooms:
            assert room.annotation == "dataset"
            np.testing.assert_array_equal(room.polygon, layout.room_of[room.room_id].polygon)
            assert (room.floor_y, room.ceiling_y) == (0.0, layout.ceiling)
        made = sorted(
            (piece.room_id, vocabulary.canonical(piece.label, "replicacad"), *np.round(piece.aabb, 3).ravel())
            for piece in layout.furniture
        )
        read = sorted((item.room_id, item.label, *item.aabb.ravel()) for item in scene.objects)
        assert made == read
        assert scene.navmesh is not None
        assert scene.navmesh.fits
        assert scene.navmesh.path == f"navmeshes_default/{name}.navmesh"


def test_all_ways_of_placing_occur(report: SampleReport) -> None:
    instances = _document(report, "configs/scenes/made_003.scene_instance.json")["object_instances"]
    assert {instance.get("translation_origin") for instance in instances} == {"COM", "asset_local", None}
    coms = [json.loads(path.read_bytes())["COM"] for path in sorted((report.folder / "configs/objects").glob("*.json"))]
    assert any(any(com) for com in coms)
    assert any(not any(com) for com in coms)


def test_the_robots_navmesh_is_the_smaller_one(report: SampleReport, layouts: dict[str, Layout]) -> None:
    for name in layouts:
        small, large = (
            Pathfinder.load(report.folder / folder / f"{name}.navmesh") for folder in ("navmeshes", "navmeshes_default")
        )
        assert small.settings.agent_radius == pytest.approx(0.3)
        assert large.settings.agent_radius == pytest.approx(0.1)
        assert small.navigable_area < large.navigable_area
        assert large.num_islands == 1


def test_any_layouts_can_be_written_under_any_names(tmp_path: Path) -> None:
    layout = make_layout(99, 4)
    written = write_replicacad(tmp_path, {"home": layout})
    assert written.scenes == ("home",)
    scene = open_source("replicacad", tmp_path).read("home")
    assert len(scene.objects) == len(layout.furniture)


def test_glb_bytes_are_plain_gltf(report: SampleReport) -> None:
    data = (report.folder / "stages/Stage_made_000.glb").read_bytes()
    assert data[:4] == b"glTF"
    assert trimesh.load_scene(io.BytesIO(data), file_type="glb").geometry.keys() == {"floor", "walls"}
