"""Chains of objects in and on each other."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from condvln.relations.stacking import closure


@pytest.mark.parametrize("seed", range(20))
def test_chains_are_the_paths_of_the_graph(seed: int) -> None:
    """With cycles and links to themselves."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 30))
    direct = rng.random((n, n)) < rng.choice([0.02, 0.05, 0.2])
    before = direct.copy()
    graph = nx.from_numpy_array(direct, create_using=nx.DiGraph)
    expected = np.zeros((n, n), np.bool_)
    for i in range(n):
        reached = set().union(*({j} | nx.descendants(graph, j) for j in graph.successors(i)))
        expected[i, list(reached)] = True
    np.testing.assert_array_equal(closure(direct), expected)
    np.testing.assert_array_equal(direct, before)
