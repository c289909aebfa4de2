"""The measures of a path against a goal, a reference or a program's branches, as pure functions.

Formulas as in habitat-lab (``tasks/nav/nav.py``), VLN-CE (``habitat_extensions/measures.py``), Ilharco et al. 2019
(nDTW, SDTW) and Jain et al. 2019 (CLS); docs/metrics.md says where published evaluators differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
import shapely
from scipy.spatial import cKDTree

from condvln.arrays import F64
from condvln.evaluation.goal_distances import Nearness, SnappedPath
from schemas.errors import UsageError
from schemas.program import Program, leaf_truths

__all__ = [
    "FIDELITY_DISTANCE",
    "NO_LEAF",
    "DistanceMode",
    "cls",
    "committed_leaf",
    "dtw",
    "dtw_of_costs",
    "first_divergence",
    "length_weighted",
    "ndtw",
    "path_length",
    "reached_in_any_order_euclidean",
    "reached_in_order",
    "reached_in_order_euclidean",
    "spl",
    "without_repeats",
]


FIDELITY_DISTANCE: Final = 3.0
"""Metres; the distance threshold of nDTW and CLS in R2R and VLN-CE, independent of the success distance."""

ROOM_HEIGHT: Final = 1.0
"""Largest difference in metres between the heights of a position and of a lead's point, on the floor of one room."""

_NOTHING: Final = 1e-6
"""Length in metres below which a path counts as having no length."""


def path_length(positions: F64) -> float:
    """Return the sum of the Euclidean steps of a path (n, 3), in metres."""
    return float(np.sqrt(np.square(np.diff(positions, axis=0)).sum(axis=1)).sum())


def without_repeats(positions: F64) -> F64:
    """Return a path without consecutive equal points. Turning on the spot creates such points."""
    if len(positions) == 0:
        return positions
    moved = (np.diff(positions, axis=0) != 0).any(axis=1)
    return positions[np.concatenate(([True], moved))]


def spl(success: bool, shortest: float, length: float) -> float:
    """Return success weighted by path length (Anderson et al. 2018): S · L ÷ max(L, P), where S is 1 for a success and
    otherwise 0, L is `shortest` and P is `length`.

    An unreachable goal gives 0, and a start at the goal without any step gives S; the plain quotient would give NaN.
    """
    if not success or not np.isfinite(shortest):
        return 0.0
    if shortest < _NOTHING and length < _NOTHING:
        return 1.0
    return shortest / max(shortest, length)


def ndtw(path: F64, reference: F64, distance: float = FIDELITY_DISTANCE, *, fast: bool = False) -> float:
    """Return the normalised dynamic time warping: exp(−DTW(P, R) ÷ (|R| · d)), where P is `path`, R is `reference` and
    d is `distance` in metres.

    Parameters
    ----------
    path : (n, 3) positions, n ≥ 1; points equal to their predecessor are dropped
    reference : (m, 3) dense locations
    fast : VLN-CE's approximation (package ``fastdtw``, radius 1), whose sum is never below the exact one

    Raises
    ------
    UsageError : `fast`, and the package is not installed
    """
    total = (_fast_dtw if fast else dtw)(without_repeats(path), reference)
    return float(np.exp(-total / (len(reference) * distance)))


def dtw(path: F64, reference: F64) -> float:
    """Return the least sum of Euclidean distances, in metres, over all monotone alignments of two paths (n, 3) and
    (m, 3).
    """
    one, other = sorted((path, reference), key=len)
    return _least_sum(
        lambda rows, columns: np.sqrt(np.square(one[rows] - other[columns]).sum(axis=1)), len(one), len(other)
    )


def dtw_of_costs(costs: F64) -> float:
    """Return the same sum as :func:`dtw`, computed from given distances (n, m) between the points, such as distances on
    a graph.
    """
    return _least_sum(lambda rows, columns: costs[rows, columns], *costs.shape)


def _least_sum(cost: Callable[[npt.NDArray[np.intp], npt.NDArray[np.intp]], F64], n: int, m: int) -> float:
    """Return the least sum of the costs on a monotone path through a table (n, m), from its first to its last cell.

    The table is filled by diagonals, whose cells do not depend on each other; the last three are kept.
    """
    before, last = np.full((2, n + 1), np.inf)
    before[0] = 0.0
    for diagonal in range(n + m - 1):
        rows = np.arange(max(0, diagonal - m + 1), min(n, diagonal + 1))
        sums = np.full(n + 1, np.inf)
        least = np.minimum(np.minimum(last[rows], last[rows + 1]), before[rows])
        sums[rows + 1] = least + cost(rows, diagonal - rows)
        before, last = last, sums
    return float(last[n])


def _fast_dtw(path: F64, reference: F64) -> float:
    try:
        from fastdtw import fastdtw
    except ImportError as error:
        raise UsageError("fastdtw is not installed", remedy="Install condvln[fastdtw]") from error
    return float(fastdtw(path, reference, radius=1, dist=2)[0])


