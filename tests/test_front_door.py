"""``import condvln as cv``: what it offers, what it costs, and that the tutorial and the examples run as they are."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

import condvln
from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.world import label_priors, open_world
from jobs.generate import run_generate
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SourceConfig, TextConfig

LOADED_LATER = ("gymnasium", "ray", "numba", "pyarrow", "trimesh", "scipy", "pydantic", "networkx", "matplotlib")


def blocks(text: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def example(repository: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, repository / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # Ray pickles functions by their module
    spec.loader.exec_module(module)
    return module


def test_importing_loads_nothing_heavy() -> None:
    code = f"import sys, condvln; print([m for m in {LOADED_LATER!r} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize(
    ("imports", "name"),
    [
        ("import gymnasium, condvln", "condvln/VLN-v0"),
        ("import gymnasium", "condvln:condvln/VLN-v0"),
        ("import condvln, gymnasium", "condvln.evaluation.environment:condvln/VLN-v0"),
        ("import gymnasium", "condvln.evaluation.environment:condvln/VLN-v0"),
        ("import condvln.evaluation.environment, gymnasium", "condvln/VLN-v0"),
    ],
)
def test_gymnasium_finds_the_environment(imports: str, name: str) -> None:
    """Each in a process of its own. The export is missing, which the environment says once it is made."""
    code = f"""{imports}
try:
    gymnasium.make({name!r}, export="nowhere", split="val_unseen")
except Exception as error:
    print(type(error).__module__, type(error).__name__)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found == "schemas.errors MissingFileError\n"


def test_every_name_is_there_and_sorted() -> None:
    assert condvln.__all__ == sorted(condvln.__all__)
    assert {name for names in condvln._MODULES.values() for name in names} == set(condvln.__all__)
    for name in condvln.__all__:
        assert getattr(condvln, name) is not None
    assert set(condvln.__all__) <= set(dir(condvln))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = condvln.nothing
    documented = set(re.findall(r"``([A-Za-z_]+)``", condvln.__doc__ or ""))
    assert documented <= set(condvln.__all__), "the table names nothing that is not there"


def test_the_tutorial_runs(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (repository / "docs" / "tutorial.md").read_text(encoding="utf-8")
    code = "".join(blocks(text))
    assert len([line for line in code.splitlines() if line.strip()]) <= 60
    monkeypatch.chdir(tmp_path)
    session: dict[str, object] = {}
    for block, shown in re.findall(r"```python\n(.*?)```\n(?:\n```text\n(.*?)```\n)?", text, re.DOTALL):
        exec(compile(block, "tutorial", "exec"), session)
        assert capsys.readouterr().out == shown, "what the page shows is what is printed"
    assert session["score"].success == 1.0  # type: ignore[attr-defined]
    with Image.open(tmp_path / "episode.png") as drawn, Image.open(repository / "docs" / "episode.png") as kept:
        sizes = [np.asarray(one.convert("L").resize((330, 198)), np.float64) for one in (drawn, kept)]
    assert np.abs(sizes[0] - sizes[1]).mean() < 4, "the picture of README and tutorial is the one that is drawn"
    assert session["near"]


def test_the_notebook_is_the_tutorial(repository: Path) -> None:
    maker = example(repository, "make_notebook")
    tutorial = (repository / "docs" / "tutorial.md").read_text(encoding="utf-8")
    text = (repository / "examples" / "tutorial.ipynb").read_text(encoding="utf-8")
    assert text == maker.notebook(tutorial), "run python examples/make_notebook.py"
    cells = ["".join(c["source"]) + "\n" for c in json.loads(text)["cells"] if c["cell_type"] == "code"]
    assert cells == blocks(tutorial)


def test_a_world_s_episodes_are_those_of_a_run(tmp_path: Path) -> None:
    make_samples(tmp_path / "scenes", family="procthor", scenes=3, seed=4)
    wanted = InstructionsConfig(per_category={"simple": 4, "nested": 2, "chain": 2}, counterfactual_groups=1)
    source = SourceConfig(family="procthor", root=tmp_path / "scenes")
    config = Config(name="made", store=tmp_path / "store", sources=(source,), instructions=wanted, seed=5)
    assert run_generate(config, inline=True, console=Console(quiet=True)).exit_code == 0
    columns = ("scene_id", "episode_id", "instruction_text", "max_steps")
    snapshot = published(config)
    rows = snapshot.table("episodes", list(columns)).to_pylist()
    opened = open_source("procthor", str(tmp_path / "scenes"))
    priors = label_priors(opened.read(name) for name in opened.scene_ids())
    made = [
        (name, episode.episode_id, episode.instruction_text, episode.max_steps)
        for name in opened.scene_ids()
        for episode in open_world(opened, name).episodes(
            instructions=wanted, priors=priors, text=TextConfig(), seed=config.seed
        )
    ]
    assert len(made) > 10
    assert sorted(made) == sorted(tuple(row[name] for name in columns) for row in rows)


def test_an_own_agent_is_walked_and_scored(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_samples(tmp_path / "scenes", family="ithor", scenes=2, seed=1)
    source = SourceConfig(family="ithor", root=tmp_path / "scenes")
    wanted = InstructionsConfig(per_category={"simple": 3})
    config = Config(
        name="m", store=tmp_path / "store", export=tmp_path / "export", sources=(source,), instructions=wanted
    )
    assert run_generate(config, inline=True, console=Console(quiet=True)).exit_code == 0
    export = condvln.open_export(tmp_path / "export", [tmp_path / "scenes"])
    split = max(export.splits, key=lambda name: export.splits[name])
    assert f"{split} {export.splits[split]}" in repr(export)
    monkeypatch.chdir(tmp_path)
    example(repository, "own_agent").main(str(tmp_path / "export"), split, str(tmp_path / "scenes"))
    assert "success" in capsys.readouterr().out
    read = list(condvln.read_predictions(str(tmp_path / "wanderer.json")))
    assert {p.episode_id for p in read} == {str(e.episode_id) for e in export.episodes(split)}


@pytest.mark.ray
@pytest.mark.soak
def test_the_ray_example_counts_predicates(repository: Path, tmp_path: Path) -> None:
    make_samples(tmp_path, family="replicacad", scenes=2, seed=1)
    # In a process of its own: another test of this one may have a Ray that it shares.
    words = [sys.executable, str(repository / "examples" / "ray_job.py"), "replicacad", str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": str(repository)}
    run = subprocess.run(words, cwd=repository, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    found = dict(line.split(maxsplit=1)[::-1] for line in run.stdout.splitlines())
    assert int(found["near"]) > 0


@pytest.mark.parametrize("page", ["architecture", "glossary"])
def test_files_that_the_docs_name_exist(repository: Path, page: str) -> None:
    text = (repository / "docs" / f"{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:condvln|factory|jobs|schemas|docs|deploy|tests)/[\w/.-]*)`", text)
    assert len(named) > 15
    assert [place for place in named if not (repository / place).exists()] == []
