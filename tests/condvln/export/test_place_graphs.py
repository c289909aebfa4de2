"""The graphs of places that VLN-CE's top-down map unpickles."""

from __future__ import annotations

import gzip
import json
import pickle
import pickletools
from pathlib import Path

import networkx as nx
import numpy as np
import yaml
from hypothesis import given
from hypothesis import strategies as st

from condvln.export.place_graphs import PLACES, Places, graph_keys, pickled_graphs
from condvln.navigation.graph_pathfinder import ViewpointGraph

points = st.lists(st.tuples(*[st.floats(-20, 20, allow_nan=False)] * 3).map(list), min_size=1, max_size=6)


def loaded(data: bytes) -> dict[str, nx.Graph]:
    found: dict[str, nx.Graph] = pickle.loads(data)
    return found


def rows_of(*routes: list[list[float]]) -> list[dict[str, object]]:
    return [{"leaves": [{"reference_path": route} for route in routes]}]


def names_in(data: bytes) -> set[str]:
    return {str(argument) for code, argument, _ in pickletools.genops(data) if code.name in ("GLOBAL", "INST")}


def test_the_map_finds_every_episode_of_an_export(exported: Path) -> None:
    """As TopDownMapVLNCE looks them up: by the file's name and by its folder's, the nearest node by ``position``."""
    graphs = loaded((exported / PLACES).read_bytes())
    seen = 0
    for path in (exported / "vlnce").rglob("*.json.gz"):
        if path.name.endswith("_gt.json.gz"):
            continue
        for episode in json.loads(gzip.decompress(path.read_bytes()))["episodes"]:
            scene = episode["scene_id"]
            graph = graphs[scene.split("/")[-1].split(".")[0]]
            assert graphs[scene.split("/")[-2]].nodes == graph.nodes
            places = np.array([graph.nodes[node]["position"] for node in graph])
            for point in episode["reference_path"]:
                assert np.linalg.norm(places - point, axis=1).min() <= 3**0.5
            seen += 1
    assert seen
    named = [
        yaml.safe_load((exported / "configs" / name / "condvln_task.yaml").read_text())
        for name in ("navid", "vln_zero")
    ]
    assert [one["TASK"]["TOP_DOWN_MAP_VLNCE"]["GRAPHS_FILE"].split("datasets/condvln/")[1] for one in named] == [
        PLACES
    ] * 2


def test_loading_it_can_run_nothing(exported: Path) -> None:
    data = (exported / PLACES).read_bytes()
    assert names_in(data) == {"networkx.classes.graph Graph"}
    assert not any(code.name == "STACK_GLOBAL" for code, _, _ in pickletools.genops(data))
    assert not any(code.name == "REDUCE" for code, _, _ in pickletools.genops(data))


@given(st.lists(points, min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_places_are_those_of_the_routes_whatever_their_order(routes: list[list[list[float]]], random) -> None:
    one, other = Places(), Places()
    one.add("gibson/Oyens/Oyens.glb", rows_of(*routes))
    shuffled = list(routes)
    random.shuffle(shuffled)
    other.add("gibson/Oyens/Oyens.glb", [row for route in shuffled for row in rows_of(route)])
    assert one.pickled() == other.pickled()
    graph = loaded(one.pickled())["Oyens"]
    places = np.array([graph.nodes[node]["position"] for node in graph])
    for route in routes:
        nearest = [int(np.linalg.norm(places - point, axis=1).argmin()) for point in (route[0], route[-1])]
        assert np.linalg.norm(places[nearest] - [route[0], route[-1]], axis=1).max() <= 3**0.5 + 1e-2
    # A route is one piece; so there are no more pieces than routes.
    assert nx.number_connected_components(graph) <= len(routes)
    assert not any(nx.selfloop_edges(graph))


@given(st.lists(points, min_size=1, max_size=4), st.sampled_from([1e-3, 1.0, 1e5]))
def test_a_place_is_the_least_point_of_its_cell(routes: list[list[list[float]]], scale: float) -> None:
    """Also where the house is so small, or so large, that cells are numbered in another way."""
    routes = [[[scale * value for value in route[0]]] for route in routes]
    places = Places()
    places.add("gibson/Oyens/Oyens.glb", rows_of(*routes))
    found = loaded(places.pickled())["Oyens"]
    cells: dict[tuple[float, ...], list[float]] = {}
    for one in sorted((np.rint(np.array(route[0]) * 1000) / 1000).tolist() for route in routes):
        cells.setdefault(tuple(np.floor(one)), one)
    assert [at["position"] for _, at in found.nodes.items()] == [cells[cell] for cell in sorted(cells)]


def test_scans_have_their_viewpoints() -> None:
    positions = np.array([[0, 0, 0], [2, 0, 0], [2, 0, 2]], dtype=np.float32)
    viewpoints = ViewpointGraph(("a", "b", "c"), positions, np.array([[0, 1], [1, 2]], np.int32), np.array([2.0, 2.0]))
    places = Places()
    places.add("mp3d/YmJkqBEsHnH/YmJkqBEsHnH.glb", rows_of([[0.0, 0.0, 0.0]]), viewpoints)
    graph = loaded(places.pickled())["YmJkqBEsHnH"]
    assert {name: at["position"] for name, at in graph.nodes.items()} == dict(
        zip("abc", positions.tolist(), strict=True)
    )
    assert {frozenset(edge) for edge in graph.edges} == {frozenset("ab"), frozenset("bc")}


def test_a_scene_is_known_by_its_file_and_its_folder() -> None:
    assert graph_keys("replicacad/apt_0/apt_0.glb") == ["apt_0"]
    assert graph_keys("ai2thor/houses/house-1.v2.glb") == ["house-1", "houses"]


def test_the_state_is_what_networkx_2_and_3_share() -> None:
    """No caches, factories or properties of the version that wrote it."""
    graph = nx.path_graph(3)
    _ = graph.nodes, graph.adj  # cached properties of networkx 3
    again = loaded(pickled_graphs({"x": graph}))["x"]
    assert set(vars(again)) == {"graph", "_node", "_adj"}
    assert nx.utils.graphs_equal(again, graph)
    assert [*again.edges(1)] == [(1, 0), (1, 2)]
