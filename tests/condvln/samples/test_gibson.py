"""Made Gibson scene graphs: both forms say the same, in the way the originals do."""

from __future__ import annotations

import io
import json
import pickle
import zipfile

import numpy as np
import pytest
import shapely
import trimesh

from condvln.navigation.navmesh_file import parse_navmesh
from condvln.samples import Layout, make_layouts
from condvln.samples.gibson import gibson_files
from condvln.samples.native_labels import native_labels


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(4, 9)


def _habitat(record: dict) -> np.ndarray:
    """[min, max] with (x, y, z) → (x, z, −y)."""
    (x, y, z), (sx, sy, sz) = record["location"], record["size"]
    center, half = np.array([x, z, -y]), np.array([sx, sz, sy]) / 2
    return np.stack([center - half, center + half])


def _graph(files: dict[str, bytes], name: str) -> tuple[list[dict], list[dict]]:
    if f"verified/{name}.scn" in files:
        document = json.loads(files[f"verified/{name}.scn"])
        return document["rooms"], document["objects"]
    archive = np.load(io.BytesIO(files[f"verified/3DSceneGraph_{name}.npz"]), allow_pickle=True)
    output = archive["output"].item()
    assert set(output) == {"building", "room", "object", "camera", "panorama"}
    for kind in ("room", "object"):
        assert all(key == record["id"] for key, record in output[kind].items())
    assert output["building"]["num_objects"] == len(output["object"])
    return list(output["room"].values()), list(output["object"].values())


def test_objects_and_rooms_come_back_in_habitats_frame(layouts: dict[str, Layout]) -> None:
    files = dict(gibson_files(layouts))
    for name, layout in layouts.items():
        rooms, objects = _graph(files, name)
        read = sorted((o["class_"], o["parent_room"], *np.round(_habitat(o), 3).ravel()) for o in objects)
        number = {room.room_id: i for i, room in enumerate(layout.rooms, start=1)}
        made = sorted(
            (native_labels()[p.label].gibson, number[p.room_id], *np.round(p.aabb, 3).ravel()) for p in layout.furniture
        )
        assert read == made
        for record, room in zip(rooms, layout.rooms, strict=True):
            low, high = _habitat(record)
            assert (low[0], low[2], high[0], high[2]) == pytest.approx(room.shape.bounds)
            assert (low[1], high[1]) == pytest.approx((0, layout.ceiling))
            assert record["floor_area"] == pytest.approx(shapely.Polygon(room.polygon).convex_hull.length)
            assert record["floor_number"] == "A"


def test_both_forms_hold_the_same(layouts: dict[str, Layout]) -> None:
    scn, npz = (dict(gibson_files(layouts, form)) for form in ("scn", "npz"))
    for name in layouts:
        for one, other in zip(_graph(scn, name), _graph(npz, name), strict=True):
            plain = [{k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in record.items()} for record in other]
            assert one == plain


def test_forms_take_turns(layouts: dict[str, Layout]) -> None:
    files = dict(gibson_files(layouts))
    assert [f"verified/{name}.scn" in files for name in layouts] == [True, False, True, False]


def test_the_pickle_needs_only_what_numpy_arrays_need(layouts: dict[str, Layout]) -> None:
    files = dict(gibson_files(layouts, "npz"))
    data = next(content for path, content in files.items() if path.endswith(".npz"))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["output.npy"]
        member = io.BytesIO(archive.read("output.npy"))
    np.lib.format.read_magic(member)
    np.lib.format.read_array_header_1_0(member)
    unpickler = _Recording(member)
    unpickler.load()
    assert unpickler.needed == {("numpy", "ndarray"), ("numpy", "dtype"), ("numpy._core.multiarray", "_reconstruct")}


class _Recording(pickle.Unpickler):
    """Notes what the pickle names."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.needed: set[tuple[str, str]] = set()

    def find_class(self, module: str, name: str) -> object:
        self.needed.add((module, name))
        return super().find_class(module, name)


def test_the_mesh_is_z_up_and_the_navmesh_of_the_old_form(layouts: dict[str, Layout]) -> None:
    files = dict(gibson_files(layouts))
    for name, layout in layouts.items():
        navmesh = parse_navmesh(files[f"{name}.navmesh"])
        assert (navmesh.version, navmesh.settings) == (1, None)
        scene = trimesh.load_scene(io.BytesIO(files[f"{name}.glb"]), file_type="glb")
        (x0, z0), (x1, z1) = layout.bounds
        expected = [[x0 - 0.05, -z1 - 0.05, -0.1], [x1 + 0.05, -z0 + 0.05, layout.ceiling]]
        np.testing.assert_allclose(scene.bounds, expected, atol=1e-9)
        for piece in layout.furniture:
            nodes = [node for node in scene.graph.nodes_geometry if scene.graph[node][1] == piece.object_id]
            corners = np.concatenate(
                [trimesh.transform_points(scene.geometry[g].vertices, m) for m, g in map(scene.graph.get, nodes)]
            )
            corners = corners[:, [0, 2, 1]] * [1, 1, -1]
            np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], piece.aabb, atol=1e-6)
