"""Episodes as an OpenEnv server; needs the extra ``openenv``.

A client over WebSocket has an environment of its own. For each plain HTTP request OpenEnv makes a new environment and
closes it afterwards, so an episode that a closed environment has begun is kept for the next request. Such episodes are
told apart by their id: two clients that walk the same episode over plain HTTP at the same time share it.
"""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import Any, Literal

from pydantic import Field

from condvln.evaluation.environment.tools import EpisodeTools
from schemas.errors import UsageError

try:
    from openenv.core.env_server import Action, Environment, Observation, State, create_app
except ImportError as error:
    raise UsageError("openenv is not installed", remedy="Install condvln[openenv]") from error

__all__ = ["NavigationAction", "NavigationEnvironment", "NavigationObservation", "application"]


class NavigationAction(Action):  # type: ignore[misc]
    """One call of a tool of `EpisodeTools`."""

    tool: Literal["forward", "turn", "look", "stop"]
    steps: int = Field(1, description="number of steps, for the tool forward")
    degrees: int = Field(0, description="angle in degrees, for the tool turn; positive is to the right")


class NavigationObservation(Observation):  # type: ignore[misc]
    """What the agent sees, as text, and the instruction."""

    text: str
    instruction: str
    episode_id: str
    steps_left: int


class KeptEpisodes:
    """The latest episodes whose environment was closed before their end, by id; at most ``most``."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._episodes: OrderedDict[str, EpisodeTools] = OrderedDict()
        self._lock = Lock()

    def keep(self, episode: EpisodeTools) -> None:
        """Keep an episode for the next request."""
        with self._lock:
            self._episodes[episode.episode_id] = episode
            self._episodes.move_to_end(episode.episode_id)
            if len(self._episodes) > self._most:
                self._episodes.popitem(last=False)

    def take(self, episode_id: str | None) -> EpisodeTools | None:
        """Return the episode of that id, or the latest one, and forget it; None if there is none."""
        with self._lock:
            if episode_id is None and self._episodes:
                return self._episodes.popitem()[1]
            return self._episodes.pop(str(episode_id), None)


class NavigationEnvironment(Environment):  # type: ignore[misc]
    """One session, with one episode at a time. The reward is that of `EpisodeTools`. For an invalid call, the
    observation states the reason.

    Parameters
    ----------
    kept : where the episode is put if the environment is closed before its end, and looked for if none has begun here
    """

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, tools: type[EpisodeTools], kept: KeptEpisodes | None = None) -> None:
        super().__init__()
        self._tools = tools()
        self._kept = kept

    def reset(self, seed: int | None = None, episode_id: str | None = None, **row: Any) -> NavigationObservation:
        """Begin the episode `episode_id`, or the next one if no id is given. `seed` and all further arguments are
        ignored.
        """
        return self._observation(self._tools.reset(episode_id))

    def step(
        self,
        action: NavigationAction,
        timeout_s: float | None = None,
        episode_id: str | None = None,
        **options: Any,
    ) -> NavigationObservation:
        """Call one tool and return the observation.

        episode_id : the episode that a plain HTTP request goes on with; by default the one that was last begun
        """
        tools = self._begun(episode_id)
        try:
            arguments = {"forward": (action.steps,), "turn": (action.degrees,)}.get(action.tool, ())
            text = getattr(tools, action.tool)(*arguments)
        except (ValueError, UsageError) as fault:
            text = str(fault)
        return self._observation(text)

    @property
    def state(self) -> State:
        """The episode and the number of steps taken."""
        tools = self._begun(None)
        if not tools.episode_id:
            return State()
        return State(episode_id=tools.episode_id, step_count=len(tools.prediction.positions) - 1)

    def close(self) -> None:
        """Keep an episode that has begun and is not over."""
        if self._kept is not None and self._tools.episode_id and not self._tools.done:
            self._kept.keep(self._tools)

    def _begun(self, episode_id: str | None) -> EpisodeTools:
        """Return the tools of the episode here, or of one that another environment has begun."""
        if not self._tools.episode_id and self._kept is not None:
            self._tools = self._kept.take(episode_id) or self._tools
        return self._tools

    def _observation(self, text: str) -> NavigationObservation:
        tools = self._tools
        return NavigationObservation(
            text=text,
            instruction=tools.instruction,
            episode_id=tools.episode_id,
            steps_left=tools.steps_left,
            done=tools.done,
            reward=tools.reward if tools.done else None,
        )


def application(tools: type[EpisodeTools], sessions: int = 8) -> Any:
    """Return the FastAPI application that serves a split.

    Parameters
    ----------
    tools : the split's, from `tools_for`
    sessions : largest number of simultaneous sessions
    """
    kept = KeptEpisodes(sessions)
    return create_app(
        lambda: NavigationEnvironment(tools, kept),
        NavigationAction,
        NavigationObservation,
        env_name="condvln",
        max_concurrent_envs=sessions,
    )
