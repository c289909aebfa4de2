"""Episodes as an OpenEnv server; needs the extra ``openenv``."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from condvln.evaluation.tools import EpisodeTools
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


class NavigationEnvironment(Environment):  # type: ignore[misc]
    """One session, with one episode at a time. The reward is that of `EpisodeTools`. For an invalid call, the
    observation states the reason.
    """

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, tools: type[EpisodeTools]) -> None:
        super().__init__()
        self._tools = tools()

    def reset(self, seed: int | None = None, episode_id: str | None = None, **row: Any) -> NavigationObservation:
        """Begin the episode `episode_id`, or the next one if no id is given. `seed` and all further arguments are
        ignored.
        """
        return self._observation(self._tools.reset(episode_id))

    def step(self, action: NavigationAction, timeout_s: float | None = None, **options: Any) -> NavigationObservation:
        """Call one tool and return the observation."""
        tools = self._tools
        try:
            match action.tool:
                case "forward":
                    text = tools.forward(action.steps)
                case "turn":
                    text = tools.turn(action.degrees)
                case "look":
                    text = tools.look()
                case "stop":
                    text = tools.stop()
        except (ValueError, UsageError) as fault:
            text = str(fault)
        return self._observation(text)

    @property
    def state(self) -> State:
        """The episode and the number of steps taken."""
        if not len(self._tools.prediction.positions):
            return State()
        return State(episode_id=self._tools.episode_id, step_count=len(self._tools.prediction.positions) - 1)

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
    return create_app(
        lambda: NavigationEnvironment(tools),
        NavigationAction,
        NavigationObservation,
        env_name="condvln",
        max_concurrent_envs=sessions,
    )
