"""The graph variant, against networkx and R2R's own numbers."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.evaluation.discrete import GraphEpisode, evaluate_graph, read_graph_episodes
from condvln.evaluation.predictions import GraphPrediction
from condvln.evaluation.split import SplitOptions, evaluate_split
from condvln.navigation.graph_pathfinder import GraphPathfinder, ViewpointGraph
from schemas.errors import FormatError
from tests.condvln.evaluation import plain


def graph_of(places: np.ndarray, edges: list[tuple[int, int]]) -> tuple[GraphPathfinder, nx.Graph]:
    lengths = np.array([np.linalg.norm(places[a] - places[b]) for a, b in edges])
    pairs = np.array(edges, np.int32).reshape(-1, 2)
    graph = ViewpointGraph(tuple(f"v{i}" for i in range(len(places))), places.astype(np.float32), pairs, lengths)
    check = nx.Graph()
    check.add_nodes_from(graph.ids)
    check.add_weighted_edges_from((f"v{a}", f"v{b}", w) for (a, b), w in zip(edges, lengths, strict=True))
    return GraphPathfinder(graph), check


@st.composite
def worlds(draw: st.DrawFn) -> tuple[np.ndarray, list[tuple[int, int]], list[int], list[int]]:
    count = draw(st.integers(2, 8))
    seed = draw(st.integers(0, 2**32 - 1))
    places = np.random.default_rng(seed).uniform(0, 8, (count, 3))
    edges = {(i, i + 1) for i in range(count - 1)}
    extra = draw(st.lists(st.tuples(st.integers(0, count - 1), st.integers(0, count - 1)), max_size=6))
    edges |= {(min(e), max(e)) for e in extra if e[0] != e[1]}
    node = st.integers(0, count - 1)
    reference = draw(st.lists(node, min_size=1, max_size=6))
    return places, sorted(edges), reference, [reference[0], *draw(st.lists(node, max_size=7))]


@given(worlds())
@settings(max_examples=150)
def test_equal_the_plain_definitions_over_networkx(world: tuple[np.ndarray, list, list[int], list[int]]) -> None:
    places, edges, reference, path = world
    distances, check = graph_of(places, edges)
    shortest = dict(nx.all_pairs_dijkstra_path_length(check))
    names = [f"v{i}" for i in path]
    wanted = tuple(f"v{i}" for i in reference)
    found = evaluate_graph(
        [GraphEpisode("1_0", "s", wanted)], [GraphPrediction("1_0", tuple(names))], {"s": distances}
    )["1_0"]

    def between(a: str, b: str) -> float:
        return shortest[a][b]

    length = sum(between(a, b) for a, b in pairwise(names))
    success = between(names[-1], wanted[-1]) < 3.0
    assert found.path_length == pytest.approx(length)
    assert found.navigation_error == pytest.approx(between(names[-1], wanted[-1]))
    assert found.success == success
    assert found.oracle_success == any(between(v, wanted[-1]) < 3.0 for v in names)
    assert found.spl == pytest.approx(plain.spl(success, between(wanted[0], wanted[-1]), length))
    near = math.exp(-plain.dtw(names, wanted, between) / (len(wanted) * 3.0))  # type: ignore[arg-type]
    assert found.ndtw == pytest.approx(near)
    assert found.sdtw == pytest.approx(success * near)
    coverage = np.mean([math.exp(-min(between(r, v) for v in names) / 3.0) for r in wanted])
    expected = coverage * sum(between(a, b) for a, b in pairwise(wanted))
    total = expected + abs(expected - length)
    assert found.cls == pytest.approx(coverage * expected / total if total else coverage)
    assert found.spl <= found.success <= found.oracle_success


def test_r2r_paths_are_perfect_walks_of_their_own_length(real_data: Path) -> None:
    folder = real_data / "mp3d"
    records = {r["path_id"]: r for r in json.loads((folder / "R2R_sample.json").read_text())}
    graphs = {
        path.name.removesuffix("_connectivity.json"): GraphPathfinder.load(path)
        for path in (folder / "connectivity").glob("*.json")
    }
    everything = read_graph_episodes(folder / "R2R_sample.json")
    assert len(everything) == 36
    episodes = [episode for episode in everything if episode.scan in graphs]
    assert episodes
    perfect = [GraphPrediction(episode.instruction_id, episode.path) for episode in episodes]
    for name, found in evaluate_graph(episodes, perfect, graphs).items():
        record = records[int(name.split("_")[0])]
        assert found.path_length == pytest.approx(record["distance"], abs=0.0051)  # the file rounds to 1 cm
        assert (found.success, found.oracle_success, found.ndtw, found.cls) == (1, 1, 1, 1)
        assert found.spl == pytest.approx(1)
    lazy = [GraphPrediction(episode.instruction_id, episode.path[:1]) for episode in episodes]
    for found in evaluate_graph(episodes, lazy, graphs).values():
        assert found.path_length == 0
        assert found.success == (found.navigation_error < 3.0)


@pytest.fixture
def line() -> GraphPathfinder:
    return graph_of(np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0], [90, 0, 0]], float), [(0, 1), (1, 2)])[0]


def test_edges_of_the_definition(line: GraphPathfinder) -> None:
    episodes = [GraphEpisode("1_0", "s", ("v0", "v1", "v2")), GraphEpisode("2_0", "s", ("v0", "v3"))]
    found = evaluate_graph(episodes, [GraphPrediction("1_0", ())], {"s": line})
    assert found["1_0"].missing == found["2_0"].missing == 1
    for score in found.values():
        assert (score.success, score.oracle_success, score.spl, score.ndtw, score.sdtw, score.cls) == (0,) * 6
    assert found["1_0"].navigation_error == 4
    lost = evaluate_graph(episodes, [GraphPrediction("2_0", ("v0", "v1"))], {"s": line})["2_0"]
    assert (lost.success, lost.spl, lost.ndtw) == (0, 0, 0)
    assert (math.isnan(lost.navigation_error), lost.unreachable) == (True, 1)


@pytest.mark.parametrize(
    ("prediction", "says"),
    [
        (GraphPrediction("9_0", ("v0",)), "instruction 9_0: no such instruction"),
        (GraphPrediction("1_0", ("v7",)), "instruction 1_0: no viewpoint 'v7'"),
        (GraphPrediction("1_0", ("v1", "v2")), "begins at another viewpoint"),
    ],
)
def test_wrong_predictions(line: GraphPathfinder, prediction: GraphPrediction, says: str) -> None:
    with pytest.raises(FormatError, match=says):
        evaluate_graph([GraphEpisode("1_0", "s", ("v0", "v1"))], [prediction], {"s": line})


@pytest.mark.parametrize("text", ["{", "{}", "[1]", '[{"path_id": 1}]'])
def test_wrong_r2r_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "R2R.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=r"R2R\.json: "):
        read_graph_episodes(path)


def test_steps_between_viewpoints_without_an_edge_are_counted(line: GraphPathfinder) -> None:
    episode = GraphEpisode("1_0", "s", ("v0", "v1", "v2"))
    for path, gaps, length, spl in (
        (("v0", "v1", "v2"), 0, 4, 1),
        (("v0", "v0", "v1", "v1", "v2"), 0, 4, 1),
        (("v0", "v2"), 1, 4, 1),
        (("v0", "v2", "v0", "v2"), 3, 12, 1 / 3),
        (("v0", "v3", "v2"), 2, math.nan, 0),
    ):
        found = evaluate_graph([episode], [GraphPrediction("1_0", path)], {"s": line})["1_0"]
        assert (found.gaps, found.success, found.spl) == (gaps, 1, pytest.approx(spl)), path
        assert found.path_length == pytest.approx(length, nan_ok=True), path
        assert 0 <= found.ndtw <= 1
        assert 0 <= found.cls <= 1


@pytest.mark.parametrize("name", ["flat", "duet_nested", "duet_last_jump"])
def test_global_jumps_score_as_the_same_walk_in_single_steps(real_data: Path, tmp_path: Path, name: str) -> None:
    """Three files of one perfect walk in each episode, as three agents write it."""
    folder = real_data / "cases" / "duet"
    connectivity = real_data / "mp3d" / "connectivity"
    (tmp_path / "R2R_sample.json").write_bytes((folder / "R2R_sample.json").read_bytes())
    options = SplitOptions(connectivity=(connectivity,))
    (found,), _ = evaluate_split(tmp_path, "sample", [folder / f"{name}.json"], options)
    for measure in ("success", "spl", "ndtw", "sdtw", "cls"):
        np.testing.assert_allclose(found.scores[measure], 1, err_msg=measure)
    assert (found.scores["gaps"] == 0).all()
