"""Starts tried in a compiled loop, compared with the rules written out one query at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest

import condvln.episodes.starts as module
from condvln.episodes.footprint import Footprint, Footprints
from condvln.episodes.kernels.distances import comes_within, passes_through
from condvln.episodes.kernels.starts import REFUSALS, Bounds
from condvln.episodes.starts import GoalField, Leaves, Route, Starts
from condvln.navigation.pathfinder import Pathfinder
from condvln.scene import round_mm
from tests.condvln.episodes.floors import grid_floor

APART = 0.6


@pytest.fixture(scope="module")
def floor() -> Pathfinder:
    """Two rooms with a narrow door, and a third that can't be reached."""
    return grid_floor(9, 6, lambda x, z: (4 < x < 4.25 and not 2.5 < z < 3.25) or 7 < x < 7.25)


@pytest.fixture(scope="module")
def field(floor: Pathfinder) -> GoalField:
    rng = np.random.default_rng(3)
    middles = [(1, 1), (1, 5), (3, 3), (5, 1), (5.5, 5), (6.5, 3), (8, 3)]
    return GoalField(
        floor,
        {
            f"o{k}": round_mm(
                floor.snap_points(np.array([x, 0.0, z]) + rng.uniform(-0.5, 0.5, (k % 3 + 1, 3)) * [1, 0, 1])
            )
            for k, (x, z) in enumerate(middles)
        },
    )


@pytest.fixture(scope="module")
def positions(floor: Pathfinder) -> np.ndarray:
    return round_mm(floor.get_random_navigable_points(40, np.random.default_rng(4)))


SOLID = Footprints([Footprint(np.array([2.0, 2.0]), np.array([0.4, 0.2]), np.eye(2))])


def expected_route(field: GoalField, start: np.ndarray, moves: Sequence[int]) -> Route | None:
    """The route through `moves`, each time to the nearest point, from single queries."""
    at, stops, pieces, length = start, [], [start[None]], 0.0
    names = list(field.goals)
    for move in moves:
        paths = [field.pathfinder.find_path(at, point) for point in field.goals[names[move]]]
        best = int(np.argmin([path.geodesic_distance for path in paths]))
        if not np.isfinite(paths[best].geodesic_distance):
            return None
        at = field.goals[names[move]][best]
        stops.append(at)
        pieces.append(round_mm(paths[best].points)[1:])
        length += paths[best].geodesic_distance
    return Route(np.array(stops), np.concatenate(pieces), length)


def expected_refusal(
    field: GoalField, start: np.ndarray, leaves: Sequence[Sequence[int]], lengths: tuple[float, float] | None
) -> str | None:
    routes = []
    for leaf in leaves:
        route = expected_route(field, start, leaf)
        if route is None:
            return "unreachable"
        if passes_through(route.path, *SOLID.boxes):
            return "path_through_furniture"
        routes.append(route)
    goals = [list(field.goals.values())[leaf[-1]] for leaf in leaves]
    for k, route in enumerate(routes):
        if any(j != k and comes_within(route.path, points, APART) for j, points in enumerate(goals)):
            return "path_enters_other_leaf"
    if lengths is not None and not all(lengths[0] <= route.length <= lengths[1] for route in routes):
        return "route_missed"
    return None


