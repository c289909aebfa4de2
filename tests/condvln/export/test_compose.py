"""Composed scenes: read back, they are what their parts were, and they are walked as their parts are."""

from __future__ import annotations

import io
import json
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from condvln.export.compose import ComposedScene, GlbWriter, compose_scene
from condvln.formats.glb import glb_chunks, read_glb
from condvln.formats.glb_part import GlbPart, read_part
from condvln.formats.gltf_tree import packed_glb
from condvln.formats.triangles import Z_UP, glb_triangles
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import with_built_navmesh, with_shipped_navmesh
from condvln.samples.maker import make_layouts, make_samples
from condvln.scene import Scene
from condvln.scene.scene import SceneGeometry
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from schemas.config import AgentConfig
from schemas.errors import FormatError
from tests.broken_bytes import broken
from tests.condvln.voxelised import voxelise

F64 = NDArray[np.float64]
Tree = dict[str, Any]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("composed")
    for family in ("replicacad", "procthor", "ithor", "robothor", "mp3d"):
        make_samples(root / family, family, 2, 4)
    voxelise(root / "replicacad", make_layouts(2, 4))
    return root


def composed(source: Source) -> tuple[Scene, SceneGeometry, ComposedScene]:
    scene = source.read(source.handles()[0].scene_id)
    geometry = source.geometry(scene)
    assert geometry is not None
    return scene, geometry, compose_scene(scene, geometry, AgentConfig())


def signed(vertices: F64, faces: NDArray[np.integer]) -> F64:
    """(m, 6) middle of each triangle and its area along its normal, in an order of their own."""
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    rows = np.round(np.column_stack([(a + b + c) / 3, np.cross(b - a, c - a) / 2]), 4) + 0.0
    return rows[np.lexsort(rows.T)]


