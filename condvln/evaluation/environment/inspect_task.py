"""A split as an inspect-ai task; needs the extra ``inspect``."""

from __future__ import annotations

from typing import Any

from condvln.evaluation.environment.tools import EpisodeTools
from schemas.errors import UsageError

try:
    from inspect_ai import Task
    from inspect_ai.dataset import MemoryDataset, Sample
    from inspect_ai.model import ChatMessageUser
    from inspect_ai.scorer import Score, Target, accuracy, scorer, stderr
    from inspect_ai.solver import Generate, TaskState, solver
    from inspect_ai.tool import Tool, ToolDef, ToolError
except ImportError as error:
    raise UsageError("inspect-ai is not installed", remedy="Install condvln[inspect]") from error

__all__ = ["inspect_task"]

_SCORE = "condvln_score"


def inspect_task(tools: type[EpisodeTools], *, limit: int | None = None, message_limit: int = 200) -> Task:
    """Return an inspect-ai task in which a model follows every instruction of a split with the tools of `EpisodeTools`.

    A sample holds the episode's id and no ground truth; its target is empty. The score is 1 for a stop within the
        success distance of the gold leaf, else 0, and its metadata has all measures.

    Parameters
    ----------
    tools : the split's, from `tools_for`
    limit : number of episodes, the first ones; None for all
    message_limit : largest number of messages in a conversation
    """
    # The solver replaces this with the instruction and the first view.
    samples = [Sample(input="Follow the instruction.", target="", id=name) for name in tools.episode_ids[:limit]]
    return Task(
        dataset=MemoryDataset(samples, name="condvln"),
        solver=_walk(tools),
        scorer=_reached(),
        message_limit=message_limit,
        name="condvln",
    )


@solver  # type: ignore[untyped-decorator]
def _walk(tools: type[EpisodeTools]) -> Any:
    async def solve(state: TaskState, generate: Generate) -> TaskState:
        episode = tools()
        state.messages = [ChatMessageUser(content=episode.reset(str(state.sample_id)))]
        state.tools = _tools_of(episode)
        try:
            state = await generate(state, tool_calls="loop")
        finally:
            state.store.set(_SCORE, {"reward": episode.reward, "done": episode.done, **episode.score})
        return state

    return solve


@scorer(metrics=[accuracy(), stderr()])  # type: ignore[untyped-decorator]
def _reached() -> Any:
    async def judge(state: TaskState, target: Target) -> Score:
        found = state.store.get(_SCORE, {})
        return Score(value=float(found.get("reward", 0.0)), metadata=dict(found))

    return judge


def _tools_of(episode: EpisodeTools) -> list[Tool]:
    async def forward(steps: int = 1) -> str:
        """Walk straight ahead. One step is 0.25 m.

        Args:
            steps: How many steps to take, from 1 to 40.
        """
        return _said(lambda: episode.forward(steps))

    async def turn(degrees: int) -> str:
        """Turn on the spot.

        Args:
            degrees: How far to turn: positive to the right, negative to the left, a multiple of 15 up to 180.
        """
        return _said(lambda: episode.turn(degrees))

    async def look() -> str:
        """Look all around without moving. It takes no step."""
        return _said(episode.look)

    async def stop() -> str:
        """End the episode here. Use it once, where the instruction leads."""
        return _said(episode.stop)

    return [ToolDef(tool).as_tool() for tool in (forward, turn, look, stop)]


def _said(call: Any) -> str:
    try:
        return str(call())
    except (ValueError, UsageError) as fault:
        raise ToolError(str(fault)) from fault