@pytest.mark.parametrize("lengths", [None, (2.0, 6.0)])
def test_the_first_start_and_the_refusals_are_those_of_single_queries(
    floor, field, positions, lengths, monkeypatch
) -> None:
    monkeypatch.setattr(module, "WAYS", 4)  # so that the room for ways is doubled many times
    monkeypatch.setattr(module, "CORNERS", 300)
    starts, rng, seen = Starts(floor, field, positions, SOLID), np.random.default_rng(5), Counter[str | None]()
    for _ in range(80):
        drawn = rng.permutation(len(field.goals))
        leaves = [drawn[:1].tolist(), drawn[1:3].tolist(), drawn[3 : rng.integers(4, 6)].tolist()]
        leaves = leaves[: rng.integers(1, 4)]
        order, refused = rng.permutation(len(positions))[:6], np.zeros(len(REFUSALS), np.int64)
        reasons = [expected_refusal(field, positions[k], leaves, lengths) for k in order]
        count = reasons.index(None) if None in reasons else len(reasons)
        found = starts.first_fit(Leaves(leaves), order, APART, lengths, refused)
        assert Counter(reasons[:count]) == Counter(dict(zip(REFUSALS, refused.tolist(), strict=True)))
        seen.update(reasons)
        assert (found is None) == (None not in reasons)
        if found is not None:
            assert found.refused == count
            start = positions[order[count]]
            for (route, distance, goals), leaf in zip(found.leaves, leaves, strict=True):
                expected = expected_route(field, start, leaf)
                np.testing.assert_array_equal(route.stops, expected.stops)
                np.testing.assert_array_equal(route.path, expected.path)
                assert route.length == expected.length
                away, points = distances(field, start, leaf[-1])
                assert distance == away.min()
                np.testing.assert_array_equal(goals[0], points[away.argmin()])
                np.testing.assert_array_equal(goals[1:], np.delete(points, away.argmin(), axis=0))
    wanted = {None, *REFUSALS} - ({"route_missed"} if lengths is None else set())
    assert set(seen) == wanted


def distances(field: GoalField, start: np.ndarray, goal: int) -> tuple[np.ndarray, np.ndarray]:
    """The geodesic distance (k,) to each goal point of an object, and the points (k, 3)."""
    points = list(field.goals.values())[goal]
    return np.array([field.pathfinder.geodesic_distance(start, point) for point in points]), points


def expected_starts(
    field: GoalField, positions: np.ndarray, leaves: Sequence[Sequence[int]], bounds: Bounds
) -> list[int] | str:
    """The rules one after the other, for all starts."""
    away = np.array([[distances(field, at, k)[0].min() for k in range(len(field.goals))] for at in positions])
    goals, stops = [leaf[-1] for leaf in leaves], [stop for leaf in leaves for stop in leaf]
    left = np.flatnonzero(
        (away[:, stops] > bounds.near).all(axis=1)
        & ((away[:, goals] >= bounds.low) & (away[:, goals] <= bounds.high)).all(axis=1)
    ).tolist()
    if not left:
        return "no_start_in_range"

    def is_detour(start: int, leaf: Sequence[int]) -> bool:
        route = expected_route(field, positions[start], leaf)
        return len(leaf) > 1 and (route is None or route.length > bounds.factor * away[start, leaf[-1]] + bounds.slack)

    if bounds.factor < np.inf:
        left = [start for start in left if not any(is_detour(start, leaf) for leaf in leaves)]
    if not left:
        return "detour"
    left = [
        start
        for start in left
        if (away[start, goals] <= bounds.most).all()
        and all(away[start, leaf[-1]] >= bounds.least for leaf in leaves if len(leaf) == 1)
    ]
    return left or "route_missed"


def test_possible_starts_and_unmet_rules_are_those_of_single_queries(floor, field, positions, monkeypatch) -> None:
    monkeypatch.setattr(module, "WAYS", 4)  # so that the room for ways is doubled many times
    monkeypatch.setattr(module, "CORNERS", 300)
    starts, rng, seen = Starts(floor, field, positions, SOLID), np.random.default_rng(6), Counter[str]()
    for number in range(120):
        drawn = rng.permutation(len(field.goals) if number % 3 else len(field.goals) - 1).tolist()
        leaves = [drawn[:1], drawn[1:3], drawn[3 : rng.integers(4, 6)]][: rng.integers(1, 4)]
        bounds = Bounds(
            near=rng.choice([0.3, 1.5, 3.0]),
            low=rng.choice([0.5, 2.0]),
            high=rng.choice([4.0, 7.0, 12.0]),
            factor=rng.choice([1.0, 1.5, np.inf]),
            slack=rng.choice([0.0, 1.0]),
            least=rng.choice([-np.inf, 3.0]),
            most=rng.choice([np.inf, 4.0]),
        )
        expected = expected_starts(field, positions, leaves, bounds)
        found = starts.possible(Leaves(leaves), bounds)
        seen[expected if isinstance(expected, str) else "possible"] += 1
        assert (found if isinstance(found, str) else found.tolist()) == expected
    assert set(seen) == {"possible", "no_start_in_range", "detour", "route_missed"}
