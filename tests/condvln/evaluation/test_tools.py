"""Tools for language agents: what they say and cost, what they must never tell, and a model behind an endpoint."""

from __future__ import annotations

import importlib.util
import inspect
import json
import threading
from collections.abc import Iterator
from dataclasses import asdict, replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from condvln.evaluation.agents import agent_named
from condvln.evaluation.environment import tools as module
from condvln.evaluation.environment.tools import EpisodeTools, tools_for
from condvln.evaluation.predictions import read_predictions
from condvln.evaluation.score import score
from condvln.evaluation.split import Export
from condvln.sensors import TextSensor
from schemas.errors import UsageError

CALLED = ("forward", "look", "stop", "turn")


@pytest.fixture(scope="module")
def tools(made: tuple[Export, Path]) -> type[EpisodeTools]:
    return tools_for(made[0], "train", {"replicacad": made[1]})


def test_public_methods_are_the_tools_and_each_is_described(tools: type[EpisodeTools]) -> None:
    public = {name for name, value in inspect.getmembers(tools()) if inspect.ismethod(value) and name[0] != "_"}
    assert public == {*CALLED, "reset"}
    for name in CALLED:
        method = getattr(tools, name)
        signature = inspect.signature(method)
        for argument in [argument for argument in signature.parameters if argument != "self"]:
            assert signature.parameters[argument].annotation == "int"
            assert f"            {argument}: " in method.__doc__
        assert signature.return_annotation == "str"
        assert "Returns:" in method.__doc__


def test_every_step_is_counted_and_scored_as_evaluate_does(
    made: tuple[Export, Path], tools: type[EpisodeTools]
) -> None:
    task = made[0].tasks("train")[0]
    episode = tools()
    assert task.text in episode.reset(episode_id=task.episode_id, reward=5, gold_leaf=0)
    assert episode.steps_left == task.max_steps
    episode.look()
    assert episode.steps_left == task.max_steps
    episode.turn(-30)
    episode.turn(45)
    assert episode.steps_left == task.max_steps - 5
    heading = episode.prediction.headings
    assert np.degrees(heading[5] - heading[0] + np.pi) % 360 - 180 == pytest.approx(-15)
    assert not episode.done
    assert episode.score == {}
    assert episode.stop() == "The episode is over."
    assert episode.done
    found = asdict(score(task, episode.prediction, made[0].pathfinder(task)))
    assert episode.score == {k: None if np.isnan(v) else v for k, v in found.items()}
    with pytest.raises(UsageError):
        episode.forward()
    for wrong in (7, 0, 195):
        episode.reset(task.episode_id)
        with pytest.raises(ValueError, match="degrees"):
            episode.turn(wrong)
    with pytest.raises(ValueError, match="steps"):
        episode.forward(0)
    with pytest.raises(UsageError):
        episode.reset("nobody")


def test_the_oracle_s_walk_by_tools_gets_the_reward(made: tuple[Export, Path], tools: type[EpisodeTools]) -> None:
    task = made[0].tasks("train")[1]
    walked = agent_named("oracle")(task, made[0].pathfinder(task), 0)
    episode = tools()
    episode.reset(task.episode_id)
    assert walked.headings is not None
    turns = np.round(np.degrees(np.diff(walked.headings) + np.pi) % 360 - 180)
    for turn in turns[:-1]:
        if turn:
            episode.turn(-int(turn))
        else:
            episode.forward()
    episode.stop()
    np.testing.assert_array_equal(episode.prediction.positions, walked.positions)
    assert episode.reward == 1.0


def test_a_spent_budget_ends_the_episode(made: tuple[Export, Path]) -> None:
    short = tools_for(made[0], "train", {"replicacad": made[1]})
    task = replace(made[0].tasks("train")[0], max_steps=3)
    short._split.tasks[task.episode_id] = task  # type: ignore[index]
    episode = short()
    episode.reset(task.episode_id)
    assert "no steps are left" in episode.turn(180)
    assert episode.score is not None
    assert "success" in episode.score
    assert not {"leaf_correct", "wrong_branch", "no_commit"} & {*episode.score}, "without STOP no leaf is told"
    assert episode.done
    assert episode.reward == 0.0
    assert len(episode.prediction.positions) == 4


