"""Turn a target of the looker agent into its next action."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from condvln.evaluation.looker.floor_map import CELL, F64, Ground, Ways
from condvln.navigation.follower import FORWARD, LEFT, RIGHT, VLN_CE

__all__ = ["ARRIVED", "HALF_TURN", "Steering"]

ARRIVED: Final = 0.2
"""Distance in metres at which a position counts as reached."""
AHEAD: Final = 2.0
"""Largest length in metres of a shortcut along its path, if the straight line is free."""
HALF_TURN: Final = math.radians(VLN_CE.turn) / 2
FREE: Final = 0.6
"""Length in metres of the free floor straight ahead for which it goes on although its target is a little aside."""
LENIENT: Final = 2.0
"""Half turns by which the target may then be aside."""
EASY: Final = 1.5
"""Cost of a cell above which floor does not count as free."""
PATIENT: Final = 24
"""Number of steps without progress after which it chooses another target."""
LONGER: Final = 5.0
"""Cost in cells by which the path must be longer than ever before for it to count as a detour."""


class Steering:
    """Steers the agent to one target after another, and keeps track of its progress towards the current target."""

    def __init__(self) -> None:
        self._goal: object = None
        self._best, self._most, self._since = math.inf, 0.0, 0

    def begin(self, step: int, goal: object = None) -> None:
        """Begin with a new target; `step` is the number of the agent's current step.

        Targets in a row with an equal `goal` other than None count as one whose place was corrected: what the agent
        gained towards the former ones is kept.
        """
        if goal is None or goal != self._goal:
            self._goal = goal
            self._best, self._most, self._since = math.inf, 0.0, step

    def action(self, aim: F64, here: F64, heading: float, ground: Ground, ways: Ways, step: int) -> int | None:
        """Return the action that leads from `here` (2,) towards the position `aim` (2,); None if `aim` is unreachable,
        or if the agent makes no progress.
        """
        cell = ground.cell(float(aim[0]), float(aim[1]))
        path, length = ways.to(cell), float(ways.distance[cell])
        if not np.isfinite(length) or len(path) < 2:
            return None
        if length < self._best - 1 or length > self._most + LONGER:
            self._best, self._since = length, step
        elif step - self._since > PATIENT:
            return None
        self._most = max(self._most, length)
        towards = path[1]
        for point in path[2:]:
            if np.hypot(*(point - here)) > AHEAD or not ground.open_between(here, point):
                break
            towards = point
        away = towards - here
        if np.hypot(*away) < CELL and len(path) > 2:
            away = path[2] - here
        wanted = math.atan2(-away[0], -away[1])
        off = (wanted - heading + math.pi) % (2 * math.pi) - math.pi
        if abs(off) <= HALF_TURN + 1e-9:
            return FORWARD
        if abs(off) <= LENIENT * HALF_TURN and np.hypot(*away) > FREE and length * CELL > 2 * FREE:
            ahead = here - FREE * np.array([math.sin(heading), math.cos(heading)])
            if ground.open_between(here, ahead, among=ground.cost > EASY):
                return FORWARD
        return LEFT if off > 0 else RIGHT
