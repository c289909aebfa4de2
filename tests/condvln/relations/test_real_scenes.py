"""ReplicaCAD's apartments on their real meshes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from condvln.relations import RoomRelations, relate_scene, relation_table, text_facts
from condvln.scene import Scene
from condvln.scene.meshes import MeshLibrary
from condvln.sources.registry import open_source
from schemas.config import Thresholds

T = Thresholds()

SAMPLE = ("v3_sc0_staging_00", "v3_sc1_staging_03", "apt_0")

ROUNDING = 0.0025
"""Metres: box faces and surface distances are rounded to 1 mm, at worst along a diagonal."""


def scenes(real_data: Path, names: tuple[str, ...]) -> Iterator[tuple[Scene, MeshLibrary]]:
    root = real_data / "replicacad"
    source = open_source("replicacad", root, scenes=names)
    meshes = MeshLibrary(root)
    for handle in source.handles():
        yield source.read(handle.scene_id), meshes


def check_scene(scene: Scene, meshes: MeshLibrary) -> RoomRelations:
    relations = relate_scene(scene, T, meshes=meshes.world_mesh)
    table = relation_table(scene, relations, T)
    for room_id, room in relations.items():
        aabb, surface = room.metrics.aabb, room.surface
        asked = ~np.isnan(surface) & ~np.eye(len(room), dtype=bool)
        np.testing.assert_array_equal(asked, (aabb <= T.surface_within) & ~np.eye(len(room), dtype=bool))
        assert (aabb[asked] <= surface[asked] + ROUNDING).all()
        again = RoomRelations.from_table(table, scene.arrays(room_id), T)
        np.testing.assert_array_equal(again.surface, surface)
        for predicate, status in text_facts(again, T).status.items():
            np.testing.assert_array_equal(status, text_facts(room, T).status[predicate])
    return next(iter(relations.values()))


@pytest.mark.parametrize("name", SAMPLE)
def test_boxes_are_never_further_apart_than_surfaces(real_data: Path, name: str) -> None:
    for scene, meshes in scenes(real_data, (name,)):
        check_scene(scene, meshes)


@pytest.mark.soak
def test_scenes_of_every_layout(real_data: Path) -> None:
    count = 0
    for scene, meshes in scenes(real_data, ("v3_sc?_staging_?5", "apt_?")):
        if scene.objects:
            check_scene(scene, meshes)
            count += 1
    assert count == 7


def test_surfaces_matter(real_data: Path) -> None:
    """Of the pairs whose boxes are near (≤ 0.85 m), some 3 % are not near by their surfaces."""
    ((scene, meshes),) = scenes(real_data, ("apt_0",))
    room = check_scene(scene, meshes)
    close = np.triu(room.metrics.aabb <= 0.85, k=1)
    assert 0.02 <= (room.surface[close] > 0.85).mean() <= 0.05


def test_surfaces_against_points_sampled_on_them(real_data: Path) -> None:
    """The nearest of many points on two surfaces is never nearer than FCL's distance, and not much further."""
    ((scene, meshes),) = scenes(real_data, ("v3_sc1_staging_03",))
    room = check_scene(scene, meshes)
    asked = np.argwhere(np.triu(room.surface > 0, k=1))
    assert len(asked) >= 20
    trees: dict[int, cKDTree] = {}
    for k in np.unique(asked):
        mesh = meshes.world_mesh(room.objects.objects[k])
        if mesh is not None:
            shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            sampled = trimesh.sample.sample_surface(shape, 20_000, seed=1)[0]
            trees[k] = cKDTree(np.concatenate([mesh.vertices, sampled]))
    compared = 0
    for i, j in asked:
        if i in trees and j in trees:
            nearest = trees[i].query(trees[j].data, distance_upper_bound=room.surface[i, j] + 0.05)[0].min()
            assert -0.0006 <= nearest - room.surface[i, j] <= 0.04, room.objects.object_ids[i]
            compared += 1
    assert compared >= 20


def test_edges_of_a_real_kitchen_read_true(real_data: Path) -> None:
    """What one sees in the render of this apartment, as the table says it."""
    ((scene, meshes),) = scenes(real_data, ("v3_sc1_staging_03",))
    rows = relation_table(scene, relate_scene(scene, T, meshes=meshes.world_mesh), T).to_pylist()
    said = {(r["subject"].split(":")[0], r["predicate"], r["target"].split(":")[0]) for r in rows if r["true_in_text"]}
    assert ("kitchenCupboard_01", "above", "kitchen_counter") in said
    assert ("fridge", "near", "kitchen_counter") in said
    assert ("fridge", "north of", "kitchen_counter") in said
    assert ("cabinet", "north of", "frl_apartment_tvstand") in said
    assert ("frl_apartment_rug_01", "lower than", "fridge") not in said, "heights are said of things off the floor"
    assert ("frl_apartment_sofa", "far from", "frl_apartment_tvstand") in said
