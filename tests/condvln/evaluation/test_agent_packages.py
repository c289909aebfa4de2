"""Tools, OpenEnv server and inspect-ai task, each driven by its own package; ``make agents`` installs them."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from condvln.evaluation.export_folder import Export
from condvln.evaluation.tools import EpisodeTools, tools_for

HOW = "make agents installs it"


@pytest.fixture(scope="module")
def tools(made: tuple[Export, Path]) -> type[EpisodeTools]:
    return tools_for(made[0], "train", {"replicacad": made[1]})


def test_transformers_reads_the_tools_as_trl_does(tools: type[EpisodeTools]) -> None:
    chat = pytest.importorskip("transformers.utils.chat_template_utils", reason=f"transformers is absent: {HOW}")
    found = {
        name: chat.get_json_schema(getattr(tools(), name))["function"] for name in ("forward", "turn", "look", "stop")
    }
    assert found["turn"]["parameters"]["properties"]["degrees"]["type"] == "integer"
    assert found["turn"]["parameters"]["required"] == ["degrees"]
    assert "required" not in found["forward"]["parameters"]
    assert found["look"]["parameters"]["properties"] == {}
    assert all(described["description"] for described in found.values())


@pytest.fixture
def address(tools: type[EpisodeTools]) -> Iterator[str]:
    pytest.importorskip("openenv", reason=f"openenv is absent: {HOW}")
    import uvicorn

    from condvln.evaluation.openenv_server import application

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = uvicorn.Server(uvicorn.Config(application(tools), host="127.0.0.1", port=port, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.05)
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


def test_openenv_s_client_walks_an_episode(address: str, made: tuple[Export, Path]) -> None:
    from openenv import GenericEnvClient

    task = made[0].tasks("train")[2]
    with GenericEnvClient(base_url=address).sync() as client:
        began = client.reset(episode_id=task.episode_id)
        assert began.observation["instruction"] == task.text
        assert not began.done
        fields = set(began.observation)
        turned = client.step({"tool": "turn", "degrees": 30})
        assert turned.observation["steps_left"] == task.max_steps - 2
        wrong = client.step({"tool": "turn", "degrees": 7})
        assert "multiple of 15" in wrong.observation["text"]
        assert wrong.observation["steps_left"] == task.max_steps - 2
        walked = client.step({"tool": "forward", "steps": 2})
        assert client.state()["step_count"] == 4
        over = client.step({"tool": "stop"})
    assert over.done
    assert over.reward == 0.0
    # No observation has more than this, and what is seen is text.
    assert all(set(step.observation) == fields for step in (turned, wrong, walked, over))
    assert fields <= {"text", "instruction", "episode_id", "steps_left", "done", "reward", "metadata"}
    assert not over.observation.get("metadata")


def test_inspect_scores_a_walk(
    tools: type[EpisodeTools], made: tuple[Export, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inspect_ai = pytest.importorskip("inspect_ai", reason=f"inspect-ai is absent: {HOW}")
    from inspect_ai.model import ModelAPI, ModelOutput, get_model

    async def tokens(self: ModelAPI, text: str) -> int:
        return len(text.split())

    # It would download a tokenizer.
    monkeypatch.setattr(ModelAPI, "count_text_tokens", tokens)

    from condvln.evaluation.inspect_task import inspect_task

    def calls(name: str, **arguments: Any) -> ModelOutput:
        return ModelOutput.for_tool_call("mockllm/model", name, arguments)

    said = [
        calls("turn", degrees=7),
        calls("turn", degrees=30),
        calls("look"),
        calls("forward", steps=1),
        calls("stop"),
    ]
    model = get_model("mockllm/model", custom_outputs=[*said, ModelOutput.from_content("mockllm/model", "Done.")])
    task = inspect_task(tools, limit=1)
    assert all(not sample.target and not sample.metadata for sample in task.dataset)
    (log,) = inspect_ai.eval(task, model=model, log_dir=str(tmp_path), display="none")
    assert log.status == "success", log.error
    (sample,) = log.samples
    (found,) = sample.scores.values()
    assert found.value == 0.0
    assert found.metadata["done"]
    assert found.metadata["steps"] == 4
    first = made[0].tasks("train")[0]
    assert sample.id == first.episode_id
    assert first.text in sample.messages[0].text
    errors = [message.error for message in sample.messages if message.role == "tool" and message.error]
    assert len(errors) == 1
    assert "multiple of 15" in errors[0].message
