"""Ground-truth actions: the walk of an agent that knows the map, in VLN-CE's action space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from condvln.navigation.kernels.following import (
    ARRIVED,
    FORWARD,
    LEFT,
    NO_PATH,
    RIGHT,
    STOP,
    STUCK,
    TOO_LONG,
    Gait,
    Limits,
)
from condvln.navigation.kernels.following import follow as follow_kernel
from condvln.navigation.kernels.following import replay as replay_kernel
from condvln.navigation.kernels.mesh import QueryMesh
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.points import many_points, one_point
from condvln.navigation.tile import Floats, Indices
from schemas.errors import UsageError

__all__ = [
    "FORWARD",
    "LEFT",
    "RIGHT",
    "RXR",
    "STOP",
    "VLN_CE",
    "ActionSpace",
    "FollowedRoute",
    "Follower",
    "Length",
    "SteppedWalk",
    "Walk",
]

OUTCOMES = {ARRIVED: "arrived", NO_PATH: "no path", STUCK: "stuck", TOO_LONG: "too long"}
# A walk of more actions than this is an error in the goals; episodes end at 500.
MAX_ACTIONS = 5000


@dataclass(frozen=True)
class ActionSpace:
    """Discrete actions: STOP 0, FORWARD 1, LEFT 2 (counter-clockwise), RIGHT 3."""

    forward: float = 0.25
    """metres"""
    turn: float = 15.0
    """degrees; divides 360"""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.forward) and self.forward > 0):
            raise UsageError(
                f"the forward step must be positive and finite, got {self.forward} m", remedy="Give a positive length"
            )
        if not (math.isfinite(self.turn) and self.turn > 0 and (360.0 / self.turn).is_integer()):
            raise UsageError(
                f"the turn must divide 360°, got {self.turn}°",
                remedy="Give an angle that divides 360, such as 15 or 30",
            )

    @property
    def headings(self) -> int:
        """Number of headings reachable by turning on the spot."""
        return round(360.0 / self.turn)


VLN_CE = ActionSpace()
RXR = ActionSpace(turn=30.0)


@dataclass(frozen=True, eq=False)
class Walk:
    """The poses of a walk.

    Attributes
    ----------
    positions : (n + 1, 3) float32, before the first of n actions and after each
    headings : (n + 1,) radians in [0, 2π), counter-clockwise, 0 facing −z
    """

    positions: Floats
    headings: npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FollowedRoute:
    """A walk to one or more goals, as ``_gt`` files hold it.

    Attributes
    ----------
    actions : (n,) int8; the last one is STOP
    locations : (forward_steps + 1, 3) float32, metres: the start and the place after each forward step
    arrivals : (g,) index into ``locations`` at which each goal was reached, -1 if it was not
    distance_to_goal : remaining geodesic distance in metres to the last goal
    outcome : "arrived", "no path", "stuck" or "too long"
    """

    actions: npt.NDArray[np.int8]
    locations: Floats
    arrivals: Indices
    distance_to_goal: float
    outcome: str

    @property
    def arrived(self) -> bool:
        """Whether all goals were reached."""
        return self.outcome == "arrived"


class Length(NamedTuple):
    """The number of actions of a walk, the last STOP included, and its outcome as in `FollowedRoute`."""

    actions: int
    outcome: str

    @property
    def arrived(self) -> bool:
        """Whether all goals were reached."""
        return self.outcome == OUTCOMES[ARRIVED]


class Follower:
    """Walks along geodesics of a navmesh to goals.

    Parameters
    ----------
    pathfinder : the navmesh
    space : forward step and turn
    sliding : slide along walls (R2R in VLN-CE) or stop at them (RxR)
    stop_within : geodesic metres from a goal at which it counts as reached
    arrive_within : geodesic metres at which it still counts as reached if no action leads nearer
    max_actions : number of actions after which the walk is aborted

    Raises
    ------
    UsageError : a distance or the number of actions is out of range
    """

    def __init__(
        self,
        pathfinder: Pathfinder,
        space: ActionSpace = VLN_CE,
        *,
        sliding: bool = True,
        stop_within: float = 0.25,
        arrive_within: float = 0.5,
        max_actions: int = MAX_ACTIONS,
    ) -> None:
        if not 0 < stop_within <= arrive_within or not math.isfinite(arrive_within):
            raise UsageError(
                f"the distances are out of order: stop_within {stop_within} m, arrive_within {arrive_within} m",
                remedy="Give 0 < stop_within <= arrive_within",
            )
        if not 0 < max_actions <= 1_000_000:
            raise UsageError(f"max_actions is out of range: {max_actions}", remedy="Give 1 to 1,000,000")
        self.pathfinder, self.space, self.sliding = pathfinder, space, sliding
        self.stop_within, self.arrive_within, self.max_actions = stop_within, arrive_within, max_actions

    def follow(self, start: npt.ArrayLike, heading: float, goals: npt.ArrayLike) -> FollowedRoute:
        """Walk from ``start`` (3,), facing ``heading`` (radians, counter-clockwise from −z), to each goal in turn.

        ``goals`` is one point (3,) or several (g, 3): subgoals first, the goal last.
        """
        first = self._follow(start, heading, goals, careful=False)
        if first.outcome != OUTCOMES[STUCK] or self.sliding:
            return first
        second = self._follow(start, heading, goals, careful=True)
        return second if second.arrived else first

    def _follow(self, start: npt.ArrayLike, heading: float, goals: npt.ArrayLike, *, careful: bool) -> FollowedRoute:
        actions, locations, arrivals, distance, status = follow_kernel(
            self.pathfinder.query_mesh,
            self._gait(heading),
            one_point(start)[0],
            many_points(np.atleast_2d(goals)),
            Limits(np.float32(self.stop_within), np.float32(self.arrive_within)),
            self.max_actions,
            careful,
        )
        return FollowedRoute(actions, locations, arrivals, float(distance), OUTCOMES[status])

    def walk(self, start: npt.ArrayLike, heading: float, actions: npt.ArrayLike) -> Walk:
        """Return the poses of an agent that takes ``actions`` (n,) from ``start``; STOP and unknown ids do not move the
        agent.
        """
        places, facing = replay_kernel(
            self.pathfinder.query_mesh, self._gait(heading), one_point(start)[0], np.array(actions, np.int8).reshape(-1)
        )
        return Walk(places, _headings(heading, facing, self.space))

    def turns_to(self, place: npt.ArrayLike, heading: float, target: npt.ArrayLike) -> list[int]:
        """Return the turns by which an agent at ``place`` (3,) faces ``target`` (3,), up to half a turn."""
        away = np.asarray(target, np.float64) - np.asarray(place, np.float64)
        off = math.remainder(math.atan2(-away[0], -away[2]) - heading, 2.0 * math.pi)
        return [LEFT if off > 0.0 else RIGHT] * round(abs(off) / math.radians(self.space.turn))

    def lengths(
        self,
        starts: npt.ArrayLike,
        headings: Sequence[float],
        goals: npt.NDArray[np.float64],
        goal_ends: Indices,
    ) -> list[Length]:
        """Return the length of each of n walks that :meth:`follow` makes, from ``starts`` (n, 3) to each walk's own
        goals: those of all walks are ``goals`` (g, 3), in which each walk's end at ``goal_ends`` (n,).
        """
        own = np.split(goals, goal_ends[:-1]) if len(headings) else []
        routes = map(self.follow, many_points(starts), headings, own)
        return [Length(len(route.actions), route.outcome) for route in routes]

    def stepped(self, start: npt.ArrayLike, heading: float) -> SteppedWalk:
        """Return a walk for an agent that chooses each action after seeing the current pose."""
        return SteppedWalk(self.pathfinder.query_mesh, self._gait(heading), one_point(start)[0], self.space)

    def _gait(self, heading: float) -> Gait:
        if not math.isfinite(heading):
            raise UsageError(f"the heading must be finite, got {heading}", remedy="Give radians")
        return _gait(float(heading), self.space, self.sliding)


@lru_cache(maxsize=1024)
def _gait(heading: float, space: ActionSpace, sliding: bool) -> Gait:
    turn = math.radians(space.turn)
    facing = [heading + k * turn for k in range(space.headings)]
    moves = [[-math.sin(angle) * space.forward, -math.cos(angle) * space.forward] for angle in facing]
    return Gait(np.array(moves, np.float32), heading, turn, np.float32(space.forward), sliding)


class SteppedWalk:
    """A walk that is executed one action at a time. Its poses equal those of :meth:`Follower.walk` bit for bit.

    Attributes
    ----------
    position : (3,) float32, metres
    """

    def __init__(self, mesh: QueryMesh, gait: Gait, start: Floats, space: ActionSpace) -> None:
        self.position = start
        self._mesh, self._gait, self._space = mesh, gait, space
        self._facing = 0
        # The displacements of two full turns: those that begin at any heading are a slice of them.
        self._moves = np.concatenate([gait.moves, gait.moves])

    @property
    def heading(self) -> float:
        """The agent's heading in radians, in [0, 2π): counter-clockwise, 0 facing −z."""
        return float(_headings(self._gait.first_heading, np.array(self._facing), self._space))

    def take(self, action: int) -> None:
        """Take one action; STOP and unknown ids do not move the agent."""
        gait = self._gait._replace(moves=self._moves[self._facing : self._facing + self._space.headings])
        places, turns = replay_kernel(self._mesh, gait, self.position, np.array([action], np.int8))
        self.position = places[1]
        self._facing = (self._facing + int(turns[1])) % self._space.headings


def _headings(first: float, facing: Indices, space: ActionSpace) -> npt.NDArray[np.float64]:
    """Return headings in radians within [0, 2π). ``first`` is the first heading, ``facing`` the number of turns from
    the first heading to each other heading.
    """
    turned: npt.NDArray[np.float64] = np.mod(first + facing * math.radians(space.turn), 2 * math.pi)
    return turned
