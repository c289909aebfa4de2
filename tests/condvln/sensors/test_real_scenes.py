"""Many scenes, real and made: images against Embree's rays, the navmesh, and what episodes say is seen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from condvln.evaluation.walker import heading_of
from condvln.samples import make_samples
from condvln.scene.meshes import MeshLibrary
from condvln.sensors.camera import camera_pose
from condvln.sources.registry import open_source
from condvln.world import World, open_world
from schemas.config import CameraConfig, InstructionsConfig
from tests.condvln.sensors.made_rooms import F64, rays
from tests.condvln.sensors.ray_caster import RayCaster

CAMERA = CameraConfig(width=160, height=120, hfov=79.0, look_down=10.0)
POSES = 4
MADE = ("replicacad", "procthor", "ithor", "mp3d", "gibson")

pytestmark = pytest.mark.soak


def triangles_of(world: World) -> tuple[F64, NDArray[np.int64]]:
    """Triangles as another reader gives them, and their owners; those that are drawn where boxes stand in."""
    own = world.renderer.surfaces
    if world.geometry is not None and not world.geometry.approximate:
        return world.geometry.vertices[world.geometry.faces], world.geometry.owner
    if not any(item.mesh for item in world.scene.objects):
        return own.corners + own.origin, own.owner.astype(np.int64)
    library = MeshLibrary(world.scene.root)
    meshes = [(k, library.world_mesh(item)) for k, item in enumerate(world.scene.objects)]
    pieces = [(k, mesh.vertices[mesh.faces]) for k, mesh in meshes if mesh is not None]
    return np.concatenate([t for _, t in pieces]), np.repeat([k for k, _ in pieces], [len(t) for _, t in pieces])


def poses(world: World, count: int) -> Iterator[tuple[F64, float]]:
    rng = np.random.default_rng(1)
    world.pathfinder.seed(1)
    for _ in range(count):
        yield world.pathfinder.get_random_navigable_point(), float(rng.uniform(0, 2 * np.pi))


def compare(world: World) -> tuple[int, int, int, int]:
    """Pixels whose depth is within 1 mm, all of them; of the former those whose instance is equal; those with a hit."""
    triangles, owner = triangles_of(world)
    caster = RayCaster(triangles)
    near = equal = hits = 0
    for position, heading in poses(world, POSES):
        eye, rotation = camera_pose(CAMERA, position, heading)
        frame = world.renderer.look(CAMERA, position, heading, rgb=False)
        depth, face = caster.first_front(eye, rays(CAMERA, rotation).reshape(-1, 3))
        same = np.abs(frame.depth.reshape(-1) - depth) < 1e-3
        named = np.where(face >= 0, owner[face], -1) + 1
        near += int(same.sum())
        equal += int((same & (named == frame.instance.reshape(-1))).sum())
        hits += int((depth > 0).sum())
    return near, POSES * CAMERA.width * CAMERA.height, equal, hits


def assert_alike(found: list[tuple[int, int, int, int]]) -> None:
    near, pixels, equal, hits = np.sum(found, axis=0)
    print(f"{len(found)} scenes, {pixels} pixels: depth {near / pixels:.6f}, instance {equal / near:.6f}")
    assert near / pixels >= 0.999
    assert equal / near >= 0.999
    assert hits / pixels > 0.05


def test_images_of_real_apartments(real_data: Path) -> None:
    source = open_source("replicacad", real_data / "replicacad")
    worlds = [open_world(source, name) for name in source.scene_ids()[::4]]
    found = [compare(world) for world in worlds if any(item.mesh for item in world.scene.objects)]
    assert len(found) >= 10
    assert_alike(found)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[World]:
    root = tmp_path_factory.mktemp("many")
    found = []
    for family in MADE:
        make_samples(root / family, family=family, scenes=4, seed=11)
        source = open_source(family, root / family)
        found += [open_world(source, name) for name in source.scene_ids()]
    return found


def test_evidence_that_is_visible_at_once_has_pixels(made: list[World]) -> None:
    """O0: turned through 360° at the start, down to the floor, one sees a true condition's witness and its anchor."""
    level = CameraConfig(width=224, height=224, hfov=90.0)
    down = level.model_copy(update={"look_down": 50.0})
    wanted = InstructionsConfig(per_category={"simple": 10, "chain": 10}, counterfactual_groups=0)
    seen_ways = []
    for world in made:
        if world.scene.navmesh is None:
            continue
        number = {item.object_id: k + 1 for k, item in enumerate(world.scene.objects)}
        for row in world.episodes(instructions=wanted):
            evidence = [e for e in row.evidence or () if e.observability == "O0"]
            true = [row.program.conditions[e.condition] for e in evidence if row.program.conditions[e.condition].truth]
            if not true:
                continue
            seen: set[int] = set()
            for camera in (level, down):
                for turn in range(8):
                    heading = heading_of(row.start_rotation) + turn * math.pi / 4
                    frame = world.renderer.look(camera, row.start_position, heading, rgb=False)
                    seen |= set(np.unique(frame.instance).tolist())
            for condition in true:
                anchors = () if condition.qualifier is None else condition.qualifier.anchor_ids
                ways = [{number[witness], *(number[a] for a in anchors)} for witness in condition.witnesses]
                seen_ways.append(any(way <= seen for way in ways))
    print(f"{len(seen_ways)} conditions, seen {np.mean(seen_ways):.4f}")
    assert len(seen_ways) > 20
    assert np.mean(seen_ways) >= 0.995