def cls(path: F64, reference: F64, distance: float = FIDELITY_DISTANCE, *, length: float | None = None) -> float:
    """Return the coverage weighted by length score (CLS). ``length`` is that of the path in metres, by default the sum
    of its straight steps.

    Coverage is the mean over the reference of exp(−distance to the path ÷ `distance`). The length score compares the
    path's length with coverage × the reference's length. If both lengths are 0, the score is the coverage.
    """
    near = np.asarray(cKDTree(path).query(reference)[0])
    length = path_length(path) if length is None else length
    return length_weighted(float(np.exp(-near / distance).mean()), path_length(reference), length)


def length_weighted(coverage: float, reference_length: float, length: float) -> float:
    """Return CLS, computed from the coverage and from the lengths in metres of the reference and of the path; 0 if one
    of them is infinite.
    """
    if not np.isfinite(reference_length + length):
        return 0.0
    expected = coverage * reference_length
    total = expected + abs(expected - length)
    return coverage if total == 0 else coverage * expected / total


NO_LEAF: Final = -1
"""Value for an agent that stopped at no leaf, or did not stop."""


def committed_leaf(distances: Sequence[float], radius: float) -> int:
    """Return the index of the nearest leaf if it is less than ``radius`` metres away, else :data:`NO_LEAF`.

    distances : metres from the stop position to each leaf
    """
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] < radius else NO_LEAF


def first_divergence(program: Program, gold: int, committed: int) -> int | None:
    """Return how many conditions of the gold path the agent answered correctly before its first wrong answer; None if
    all are correct.

    The condition with the wrong answer is ``leaf_truths(program.category)[gold][n][0]`` for the result n.
    """
    if committed in (gold, NO_LEAF):
        return None
    right, taken = (leaf_truths(program.category)[leaf] for leaf in (gold, committed))
    return next(place for place, (a, b) in enumerate(zip(right, taken, strict=False)) if a != b)


DistanceMode = Literal["geodesic", "euclidean", "euclidean-any-order"]
"""How subgoals are judged: in order by geodesic distance (a ball would reach through walls), in order by straight lines
as in the authors' fork of Open-Nav, or in any order by straight lines as in their fork of VLN-Zero.
"""


def reached_in_order(
    nearness: Nearness, path: SnappedPath, subgoals: F64, radius: float, outlines: Sequence[F64 | None] = ()
) -> int:
    """Return the length of the longest prefix of ``subgoals`` (m, 3) reached in order, within a geodesic ``radius``
    (metres) or in the room of a lead.

    One position may reach several subgoals; the start counts.

    outlines : of each subgoal, the corners (k, 2) of a room, x and z, in which it is reached anywhere on its floor;
        None for a point
    """

    def first(k: int, at: int) -> int | None:
        found = [nearness.first_within(path, subgoals[k], radius, at)]
        if k < len(outlines) and (outline := outlines[k]) is not None:
            found.append(_first_inside(path.positions, outline, subgoals[k], at))
        return min((one for one in found if one is not None), default=None)

    return prefix_in_order(len(subgoals), first)


def _first_inside(positions: F64, outline: F64, subgoal: F64, begin: int) -> int | None:
    """Return the first of ``positions`` (n, 3), from index ``begin`` on, on the floor of the subgoal's room."""
    room = shapely.make_valid(shapely.Polygon(outline))
    level = np.abs(positions[begin:, 1] - subgoal[1]) <= ROOM_HEIGHT
    inside = np.flatnonzero(level & shapely.covers(room, shapely.points(positions[begin:, ::2])))
    return begin + int(inside[0]) if len(inside) else None


def prefix_in_order(subgoals: int, first_from: Callable[[int, int], int | None]) -> int:
    """Return the length of the longest prefix of so many subgoals that are reached in order.

    first_from : returns the first position at which a subgoal (its number) is reached from a position on, None if it
        is not
    """
    at = 0
    for number in range(subgoals):
        found = first_from(number, at)
        if found is None:
            return number
        at = found
    return subgoals


def reached_in_order_euclidean(positions: F64, subgoals: F64, radius: float) -> int:
    """Return the number of subgoals reached in order, as the authors' fork of Open-Nav counts them: a subgoal is
    reached at a straight-line distance in 3-D of at most ``radius`` metres, and one pose reaches at most one subgoal.
    Compare :func:`reached_in_order`.
    """
    reached = 0
    for position in positions:
        if reached == len(subgoals):
            break
        reached += bool(np.sqrt(np.square(position - subgoals[reached]).sum()) <= radius)
    return reached


def reached_in_any_order_euclidean(positions: F64, subgoals: F64, radius: float) -> int:
    """Return the number of subgoals reached in any order, as the authors' fork of VLN-Zero counts them: a subgoal is
    reached at a straight-line distance in 3-D of at most ``radius`` metres, and one pose may reach several subgoals.
    """
    if len(subgoals) == 0:
        return 0
    squares = np.square(positions[:, None] - subgoals).sum(axis=2)
    return int((np.sqrt(squares) <= radius).any(axis=0).sum())