def with_triangles(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """As Habitat would take them, a bare GLB being z-up to it."""
    return glb_triangles(data, "composed.glb", Z_UP)


@pytest.mark.parametrize("family", ["replicacad", "procthor", "ithor", "robothor", "mp3d"])
def test_what_is_read_back_is_what_stands_there(made: Path, family: str) -> None:
    scene, geometry, whole = composed(open_source(family, made / family))
    vertices, faces = with_triangles(whole.glb)
    assert whole.triangles == len(faces) == len(geometry.faces)
    np.testing.assert_allclose(
        signed(vertices, faces).sum(axis=0), signed(geometry.vertices, geometry.faces).sum(axis=0), atol=0.05
    )
    for bound in (np.min, np.max):
        used = geometry.vertices[np.unique(geometry.faces)]
        np.testing.assert_allclose(bound(vertices, axis=0), bound(used, axis=0), atol=2e-6)
    assert whole.approximate == geometry.approximate
    again = composed(open_source(family, made / family))[2]
    assert again.glb == whole.glb
    assert again.navmesh.to_bytes() == whole.navmesh.to_bytes()
    # Our safe reader of strangers' files takes it, and so does another implementation.
    assert len(read_glb(whole.glb, "composed.glb").faces) <= len(faces)
    loaded = trimesh.load_scene(io.BytesIO(whole.glb), file_type="glb")
    assert sum(len(loaded.geometry[loaded.graph[n][1]].faces) for n in loaded.graph.nodes_geometry) == len(faces)
    named = {node.get("name") for node in glb_chunks(whole.glb, "x")[0].value["nodes"]}
    assert {"scene", "stage", *whole.bodies} <= named
    assert {*whole.bodies} <= {o.object_id for o in scene.objects}
    assert not whole.left_out


def test_the_file_is_z_up(made: Path) -> None:
    """(x, y, z) of Habitat stands at (x, −z, y), where loaders of bare GLB files look for it."""
    _, geometry, whole = composed(open_source("replicacad", made / "replicacad"))
    own, known = read_glb(whole.glb, "composed.glb").vertices, geometry.vertices
    for bound in (np.min, np.max):
        expected = bound(np.column_stack([known[:, 0], -known[:, 2], known[:, 1]]), axis=0)
        np.testing.assert_allclose(bound(own, axis=0), expected, atol=1e-5)


def test_each_file_is_taken_in_once_and_transforms_are_kept(made: Path) -> None:
    scene, _, whole = composed(open_source("replicacad", made / "replicacad"))
    tree = glb_chunks(whole.glb, "x")[0].value
    files = {part.path for part in scene.stage} | {part.path for item in scene.objects for part in item.mesh}
    instances = [part for item in scene.objects for part in item.mesh]
    assert len(files) < len(instances) + 1
    own = sum(len(read_part((scene.root / path).read_bytes(), path).meshes) for path in files)
    assert len(tree["meshes"]) == own
    for item in scene.objects:
        (body,) = (n for n in tree["nodes"] if n.get("name") == item.object_id)
        stands = [np.array(tree["nodes"][c]["matrix"]).reshape(4, 4).T for c in body["children"]]
        for stand, part in zip(stands, item.mesh, strict=True):
            np.testing.assert_array_equal(stand, part.transform)


def test_the_navmesh_leads_as_the_shipped_one_does(made: Path) -> None:
    """The shipped ones are built of the same apartments as one body; walls on voxels' edges fall to either side."""
    source = open_source("replicacad", made / "replicacad")
    for handle in source.handles():
        scene = with_shipped_navmesh(source.read(handle.scene_id), AgentConfig())
        whole = compose_scene(scene, source.geometry(scene), AgentConfig())
        assert scene.navmesh.fits
        shipped, ours = Pathfinder.load(scene.root / scene.navmesh.path), Pathfinder(whole.navmesh)
        assert ours.settings == shipped.settings
        assert ours.navigable_area == pytest.approx(shipped.navigable_area, rel=0.03)
        main = max(range(shipped.num_islands), key=shipped.island_area)
        ends = shipped.get_random_navigable_points(200, np.random.default_rng(1), main).reshape(2, 100, 3)
        known, found = shipped.geodesic_distances(*ends), ours.geodesic_distances(*ends)
        assert np.isfinite(found).all()
        # A voxel is 0.05 m, and Detour's paths depend on how the floor is cut into polygons: a few lead another way.
        assert np.median(np.abs(found - known)) < 0.05
        assert (np.abs(found - known) < 0.15).mean() >= 0.9
        assert found.sum() == pytest.approx(known.sum(), rel=0.02)


def test_real_furniture_stands_where_the_shipped_navmesh_goes_around_it(real_data: Path, tmp_path: Path) -> None:
    """A slab stands in for the stage, whose mesh is not at hand; so only walls are missing from what is composed."""
    root = Path(shutil.copytree(real_data / "replicacad", tmp_path / "replicacad"))
    slab = trimesh.creation.box([30, 0.1, 30], trimesh.transformations.translation_matrix([0, -0.05, 0]))
    for base in (0, 1):
        file = root / f"stages/Stage_v3_sc{base}_staging.glb"
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(slab.export(file_type="glb"))
    source = open_source("replicacad", root, scenes=("v3_sc[01]_staging_00",))
    for handle in source.handles():
        scene = with_shipped_navmesh(source.read(handle.scene_id), AgentConfig())
        whole = compose_scene(scene, source.geometry(scene), AgentConfig())
        shipped, ours = Pathfinder.load(root / scene.navmesh.path), Pathfinder(whole.navmesh)
        main = max(range(shipped.num_islands), key=shipped.island_area)
        points = shipped.get_random_navigable_points(2000, np.random.default_rng(0), main)
        points = points[points[:, 1] < 0.3]
        assert ours.are_navigable(points).mean() >= 0.99
        known, found = (nav.geodesic_distances(points[:300], points[300:600]) for nav in (shipped, ours))
        assert np.median(found / known) == pytest.approx(1, abs=0.005)
        for item in scene.objects:
            if item.mesh and item.box is not None and item.box[0, 1] < 0.1 and (item.box[1] - item.box[0]).min() > 0.5:
                assert not ours.is_navigable([item.center[0], 0.1, item.center[2]], 0.2), item.object_id


@pytest.mark.parametrize(
    ("root", "family", "scenes"),
    [
        ("made", "procthor", ("*",)),
        ("made", "ithor", ("*",)),
        ("real_data", "procthor", ("houses60-0", "houses60-16", "houses60-33", "houses60-49")),
        ("real_data", "ithor", ("*",)),
    ],
)
def test_drawn_scenes_have_the_navmesh_of_their_episodes(
    request: pytest.FixtureRequest, root: str, family: str, scenes: tuple[str, ...]
) -> None:
    """Byte for byte that which was built for the scene, so that distances hold in the simulator."""
    source = open_source(family, request.getfixturevalue(root) / family, scenes=scenes)
    for handle in source.handles():
        scene = with_shipped_navmesh(source.read(handle.scene_id), AgentConfig())
        geometry = source.geometry(scene)
        assert geometry is not None
        whole = compose_scene(scene, geometry, AgentConfig())
        assert with_built_navmesh(scene, geometry, AgentConfig())[1] == whole.navmesh.to_bytes()


# --- looks


def textured(colours: tuple[int, int, int] = (200, 10, 30)) -> bytes:
    """A box with a picture on it."""
    box = trimesh.creation.box([1, 1, 1])
    picture = Image.new("RGB", (4, 4), colours)
    uv = np.linspace(0, 1, 2 * len(box.vertices)).reshape(-1, 2)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture, metallicFactor=0.25, roughnessFactor=0.5)
    box.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return bytes(box.export(file_type="glb"))


