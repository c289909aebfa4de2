"""A language model as an agent on a split, over any OpenAI-compatible endpoint.

    python examples/chat_agent.py EXPORT SPLIT FAMILY=FOLDER... http://localhost:8000/v1 MODEL predictions.json

Name the dataset of each family of scenes in the split; episodes of other families are left out, and counted.
The endpoint's key is read from OPENAI_API_KEY where that is set. `condvln evaluate` scores the file.
Only the standard library is used beside condvln.
"""

from __future__ import annotations

import json
import os
import sys
import urllib.request
from collections import Counter
from typing import Any

from condvln.evaluation.environment.tools import EpisodeTools, tools_for
from condvln.evaluation.predictions import Prediction, write_predictions
from condvln.evaluation.split import open_export
from schemas.errors import CondVLNError

TURNS = 80
"""Most answers of the model in one episode."""

SYSTEM = (
    "You are in a building. Follow the instruction with your tools, then call stop. You see only what they tell you."
)


def tool(name: str, about: str, argument: str | None = None, meaning: str = "") -> dict[str, Any]:
    """Describe a tool as the endpoint expects it; its argument is a whole number."""
    properties = {} if argument is None else {argument: {"type": "integer", "description": meaning}}
    wanted = {"type": "object", "properties": properties, "required": list(properties)}
    return {"type": "function", "function": {"name": name, "description": about, "parameters": wanted}}


TOOLS = [
    tool("forward", "Walk straight ahead.", "steps", "steps of 0.25 m, from 1 to 40"),
    tool("turn", "Turn on the spot.", "degrees", "positive to the right; a multiple of 15 up to 180"),
    tool("look", "Look all around without moving."),
    tool("stop", "End the episode, where the instruction leads."),
]


def ask(endpoint: str, model: str, messages: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the model's next message."""
    body = json.dumps({"model": model, "messages": messages, "tools": TOOLS, "temperature": 0}).encode()
    headers = {"Content-Type": "application/json"}
    if "OPENAI_API_KEY" in os.environ:
        headers["Authorization"] = f"Bearer {os.environ['OPENAI_API_KEY']}"
    request = urllib.request.Request(f"{endpoint.rstrip('/')}/chat/completions", body, headers)
    with urllib.request.urlopen(request, timeout=600) as answer:
        message: dict[str, Any] = json.load(answer)["choices"][0]["message"]
    return message


def follow(episode: EpisodeTools, episode_id: str, endpoint: str, model: str) -> Prediction:
    """Run one episode until STOP, the end of the step budget, or `TURNS` answers."""
    messages = [{"role": "system", "content": SYSTEM}, {"role": "user", "content": episode.reset(episode_id)}]
    for _ in range(TURNS):
        message = ask(endpoint, model, messages)
        messages.append(message)
        calls = message.get("tool_calls") or []
        if not calls:
            messages.append({"role": "user", "content": "Use a tool."})
        for call in calls:
            said = answer_of(episode, call["function"])
            messages.append({"role": "tool", "tool_call_id": call["id"], "content": said})
        if episode.done:
            break
    return episode.prediction


def answer_of(episode: EpisodeTools, function: dict[str, Any]) -> str:
    """Return the answer of a tool; a wrong call is explained to the model."""
    name = function["name"]
    if name not in {described["function"]["name"] for described in TOOLS}:
        return f"There is no tool {name!r}."
    try:
        return str(getattr(episode, name)(**json.loads(function.get("arguments") or "{}")))
    except (TypeError, ValueError, CondVLNError) as fault:
        return f"That call failed: {fault}"


def main() -> None:
    if len(sys.argv) < 7 or not all("=" in dataset for dataset in sys.argv[3:-3]):
        sys.exit(__doc__)
    export, split, *datasets, endpoint, model, out = sys.argv[1:]
    folders = dict(dataset.split("=", 1) for dataset in datasets)
    families = {task.episode_id: str(task.axes["source"]) for task in open_export(export).tasks(split)}
    unseen = Counter(family for family in families.values() if family not in folders)
    for family, episodes in sorted(unseen.items()):
        print(f"{episodes} episodes of {family} are left out: name its dataset, {family}=FOLDER")
    tools = tools_for(export, split, folders)
    walks = (follow(tools(), name, endpoint, model) for name in tools.episode_ids if families[name] in folders)
    count = write_predictions(out, walks)
    print(f"{count} predictions in {out}")


if __name__ == "__main__":
    main()
