"""Tools, OpenEnv server and inspect-ai task, each driven by its own package; ``make agents`` installs them."""

from __future__ import annotations

import json
import socket
import urllib.request
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.evaluation.agents import agent_named
from condvln.evaluation.environment.tools import EpisodeTools, tools_for
from condvln.evaluation.split import Export
from condvln.evaluation.task import Task
from tests.condvln.evaluation.serving import running

HOW = "make agents installs it"


@pytest.fixture(scope="module")
def tools(made: tuple[Export, Path]) -> type[EpisodeTools]:
    return tools_for(made[0], "train", {"replicacad": made[1]})


def calls_of(export: Export, task: Task) -> list[tuple[str, dict[str, int]]]:
    """The oracle's walk as calls of tools."""
    headings = agent_named("oracle")(task, export.pathfinder(task), 0).headings
    assert headings is not None
    turns = np.round(np.degrees(np.diff(headings) + np.pi) % 360 - 180).astype(int)[:-1].tolist()
    calls: list[tuple[str, dict[str, int]]] = []
    for turn, run in groupby(turns):
        count = len(list(run))
        most = 12 if turn else 40
        for part in (min(most, count - begun) for begun in range(0, count, most)):
            calls.append(("turn", {"degrees": -turn * part}) if turn else ("forward", {"steps": part}))
    return [*calls, ("stop", {})]


