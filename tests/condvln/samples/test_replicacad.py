"""Made ReplicaCAD datasets: the same bytes everywhere, real geometry, and read back as what was made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from condvln.navigation.pathfinder import Pathfinder
from condvln.samples import Layout, SampleReport, make_layouts, make_samples
from condvln.samples.solid import FLOOR_THICKNESS
from schemas.errors import UsageError

SCENES = 7


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(SCENES, seed=11)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> SampleReport:
    return make_samples(tmp_path_factory.mktemp("made"), family="replicacad", scenes=SCENES, seed=11)


def test_the_report_counts_what_was_written(report: SampleReport, layouts: dict[str, Layout]) -> None:
    files = [path for path in report.folder.rglob("*") if path.is_file()]
    assert (report.files, report.bytes) == (len(files), sum(path.stat().st_size for path in files))
    assert report.scenes == tuple(f"made_{k:03d}" for k in range(SCENES))
    assert report.rooms == sum(len(layout.rooms) for layout in layouts.values()) == sum(range(2, 9))
    assert report.objects == sum(len(layout.furniture) for layout in layouts.values())


def test_writing_again_changes_nothing_and_never_mixes_datasets(tmp_path: Path) -> None:
    report = make_samples(tmp_path, scenes=1, seed=11)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert make_samples(tmp_path, family="replicacad", scenes=1, seed=11) == report
    for other in ({"scenes": 2, "seed": 11}, {"scenes": 1, "seed": 12}):
        with pytest.raises(UsageError, match="another dataset"):
            make_samples(tmp_path, family="replicacad", **other)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_unknown_families_and_empty_orders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="replicacad"):
        make_samples(tmp_path, family="lego")
    with pytest.raises(UsageError, match="at least one"):
        make_samples(tmp_path, scenes=0)


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


def test_the_robots_navmesh_is_the_smaller_one(report: SampleReport, layouts: dict[str, Layout]) -> None:
    for name in layouts:
        small, large = (
            Pathfinder.load(report.folder / folder / f"{name}.navmesh") for folder in ("navmeshes", "navmeshes_default")
        )
        assert small.settings.agent_radius == pytest.approx(0.3)
        assert large.settings.agent_radius == pytest.approx(0.1)
        assert small.navigable_area < large.navigable_area
        assert large.num_islands == 1
