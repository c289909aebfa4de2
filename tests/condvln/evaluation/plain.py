"""The metrics once more, in plain Python from their definitions, sharing nothing with the package but its data
classes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise, product
from typing import Any

from schemas.program import Program

Point = tuple[float, float, float]
Distance = Callable[[Point, Point], float]


def euclid(a: Sequence[float], b: Sequence[float]) -> float:
    return math.sqrt(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)))


def length(path: Sequence[Point]) -> float:
    return sum(euclid(a, b) for a, b in pairwise(path))


def dtw(path: Sequence[Point], reference: Sequence[Point], distance: Distance = euclid) -> float:
    """The recursion of the definition."""

    @cache
    def cost(i: int, j: int) -> float:
        if i < 0 and j < 0:
            return 0.0
        if i < 0 or j < 0:
            return math.inf
        return distance(path[i], reference[j]) + min(cost(i - 1, j), cost(i, j - 1), cost(i - 1, j - 1))

    return cost(len(path) - 1, len(reference) - 1)


def no_repeats(path: Sequence[Point]) -> list[Point]:
    kept: list[Point] = []
    for point in path:
        if not kept or kept[-1] != point:
            kept.append(point)
    return kept


def ndtw(path: Sequence[Point], reference: Sequence[Point], tau: float) -> float:
    return math.exp(-dtw(no_repeats(path), reference) / (len(reference) * tau))


def cls(path: Sequence[Point], reference: Sequence[Point], tau: float, walked: float | None = None) -> float:
    coverage = sum(math.exp(-min(euclid(r, p) for p in path) / tau) for r in reference) / len(reference)
    walked = length(path) if walked is None else walked
    if math.isinf(walked):
        return 0.0
    expected = coverage * length(reference)
    if expected == 0 and walked == 0:
        return coverage
    return coverage * expected / (expected + abs(expected - walked))


def spl(success: bool, shortest: float, walked: float) -> float:
    if not success or math.isinf(shortest):
        return 0.0
    if shortest < 1e-6 and walked < 1e-6:
        return 1.0
    return shortest / max(shortest, walked)


def bsa_geodesic(path: Sequence[Point], subgoals: Sequence[Point], tau: float, distance: Distance) -> float:
    """Longest prefix k for which times t_1 <= … <= t_k exist, each within reach: tried by brute force."""
    best = 0
    for k in range(1, len(subgoals) + 1):
        times = [{t for t, p in enumerate(path) if distance(p, g) < tau} for g in subgoals[:k]]
        earliest = 0
        for reached in times:
            later = [t for t in reached if t >= earliest]
            if not later:
                break
            earliest = min(later)
        else:
            best = k
    return best / len(subgoals)


def bsa_authors(path: Sequence[Point], subgoals: Sequence[Point], tau: float) -> float:
    pointer = 0
    for p in path:
        if pointer < len(subgoals) and euclid(p, subgoals[pointer]) <= tau:
            pointer += 1
    return pointer / len(subgoals)


def bsa_any_order(path: Sequence[Point], subgoals: Sequence[Point], tau: float) -> float:
    reached = [False] * len(subgoals)
    for p in path:
        for number, subgoal in enumerate(subgoals):
            reached[number] = reached[number] or euclid(p, subgoal) <= tau
    return sum(reached) / len(reached)


def leaf_of(stopped: bool, end: Point, leaves: Sequence[Sequence[Point]], tau: float, distance: Distance) -> int:
    if not stopped:
        return -1
    near = [(min(distance(end, g) for g in goals), number) for number, goals in enumerate(leaves)]
    near = [(d, number) for d, number in near if d < tau]
    return min(near)[1] if near else -1


def in_time(
    path: Sequence[Point],
    decided: Sequence[int | None],
    program: Program,
    leaves: Sequence[dict[str, Any]],
    tau: float,
    distance: Distance,
) -> bool:
    """Whether each condition of the gold route is decided before the path comes near a stop or goal that only leaves
    with its answer have, tried over all truths of the conditions. No two leaves have one goal.
    """
    asked = [*dict.fromkeys(program.route()[0])]
    for at, (number, pose) in enumerate(zip(asked, decided, strict=True)):
        stops: dict[bool, set[Point]] = {True: set(), False: set()}
        goals: set[Point] = set()
        for truths in product((True, False), repeat=len(program.conditions)):
            if all(truths[k] == program.conditions[k].truth for k in asked[:at]):
                right = truths[number] == program.conditions[number].truth
                leaf = leaves[program.route(truths)[1]]
                stops[right] |= {*leaf["subgoals"]}
                goals |= {*leaf["goals"]} if right else set()
        only = (stops[True] - stops[False]) | goals
        near = [t for t, p in enumerate(path) if any(distance(p, place) < tau for place in only)]
        if pose is None or (near and near[0] <= pose):
            return False
    return True


def judge(
    path: Sequence[Point],
    stopped: bool,
    *,
    start: Point,
    leaves: Sequence[dict[str, Any]],
    gold: int,
    reference: Sequence[Point],
    tau: float,
    max_steps: int | None,
    distance: Distance,
    mode: str = "geodesic",
    program: Program,
    looking: tuple[Sequence[Point], float] | None,
    decided: Sequence[int | None] | None,
) -> dict[str, float]:
    """Every measure of one episode.

    looking : dense locations of the looking path, and its length
    decided : for each condition of the gold route, the pose at which it is decided
    """
    if max_steps is not None and len(path) - 1 > max_steps:
        path, stopped = path[: max_steps + 1], False
    goals, subgoals = leaves[gold]["goals"], leaves[gold]["subgoals"]
    to_goal = [min(distance(p, g) for g in goals) for p in path]
    success = stopped and to_goal[-1] < tau
    if not subgoals:
        bsa_all = float(success)
        bsa = 1.0 if success else math.nan
    else:
        bsa = bsa_all = {
            "geodesic": lambda: bsa_geodesic(path, subgoals, tau, distance),
            "euclidean": lambda: bsa_authors(path, subgoals, tau),
            "euclidean-any-order": lambda: bsa_any_order(path, subgoals, tau),
        }[mode]()
    far = [math.hypot(a[0] - b[0], a[2] - b[2]) > 0.3325 or abs(a[1] - b[1]) > 0.5 for a, b in pairwise(path)]
    total = sum(distance(a, b) if gap else euclid(a, b) for gap, (a, b) in zip(far, pairwise(path), strict=True))
    leaf = leaf_of(stopped, path[-1], [leaf["goals"] for leaf in leaves], tau, distance)
    near = ndtw(path, reference, 3.0)
    return {
        "path_length": total if math.isfinite(total) else math.nan,
        "navigation_error": to_goal[-1] if math.isfinite(to_goal[-1]) else min(euclid(path[-1], g) for g in goals),
        "success": float(success),
        "oracle_success": float(any(d < tau for d in to_goal)),
        "spl": spl(success, min(distance(start, g) for g in goals), total),
        "spl_route": spl(success, leaves[gold]["route_length"], total),
        "ndtw": near,
        "sdtw": near if success else 0.0,
        "cls": cls(path, reference, 3.0, total),
        "spl_look": math.nan if looking is None else spl(success, looking[1], total),
        "ndtw_look": math.nan if looking is None else ndtw(path, looking[0], 3.0),
        "sdtw_look": math.nan if looking is None else success * ndtw(path, looking[0], 3.0),
        "cls_look": math.nan if looking is None else cls(path, looking[0], 3.0, total),
        "justified": math.nan
        if decided is None
        else float(success and in_time(path, decided, program, leaves, tau, distance)),
        "bsa": bsa,
        "csr": math.nan if math.isnan(bsa) else float(success and bsa == 1),
        "bsa_all": bsa_all,
        "csr_all": float(success and bsa_all == 1),
        "committed_leaf": leaf,
        "leaf_correct": float(leaf == gold),
        "wrong_branch": float(leaf not in (gold, -1)),
        "no_commit": float(leaf == -1),
        "unreachable": float(not math.isfinite(to_goal[-1])),
        "stopped": float(stopped),
        "gaps": float(sum(far)),
    }