def test_no_truth_is_told(made: tuple[Export, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every field of a task that an agent must not know is changed in turn, and nothing that is said changes."""
    own = tools_for(made[0], "train", {"replicacad": made[1]})
    task = made[0].tasks("train")[0]

    def said(other: Any) -> list[str]:
        own._split.tasks[task.episode_id] = other  # type: ignore[index]
        episode = own()
        return [episode.reset(task.episode_id), episode.look(), episode.forward(2), episode.turn(90), episode.stop()]

    plain = said(task)
    flipped = tuple(c.model_copy(update={"truth": not c.truth, "witnesses": ()}) for c in task.program.conditions)
    moved = tuple(
        replace(leaf, goals=leaf.goals + 1, subgoals=leaf.subgoals + 1, path=leaf.path) for leaf in task.leaves
    )
    changes: dict[str, Any] = {
        "group_id": "another",
        "axes": {**task.axes, "category": "chain", "observability": "O2", "composition": "C2", "moves": 3},
        "program": task.program.model_copy(update={"conditions": flipped}),
        "gold_leaf": (task.gold_leaf + 1) % task.n_leaves,
        "leaves": moved,
        "reference": task.reference[::-1],
        "looking": None,
        "success_distance": 9.0,
        "navmesh_sha256": task.navmesh_sha256,
    }
    told = {"episode_id", "text", "start", "start_rotation", "max_steps", "navmesh", "episode_hash"}
    assert {*changes, *told} == set(task.__dataclass_fields__)
    for name, value in changes.items():
        assert said(replace(task, **{name: value})) == plain, name
    # What is said is what the text sensor names, and words about steps.
    observed: list[str] = []
    observe = TextSensor.observe

    def noted(self: TextSensor, *arguments: Any, **names: Any) -> Any:
        found = observe(self, *arguments, **names)
        observed.extend(str(found).split("\n"))
        return found

    monkeypatch.setattr(module.TextSensor, "observe", noted)
    said(task)
    for line in said(task)[2].split("\n"):
        assert line in observed or line.startswith(("Steps left", "Something is in the way"))


class Stub(BaseHTTPRequestHandler):
    """A model that calls a wrong tool, turns, walks, says something without a call, and stops."""

    asked: list[dict[str, Any]] = []  # noqa: RUF012
    script = (
        [("fly", "{}")],
        [("turn", '{"degrees": 7}'), ("turn", '{"degrees": 30}')],
        [("forward", '{"steps": 2}')],
        [],
        [("stop", "{}")],
    )

    def do_POST(self) -> None:
        request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.asked.append(request)
        turn = sum(message["role"] == "assistant" for message in request["messages"])
        calls = [
            {"id": f"{turn}-{k}", "type": "function", "function": {"name": name, "arguments": arguments}}
            for k, (name, arguments) in enumerate(self.script[turn])
        ]
        message: dict[str, Any] = {"role": "assistant", "content": "" if calls else "I think."}
        if calls:
            message["tool_calls"] = calls
        body = json.dumps({"choices": [{"message": message}]}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *arguments: object) -> None:
        return


@pytest.fixture
def endpoint() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), Stub)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/v1"
    server.shutdown()
    server.server_close()
    thread.join()


def example(repository: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("chat_agent", repository / "examples" / "chat_agent.py")
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_the_example_follows_a_model_behind_an_endpoint(
    made: tuple[Export, Path], endpoint: str, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "model.json"
    words = ["chat_agent.py", str(made[0].folder), "train", f"replicacad={made[1]}", endpoint, "stub", str(out)]
    monkeypatch.setattr("sys.argv", words)
    Stub.asked.clear()
    example(repository).main()
    found = list(read_predictions(out))
    assert [prediction.episode_id for prediction in found] == [t.episode_id for t in made[0].tasks("train")]
    assert all(prediction.stopped and len(prediction.positions) <= 6 for prediction in found)
    assert {described["function"]["name"] for described in Stub.asked[0]["tools"]} == set(CALLED)
    answers = [m["content"] for m in Stub.asked[4]["messages"] if m["role"] == "tool"]
    assert answers[0] == "There is no tool 'fly'."
    assert "multiple of 15" in answers[1]
    assert "Steps left" in answers[2]
    assert Stub.asked[4]["messages"][-1] == {"role": "user", "content": "Use a tool."}
