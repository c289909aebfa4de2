"""Made Matterport3D scans: every record kind, read by a parser of the test's own."""

from __future__ import annotations

import io
import json
import re
from collections import defaultdict
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import shapely
import trimesh

from condvln.samples import Layout, make_layouts
from condvln.samples.house import REGION_LABELS
from condvln.samples.mp3d import mp3d_files
from condvln.samples.native_labels import native_labels

Records = dict[str, list[list[str]]]


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(4, 10)


@pytest.fixture(scope="module")
def files(layouts: dict[str, Layout]) -> dict[str, bytes]:
    return dict(mp3d_files(layouts))


def _records(files: dict[str, bytes], name: str) -> Records:
    lines = files[f"{name}/house_segmentations/{name}.house"].decode().splitlines()
    assert lines[0] == "ASCII 1.1"
    records: Records = defaultdict(list)
    for line in lines[1:]:
        kind, *fields = line.split()
        if kind == "P":
            kind = "panorama" if re.fullmatch("[0-9a-f]{32}", fields[0]) else "portal"
        records[kind].append(fields)
    return records


def _lengths(records: Records) -> dict[str, set[int]]:
    return {kind: {len(row) for row in rows} for kind, rows in records.items()}


def _numbers(fields: list[str]) -> np.ndarray:
    return np.array([float(field) for field in fields])


def _habitat(points: np.ndarray) -> np.ndarray:
    return points[..., [0, 2, 1]] * [1, 1, -1]