def rewritten(data: bytes, change: Any) -> bytes:
    """A GLB file with its JSON changed."""
    root, binary = glb_chunks(data, "x")
    tree = json.loads(json.dumps(root.value))
    change(tree)
    return packed_glb(json.dumps(tree).encode(), binary)


def joined(*files: bytes) -> bytes:
    writer = GlbWriter(np.eye(4))
    for number, data in enumerate(files):
        writer.place(f"body_{number}", [(writer.add(read_part(data, "part.glb")), np.eye(4))])
    return writer.to_bytes()


def test_materials_and_textures_come_along() -> None:
    def mark(tree: Tree) -> None:
        shine = tree["materials"][0]["pbrMetallicRoughness"]
        shine["baseColorTexture"]["extensions"] = {"KHR_texture_transform": {"scale": [2, 3], "offset": [0.5, 0]}}
        tree["extensionsUsed"] = tree["extensionsRequired"] = ["KHR_texture_transform"]
        tree["materials"][0] |= {"alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True, "name": "left behind"}

    parts = [textured(), textured((5, 250, 5)), rewritten(textured(), mark)]
    data = joined(*parts)
    tree = glb_chunks(data, "x")[0].value
    assert tree["extensionsRequired"] == ["KHR_texture_transform"]
    third = tree["materials"][2]
    assert (third["alphaMode"], third["alphaCutoff"], third["doubleSided"]) == ("MASK", 0.25, True)
    slot = third["pbrMetallicRoughness"]["baseColorTexture"]
    assert slot["extensions"] == {"KHR_texture_transform": {"offset": [0.5, 0.0], "scale": [2.0, 3.0]}}
    assert slot["index"] == 2
    loaded = trimesh.load_scene(io.BytesIO(data), file_type="glb")
    pictures = []
    for node in sorted(loaded.graph.nodes_geometry):
        mesh = loaded.geometry[loaded.graph[node][1]]
        alone = trimesh.load_scene(io.BytesIO(parts[0]), file_type="glb").to_geometry()
        np.testing.assert_allclose(mesh.visual.uv, alone.visual.uv, atol=1e-6)
        assert mesh.visual.material.metallicFactor == 0.25
        pictures.append(mesh.visual.material.baseColorTexture.convert("RGB").getpixel((1, 1)))
    assert sorted(pictures) == sorted([(200, 10, 30), (5, 250, 5), (200, 10, 30)])


def test_a_texture_that_is_elsewhere_is_counted_and_left() -> None:
    def outside(tree: Tree) -> None:
        tree["images"][0] = {"uri": "../../../etc/passwd"}

    part = read_part(rewritten(textured(), outside), "part.glb")
    assert (part.look.lost, part.look.images, part.look.textures) == (1, [], [])
    assert "baseColorTexture" not in part.look.materials[0]["pbrMetallicRoughness"]
    data = joined(rewritten(textured(), outside))
    assert b"passwd" not in data


def changed(path: str, value: Any) -> Any:
    *way, last = path.split("/")

    def change(tree: Any) -> None:
        for step in way:
            tree = tree[int(step) if step.isdigit() else step]
        tree[int(last) if last.isdigit() else last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("meshes/0/primitives/0/material", 7), "the index 7 is out of range"),
        (changed("materials/0/pbrMetallicRoughness/baseColorTexture/index", -1), "the index -1 is out of range"),
        (changed("materials/0/pbrMetallicRoughness/baseColorTexture/texCoord", 10**9), "1000000000 is none of 0, 1"),
        (changed("materials/0/pbrMetallicRoughness/metallicFactor", "x"), "a number is expected"),
        (changed("textures/0/source", 3), "the index 3 is out of range"),
        (changed("images/0/mimeType", "text/html"), "is not a supported image type"),
        (changed("images/0/bufferView", 99), "the index 99 is out of range"),
        (changed("materials/0/alphaMode", "ODD"), "is not an alpha mode"),
        (changed("materials", {}), "an array is expected"),
        (changed("meshes/0/primitives/0/attributes/NORMAL", 0), "is not allowed for NORMAL"),
        (changed("extensionsRequired", ["EXT_meshopt_compression"]), "can't be read"),
    ],
)
def test_a_part_that_is_not_sound_is_refused(change: Any, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_part(rewritten(textured(), change), "part.glb")
    assert caught.value.where == "part.glb"


def test_more_entries_than_vertices_and_faces_beyond_them_are_refused() -> None:
    def longer(tree: Tree) -> None:
        view = len(tree["bufferViews"])
        tree["bufferViews"].append({"buffer": 0, "byteOffset": 0, "byteLength": 16})
        tree["accessors"].append({"bufferView": view, "componentType": 5126, "count": 2, "type": "VEC2"})
        tree["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = len(tree["accessors"]) - 1

    with pytest.raises(FormatError, match="the attribute has 2 entries"):
        read_part(rewritten(textured(), longer), "part.glb")

    def fewer(tree: Tree) -> None:
        tree["meshes"][0]["primitives"][0]["attributes"] = {
            "POSITION": tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
        }
        tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"] = 3

    with pytest.raises(FormatError, match="a face refers to vertex"):
        read_part(rewritten(textured(), fewer), "part.glb")


@pytest.mark.rounds(15)
@given(data=st.data())
def test_broken_parts_give_a_sound_file_or_our_error(data: st.DataObject) -> None:
    root, binary = glb_chunks(textured(), "x")
    tokens = [b"-1", b"9e9", b"null", b"{}", b"[]", b'""', b"1", b"255"]
    text = broken(data, json.dumps(root.value).encode(), tokens, 4)
    with suppress(FormatError):
        part: GlbPart = read_part(packed_glb(text, binary), "part.glb")
        writer = GlbWriter(np.eye(4))
        writer.place("body", [(writer.add(part), np.eye(4))])
        read_part(writer.to_bytes(), "composed.glb")


def test_real_files_come_out_as_they_went_in(real_data: Path) -> None:
    """Every mesh of the datasets, bit for bit and in order."""
    files = sorted({*(real_data / "replicacad").rglob("*.glb"), *(real_data / "habitat_test_assets").rglob("*.glb")})
    assert len(files) > 90
    for file in files:
        data = file.read_bytes()
        vertices, faces = glb_triangles(data, str(file), np.eye(4))
        again, same = glb_triangles(joined(data), str(file), np.eye(4))
        np.testing.assert_array_equal(same, faces)
        assert again.tobytes() == vertices.tobytes(), file
