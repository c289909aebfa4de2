"""Made Matterport3D scans: every record kind, read by a parser of the test's own."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import shapely

from condvln.samples import Layout, make_layouts
from condvln.samples.mp3d import REGION_LABELS, mp3d_files

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
