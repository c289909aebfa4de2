"""What agents did: the outcome of each episode, and walks with the distance to the goal at each pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from condvln.evaluation.evaluate import Evaluation
from condvln.evaluation.predictions import Prediction
from condvln.navigation.protocol import PathfinderProtocol

__all__ = ["OUTCOMES", "AgentResults", "outcomes", "walk_document"]

Document = dict[str, Any]
OUTCOMES: Final = ("not scored", "success", "wrong branch", "no commit", "right leaf, failed", "no prediction")
"""What became of an episode. The page lists them in this order; an agent has a number of them per episode."""
_SHOWN: Final = ("spl", "navigation_error", "ndtw", "bsa_all", "steps", "committed_leaf", "path_length")


@dataclass(frozen=True, eq=False)
class AgentResults:
    """One agent's scores on one split.

    episodes : by episode id, the number of the outcome and the shown scores
    """

    name: str
    split: str
    episodes: dict[str, tuple[int, Document]]

    @classmethod
    def of(cls, evaluation: Evaluation, split: str) -> AgentResults:
        """Return the results of an evaluation."""
        numbers = outcomes(evaluation)
        rows = {}
        for k, name in enumerate(evaluation.episode_ids):
            scores = {measure: _finite(evaluation.scores[measure][k]) for measure in _SHOWN}
            rows[name] = (int(numbers[k]), scores)
        return cls(evaluation.agent, split, rows)


def outcomes(evaluation: Evaluation) -> NDArray[np.int64]:
    """Return, for each episode, the index of its outcome in :data:`OUTCOMES`, (n,)."""
    scores = evaluation.scores
    cases = [
        (scores["missing"] == 1, "no prediction"),
        (scores["success"] == 1, "success"),
        (scores["wrong_branch"] == 1, "wrong branch"),
        (scores["no_commit"] == 1, "no commit"),
    ]
    numbers = [OUTCOMES.index(name) for _, name in cases]
    return np.select([mask for mask, _ in cases], numbers, OUTCOMES.index("right leaf, failed")).astype(np.int64)


def walk_document(
    prediction: Prediction, goals: Sequence[Sequence[float]], pathfinder: PathfinderProtocol | None
) -> Document:
    """Return an agent's walk of one episode.

    Parameters
    ----------
    goals : goal points of the gold leaf, metres
    pathfinder : measures geodesic distances; without it the page shows straight ones

    Returns
    -------
    ``path``: x, y, z of each pose, metres; ``distance``: metres to the nearest goal from each pose, null where no way
    leads there; ``headings``: degrees clockwise from north, where the file has them; ``stopped``.
    """
    positions = np.asarray(prediction.positions, dtype=np.float64)
    distances = _distances(positions, np.asarray(goals, dtype=np.float64), pathfinder)
    headings = prediction.headings
    return {
        "path": np.round(positions, 2).tolist(),
        "distance": [_finite(value, 2) for value in distances],
        "geodesic": pathfinder is not None,
        "headings": None if headings is None else np.round(-np.degrees(headings) % 360.0).tolist(),
        "stopped": prediction.stopped,
    }


def _distances(
    positions: NDArray[np.float64], goals: NDArray[np.float64], pathfinder: PathfinderProtocol | None
) -> NDArray[np.float64]:
    if not len(positions):
        return np.zeros(0)
    if pathfinder is None:
        apart = np.linalg.norm(positions[:, None] - goals[None], axis=2)
        return np.asarray(apart.min(axis=1))
    once, back = np.unique(positions, axis=0, return_inverse=True)  # turning does not change the position
    nearest: NDArray[np.float64] = np.asarray(pathfinder.distance_table(once, goals), dtype=np.float64).min(axis=1)
    return nearest[back.ravel()]


def _finite(value: float, decimals: int = 4) -> float | None:
    return round(float(value), decimals) if np.isfinite(value) else None