def test_the_header_counts_every_kind(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    for name, layout in layouts.items():
        records = _records(files, name)
        (header,) = records["H"]
        kinds = ("I", "panorama", "V", "S", "E", "O", "C", "R", "portal", "L")
        counts = dict(zip(kinds, map(int, header[2:12]), strict=True))
        assert counts == {kind: len(records[kind]) for kind in counts}
        assert counts["R"] == len(layout.rooms)
        assert counts["portal"] == len(layout.doors)
        assert all(int(row[0]) == i for kind in "RSVICOE" for i, row in enumerate(records[kind]))
        # Numbers of fields as in a real house; an image has a pose, a camera matrix and a size.
        lengths = _lengths(records)
        assert lengths == {
            "H": {28}, "L": {17}, "R": {19}, "S": {21}, "V": {12}, "panorama": {12}, "portal": {14},
            "I": {40}, "C": {10}, "O": {23}, "E": {18},
        }  # fmt: skip


def test_records_are_as_long_as_in_a_real_house(files: dict[str, bytes], real_data: Path) -> None:
    scan = "YmJkqBEsHnH"
    path = f"{scan}/house_segmentations/{scan}.house"
    real = _lengths(_records({path: (real_data / "mp3d" / path).read_bytes()}, scan))
    made = _lengths(_records(files, "made_000"))
    assert {kind: made[kind] for kind in real} == real


def test_oriented_boxes_are_those_of_the_layout(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    for name, layout in layouts.items():
        records = _records(files, name)
        categories = [row[2].replace("#", " ") for row in records["C"]]
        structure = {"wall", "floor", "ceiling"}
        read = []
        for row in records["O"]:
            if int(row[2]) < 0 or categories[int(row[2])] in structure:
                continue
            values = _numbers(row[3:15])
            center, a0, a1, radii = values[:3], values[3:6], values[6:9], values[9:12]
            axes = np.stack([a0, a1, np.cross(a0, a1)])
            np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-6)
            assert radii[0] >= radii[1] >= radii[2] > 0
            half = (np.abs(axes) * radii[:, None]).sum(axis=0)
            low, high = _habitat(center - half), _habitat(center + half)
            box = np.round([np.minimum(low, high), np.maximum(low, high)], 3)
            read.append((layout.rooms[int(row[1])].room_id, categories[int(row[2])], *box.ravel()))
        made = [(p.room_id, native_labels()[p.label].mp3d, *np.round(p.aabb, 3).ravel()) for p in layout.furniture]
        assert sorted(read) == sorted(made)
        # Structure and things without a category are listed too, as in real houses.
        assert sum(int(row[2]) < 0 for row in records["O"]) == 1
        assert sum(int(row[2]) >= 0 and categories[int(row[2])] in structure for row in records["O"]) == 3 * len(
            layout.rooms
        )


def test_vertical_axes_come_at_any_place(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    places = set()
    for name in layouts:
        for row in _records(files, name)["O"]:
            a0, a1 = _numbers(row[6:9]), _numbers(row[9:12])
            places.add(0 if abs(a0[2]) > 0.9 else 1 if abs(a1[2]) > 0.9 else 2)
    assert places == {0, 1, 2}


def test_regions_are_prisms_over_counter_clockwise_outlines(
    files: dict[str, bytes], layouts: dict[str, Layout]
) -> None:
    for name, layout in layouts.items():
        records = _records(files, name)
        for region, surface, room in zip(records["R"], records["S"], layout.rooms, strict=True):
            corners = np.array([_numbers(row[3:6]) for row in records["V"] if row[1] == surface[0]])
            assert shapely.LinearRing(corners[:, :2]).is_ccw
            outline = shapely.Polygon(_habitat(corners)[:, [0, 2]])
            assert outline.equals(room.shape)
            assert region[4] == REGION_LABELS[room.label]
            assert float(region[14]) == layout.ceiling


def test_segments_of_an_object_fill_its_box(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    for name, layout in layouts.items():
        records = _records(files, name)
        boxes = defaultdict(list)
        for row in records["E"]:
            boxes[int(row[1])].append(_numbers(row[7:13]).reshape(2, 3))
        for index, piece in enumerate(layout.furniture):
            parts = _habitat(np.array(boxes[index])).reshape(-1, 3)
            np.testing.assert_allclose([parts.min(axis=0), parts.max(axis=0)], piece.aabb, atol=1.5e-3)


def test_panoramas_lie_in_their_regions_and_the_graph_is_walkable(
    files: dict[str, bytes], layouts: dict[str, Layout]
) -> None:
    for name, layout in layouts.items():
        panoramas = _records(files, name)["panorama"]
        listed = files[f"{name}/house_segmentations/panorama_to_region.txt"].decode().split("\n")[:-1]
        nodes = json.loads(files[f"connectivity/{name}_connectivity.json"])
        assert {int(row[2]) for row in panoramas} == set(range(len(layout.rooms)))
        for row, line, node in zip(panoramas, listed, nodes, strict=True):
            room = layout.rooms[int(row[2])]
            x, _, z = _habitat(_numbers(row[4:7]))
            assert room.shape.covers(shapely.Point(x, z))
            assert line.split() == [row[1], row[0], row[2], REGION_LABELS[room.label]]
            assert node["image_id"] == row[0]
            pose = np.array(node["pose"]).reshape(4, 4)
            np.testing.assert_allclose(pose[:3, 3], _numbers(row[4:7]), atol=1e-3)
            np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
            assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        joined = np.array([node["unobstructed"] for node in nodes])
        visible = np.array([node["visible"] for node in nodes])
        np.testing.assert_array_equal(joined, joined.T)
        assert (visible | ~joined).all()
        assert not joined.diagonal().any()
        assert nx.is_connected(nx.from_numpy_array(joined))


def test_the_mesh_is_z_up(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    for name, layout in layouts.items():
        scene = trimesh.load_scene(io.BytesIO(files[f"{name}/{name}.glb"]), file_type="glb")
        (x0, z0), (x1, z1) = layout.bounds
        expected = [[x0 - 0.05, -z1 - 0.05, -0.1], [x1 + 0.05, -z0 + 0.05, layout.ceiling]]
        np.testing.assert_allclose(scene.bounds, expected, atol=1e-9)


def test_the_category_table_is_what_the_houses_index(files: dict[str, bytes], layouts: dict[str, Layout]) -> None:
    head, *rows = (line.split("\t") for line in files["category_mapping.tsv"].decode().splitlines())
    table = [dict(zip(head, row, strict=True)) for row in rows]
    coarse = dict(line.split("\t") for line in files["mpcat40.tsv"].decode().splitlines()[1:])
    for name in layouts:
        for row in _records(files, name)["C"]:
            entry = table[int(row[0])]
            assert int(entry["index"]) == int(row[1]) == int(row[0]) + 1
            assert entry["raw_category"] == row[2].replace("#", " ")
            assert (entry["mpcat40index"], entry["mpcat40"]) == (row[3], row[4])
            assert coarse[row[3]] == row[4]
