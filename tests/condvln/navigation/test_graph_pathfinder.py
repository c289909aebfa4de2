"""Paths over viewpoints: R2R's own distances, networkx as the second opinion, and files that lie."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.navigation.graph_pathfinder import GraphPathfinder, read_connectivity
from schemas.errors import FormatError, InputError, MissingFileError, UsageError
from tests.condvln.viewpoint_graphs import graph_of


def viewpoint(name: str, x: float, y: float, z: float, joined: list[bool], included: bool = True) -> dict[str, Any]:
    pose = [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1]
    return {
        "image_id": name,
        "pose": pose,
        "included": included,
        "unobstructed": joined,
        "visible": joined,
        "height": 1.5,
    }


@pytest.fixture
def scan() -> list[dict[str, Any]]:
    """A path a–b–c of 3 m and 4 m, a viewpoint d left out of the graph, and e on its own."""
    return [
        viewpoint("a", 0, 0, 1.5, [False, True, False, True, False]),
        viewpoint("b", 3, 0, 1.5, [True, False, True, False, False]),
        viewpoint("c", 3, 4, 1.5, [False, True, False, False, False]),
        viewpoint("d", 0, 4, 1.5, [True, False, False, False, False], included=False),
        viewpoint("e", 50, 0, 1.5, [False] * 5),
    ]


def written(folder: Path, content: Any) -> Path:
    file = folder / "x_connectivity.json"
    file.write_text(json.dumps(content))
    return file


def test_frame_edges_and_lengths(scan: list[dict[str, Any]], tmp_path: Path) -> None:
    """z-up (x, y, z) is (x, z − height, −y) on the floor; what is not included is gone with its edges."""
    paths = GraphPathfinder.load(written(tmp_path, scan))
    assert paths.graph.ids == ("a", "b", "c", "e")
    np.testing.assert_array_equal(paths.position("c"), np.float32([3, 0, -4]))
    assert paths.viewpoint_distance("a", "c") == 7.0
    assert paths.viewpoint_path("c", "a") == ["c", "b", "a"]
    assert paths.path_length(["c", "b", "a"]) == 7.0
    with pytest.raises(InputError, match="not connected"):
        paths.path_length(["a", "c"])
    with pytest.raises(UsageError, match="no viewpoint 'd'"):
        paths.position("d")


def test_points_and_places_without_a_way(scan: list[dict[str, Any]], tmp_path: Path) -> None:
    paths = GraphPathfinder.load(written(tmp_path, scan))
    assert paths.viewpoint([0.4, 0.1, 0.3]) == "a"
    assert paths.viewpoint([20, 0, 0]) is paths.viewpoint([np.nan, 0, 0]) is None
    assert paths.viewpoint_distance("a", "e") == float("inf")
    assert paths.viewpoint_path("a", "e") == []


@given(st.integers(0, 2**32 - 1), st.integers(2, 14), st.floats(0.1, 0.7))
def test_lengths_are_those_of_networkx(seed: int, count: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 20, (count, 3)).astype(np.float32)
    edges = [(a, b) for a in range(count) for b in range(a + 1, count) if rng.random() < density]
    paths, names = graph_of(places, edges), tuple(map(str, range(count)))
    graph: nx.Graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for a, b in edges:
        graph.add_edge(a, b, weight=float(np.linalg.norm(places[a].astype(float) - places[b])))
    expected = np.full((count, count), np.inf)
    for a, lengths in nx.all_pairs_dijkstra_path_length(graph):
        for b, length in lengths.items():
            expected[a, b] = length
    np.testing.assert_allclose(paths.between(range(count), range(count)), expected)
    for a in names:
        for b in names:
            way = paths.viewpoint_path(a, b)
            length = paths.viewpoint_distance(a, b)
            assert (way != []) == np.isfinite(length)
            if way:
                assert paths.path_length(way) == pytest.approx(length)


def test_r2r_paths_are_shortest_and_as_long_as_r2r_says(real_data: Path) -> None:
    """R2R's items give the path and its length to the centimetre."""
    items = json.loads((real_data / "mp3d" / "R2R_sample.json").read_text())
    checked = 0
    for item in items:
        file = real_data / "mp3d" / "connectivity" / f"{item['scan']}_connectivity.json"
        if not file.is_file():
            continue
        paths = GraphPathfinder.load(file)
        assert paths.path_length(item["path"]) == pytest.approx(item["distance"], abs=0.011)
        assert paths.viewpoint_path(item["path"][0], item["path"][-1]) == item["path"]
        checked += 1
    assert checked >= 5


def put(where: list[Any], value: Any) -> Callable[[list[Any]], Any]:
    def change(scan: list[Any]) -> Any:
        target: Any = scan
        for key in where[:-1]:
            target = target[key]
        target[where[-1]] = value
        return scan

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda scan: {"a": 1}, "an array is expected"),
        (lambda scan: [], "not a list"),
        (lambda scan: [{}] * 2001, "not a list"),
        (put([1], 5), r"\[1\]: an object is expected"),
        (put([1, "image_id"], ""), r"\[1\].image_id"),
        (put([1, "image_id"], "a"), r"\[0\].image_id: viewpoint 'a' occurs twice"),
        (put([1, "pose"], [1.0] * 15), r"\[1\].pose"),
        (put([1, "pose", 3], "7"), r"\[1\].pose"),
        (put([1, "pose", 3], True), r"\[1\].pose"),
        (put([1, "pose", 3], 1e300), r"\[1\].pose"),
        (put([1, "height"], None), r"\[1\].height"),
        (put([1, "included"], 1), r"\[1\].included"),
        (put([1, "unobstructed"], [True] * 4), r"\[1\].unobstructed"),
        (put([1, "unobstructed", 0], 1), r"\[1\].unobstructed"),
        (put([1, "unobstructed", 1], True), r"\[1\].unobstructed: a viewpoint is connected to itself"),
        (put([4, "unobstructed", 0], True), r"\[4\].unobstructed\[0\]: an edge exists in one direction"),
        (lambda scan: [dict(item, included=False) for item in scan], "no viewpoint is included"),
    ],
)
def test_files_that_lie(
    scan: list[dict[str, Any]], tmp_path: Path, change: Callable[[list[Any]], Any], message: str
) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        read_connectivity(written(tmp_path, change(scan)))
    assert caught.value.where.endswith("x_connectivity.json")


def test_files_that_are_no_json(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        read_connectivity(tmp_path / "none.json")
    (tmp_path / "one.json").symlink_to(tmp_path / "other.json")
    (tmp_path / "other.json").symlink_to(tmp_path / "one.json")
    with pytest.raises(MissingFileError):
        read_connectivity(tmp_path / "one.json")
    for content in (b"", b"[1, 2", b"\xff\xfe", b"[NaN]", b"[" * 100_000):
        (tmp_path / "bad.json").write_bytes(content)
        with pytest.raises(FormatError):
            read_connectivity(tmp_path / "bad.json")