def test_trl_trains_a_step_on_episodes(
    tools: type[EpisodeTools], made: tuple[Export, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GRPOTrainer resets episodes, shows the tools, calls them, and takes the rewards; the words of its tiny model with
    random weights are a script: one walk of the oracle, and one that stops at once.
    """
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setenv("TRL_EXPERIMENTAL_SILENCE", "1")
    trl = pytest.importorskip("trl", reason=f"trl is absent: {HOW}, with torch's CPU build")
    from datasets import Dataset
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast, Qwen3Config, Qwen3ForCausalLM
    from trl.chat_template_utils import qwen3_chat_template

    letters = sorted(pre_tokenizers.ByteLevel.alphabet())
    spelling = Tokenizer(models.BPE(vocab={letter: k for k, letter in enumerate(letters)}, merges=[]))
    spelling.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    spelling.decoder = decoders.ByteLevel()
    words = PreTrainedTokenizerFast(
        tokenizer_object=spelling,
        eos_token="<|im_end|>",
        pad_token="<|endoftext|>",
        additional_special_tokens=["<|im_start|>"],
    )
    words.add_tokens(["<tool_call>", "</tool_call>", "<tool_response>", "</tool_response>", "<think>", "</think>"])
    words.chat_template = qwen3_chat_template
    small = {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "head_dim": 8}
    model = Qwen3ForCausalLM(Qwen3Config(vocab_size=len(words), num_attention_heads=1, num_key_value_heads=1, **small))

    task = min(made[0].tasks("train"), key=lambda one: len(calls_of(made[0], one)))
    walk, hasty = calls_of(made[0], task), [("turn", {"degrees": 7}), ("stop", {})]
    assert len(walk) >= len(hasty)

    def said(call: tuple[str, dict[str, int]]) -> str:
        written = json.dumps({"name": call[0], "arguments": call[1]})
        return f"<tool_call>\n{written}\n</tool_call><|im_end|>"

    prompts: list[str] = []

    class Scripted(trl.GRPOTrainer):  # type: ignore[misc, name-defined]
        def _generate_single_turn(self, prompt_ids: list[list[int]], *_: Any, **__: Any) -> tuple[Any, None]:
            now = [words.decode(ids) for ids in prompt_ids]
            prompts.extend(now)
            texts = []
            for k, prompt in enumerate(now):
                taken = prompt.count("<tool_response>")
                # Both walks are here until the second one, which stops at once, has said its last word.
                calls = hasty if k == 1 else walk
                texts.append(said(calls[taken]) if taken < len(calls) else "Done.<|im_end|>")
            return [words.encode(text, add_special_tokens=False) for text in texts], None

    rewards: list[float] = []
    walked: list[EpisodeTools] = []

    def reward(environments: list[EpisodeTools], **_: Any) -> list[float]:
        walked.extend(environments)
        rewards.extend(environment.reward for environment in environments)
        return [environment.reward for environment in environments]

    row = {"prompt": [{"role": "user", "content": "Follow the instruction. "}], "episode_id": task.episode_id}
    settings = trl.GRPOConfig(
        output_dir=str(tmp_path),
        per_device_train_batch_size=2,
        num_generations=2,
        max_steps=1,
        max_completion_length=60_000,
        report_to="none",
        use_cpu=True,
        bf16=False,
        save_strategy="no",
        logging_steps=1,
        disable_tqdm=True,
    )
    trainer = Scripted(
        model=model,
        args=settings,
        processing_class=words,
        reward_funcs=reward,
        train_dataset=Dataset.from_list([row]),
        environment_factory=tools,
    )
    trainer.train()
    (log,) = (one for one in trainer.state.log_history if "reward" in one)
    assert sorted(rewards) == [0.0, 1.0]
    assert log["reward"] == 0.5
    # Two calls of the walk that stops at once, of them one with an angle that no tool takes.
    assert log["tools/call_frequency"] == (len(walk) + 2) / 2
    assert log["tools/failure_frequency"] == pytest.approx(1 / (len(walk) + 2))
    assert log["grad_norm"] > 0
    assert all(task.text in prompt and '"name": "forward"' in prompt for prompt in prompts)
    assert any("multiple of 15" in prompt for prompt in prompts)
    won = next(one for one in walked if one.reward)
    np.testing.assert_array_equal(
        won.prediction.positions, agent_named("oracle")(task, made[0].pathfinder(task), 0).positions
    )


@pytest.fixture
def address(tools: type[EpisodeTools]) -> Iterator[str]:
    pytest.importorskip("openenv", reason=f"openenv is absent: {HOW}")
    import uvicorn

    from condvln.evaluation.environment.openenv_server import application

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = uvicorn.Server(uvicorn.Config(application(tools), host="127.0.0.1", port=port, log_level="error"))
    with running(server):
        yield f"http://127.0.0.1:{port}"


def test_openenv_s_client_walks_an_episode(address: str, tools: type[EpisodeTools], made: tuple[Export, Path]) -> None:
    """The client sees what the tools say in this process; how far they walk is up to the furniture."""
    from openenv import GenericEnvClient

    task = made[0].tasks("train")[2]
    own = tools()
    own.reset(task.episode_id)
    own.turn(30)
    seen = own.forward(2)
    taken = task.max_steps - own.steps_left
    assert taken in (3, 4)
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
        assert walked.observation["text"] == seen
        assert walked.observation["steps_left"] == own.steps_left
        assert client.state()["step_count"] == taken
        over = client.step({"tool": "stop"})
    assert over.done
    assert over.reward == 0.0
    # No observation has more than this, and what is seen is text.
    assert all(set(step.observation) == fields for step in (turned, wrong, walked, over))
    assert fields <= {"text", "instruction", "episode_id", "steps_left", "done", "reward", "metadata"}
    assert not over.observation.get("metadata")


def post(address: str, name: str, **body: Any) -> Any:
    data = json.dumps(body).encode()
    request = urllib.request.Request(f"{address}/{name}", data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def test_openenv_s_episodes_go_on_by_plain_http(
    address: str, tools: type[EpisodeTools], made: tuple[Export, Path]
) -> None:
    """OpenEnv makes an environment for each request; episodes are told apart by their id."""
    first, second = made[0].tasks("train")[:2]
    early = post(address, "step", action={"tool": "look"})
    assert "no episode has begun" in early["observation"]["text"]
    for task in (first, second):
        began = post(address, "reset", episode_id=task.episode_id)
        assert began["observation"]["instruction"] == task.text
    turned = post(address, "step", action={"tool": "turn", "degrees": 30})
    assert (turned["observation"]["episode_id"], turned["observation"]["steps_left"]) == (
        second.episode_id,
        second.max_steps - 2,
    )
    other = post(address, "step", action={"tool": "turn", "degrees": -15}, episode_id=first.episode_id)
    assert (other["observation"]["episode_id"], other["observation"]["steps_left"]) == (
        first.episode_id,
        first.max_steps - 1,
    )
    again = post(address, "step", action={"tool": "turn", "degrees": 15}, episode_id=second.episode_id)
    assert again["observation"]["steps_left"] == second.max_steps - 3
    for task in (first, second):
        over = post(address, "step", action={"tool": "stop"}, episode_id=task.episode_id)
        assert (over["done"], over["observation"]["episode_id"]) == (True, task.episode_id)
    after = post(address, "step", action={"tool": "look"}, episode_id=first.episode_id)
    assert "no episode has begun" in after["observation"]["text"]


def test_inspect_scores_a_walk(
    tools: type[EpisodeTools], made: tuple[Export, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inspect_ai = pytest.importorskip("inspect_ai", reason=f"inspect-ai is absent: {HOW}")
    from inspect_ai.model import ModelAPI, ModelOutput, get_model

    async def tokens(self: ModelAPI, text: str) -> int:
        return len(text.split())

    # It would download a tokenizer.
    monkeypatch.setattr(ModelAPI, "count_text_tokens", tokens)

    from condvln.evaluation.environment.inspect_task import inspect_task

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
