"""The evaluation's command: several agents side by side in every form, the oracle twin, others' results, plots."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rich.console import Console
from typer.testing import CliRunner

from condvln.evaluation.agents import walk_to_leaf
from condvln.evaluation.evaluate import evaluate as evaluate_tasks
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.split import SplitOptions, open_export, split_tasks
from condvln.evaluation.walker import Observation, walk
from condvln.navigation.points import densify
from jobs.command import app
from jobs.evaluate import Question, evaluate_predictions
from jobs.report import PIPE_WIDTH, Report
from schemas.config import Config
from schemas.errors import FormatError, MissingFileError, UsageError
from tests.site_chunks import chunk_content
from tests.strict_loader import read

runner = CliRunner()


@pytest.fixture(scope="module")
def agents(export: Path, split: str, made_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Predictions of three reference agents."""
    folder = tmp_path_factory.mktemp("agents")
    for name in ("oracle", "always-then", "wrong-branch"):
        words = ["walk", str(export), split, "--agent", name, "--out", str(folder / f"{name}.json")]
        result = runner.invoke(app, [*words, "--data", str(made_dataset)])
        assert result.exit_code == 0, result.output
    return {path.stem: path for path in folder.glob("*.json")}


def test_a_narrow_terminal_shows_the_leading_columns_whole(
    export: Path, split: str, agents: dict[str, Path], made_dataset: Path
) -> None:
    options = SplitOptions(navmesh_roots=(made_dataset,))
    report = evaluate_predictions(Question(export, split, (agents["oracle"],), options=options, tables=("main",)))
    narrow, wide = Console(width=80, record=True), Console(width=PIPE_WIDTH, record=True)
    for console in (narrow, wide):
        console.print(report)
    said = narrow.export_text()
    assert max(map(len, said.splitlines())) <= 80
    assert "SR ↑" in said
    assert "100.0" in said
    assert "SDTW" in said.split("no room for")[1]
    assert "no room for" not in wide.export_text()


def test_a_navmesh_that_is_missing_is_named_before_the_first_walk(
    export: Path, split: str, made_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(made_dataset, tmp_path / "dataset")
    tasks = split_tasks(export, split)
    assert tasks[0].navmesh != tasks[-1].navmesh
    (tmp_path / "dataset" / tasks[-1].navmesh).unlink()
    monkeypatch.setattr("jobs.evaluate.agent_named", lambda name: lambda *arguments: pytest.fail("walked"))
    words = ["walk", str(export), split, "--agent", "oracle", "--out", str(tmp_path / "oracle.json")]
    result = runner.invoke(app, [*words, "--data", str(tmp_path / "dataset")])
    assert isinstance(result.exception, MissingFileError) or result.exit_code == 3, result.output
    assert tasks[-1].navmesh in result.output + str(result.exception)


@pytest.fixture
def evaluate(export: Path, split: str, made_dataset: Path) -> Any:
    def run(*words: Any) -> Any:
        given = ["evaluate", str(export), split, *map(str, words), "--data", str(made_dataset)]
        return runner.invoke(app, given)

    return run


def documents(evaluate: Any, *words: Any) -> dict[str, Any]:
    result = evaluate(*words, "--json")
    assert result.exit_code == 0, result.output
    return {table["name"]: table for table in json.loads(result.stdout)["tables"]}


def test_agents_side_by_side_in_every_form(evaluate: Any, agents: dict[str, Path], tmp_path: Path) -> None:
    files = [agents["oracle"], agents["wrong-branch"]]
    tables = documents(evaluate, *files, "--csv", tmp_path / "csv", "--scores", tmp_path / "scores.jsonl")
    main = {row["agent"]: row for row in tables["main"]["rows"]}
    assert main["oracle"]["success"]["mean"] == 1
    assert main["wrong-branch"]["success"]["mean"] == 0
    written = {path.stem for path in (tmp_path / "csv").iterdir()}
    assert written == set(tables)
    rows = list(csv.DictReader((tmp_path / "csv" / "main.csv").open(encoding="utf-8")))
    assert [(row["agent"], float(row["success"])) for row in rows] == [("oracle", 1.0), ("wrong-branch", 0.0)]
    scores = [json.loads(line) for line in (tmp_path / "scores.jsonl").read_text().splitlines()]
    assert len(scores) == 2 * main["oracle"]["episodes"]
    assert {score["agent"] for score in scores} == {"oracle", "wrong-branch"}
    assert {type(score["episode_id"]) for score in scores} == {int}
    assert all("scene" not in score and "/" not in score["scene_id"] for score in scores)
    for form, sign in (("--latex", r"\toprule"), ("--markdown", "| agent |")):
        text = evaluate(*files, form).stdout
        assert sign in text
        assert all(name in text for name in ("oracle", "wrong-branch"))
    terminal = evaluate(*files).stdout
    assert "Main results" in terminal
    assert "By category" not in terminal, "other tables are named, not printed"
    assert set(tables) - {"main"} <= set(re.split(r"[,\s]+", terminal.split("more tables", 1)[1]))
    places = [terminal.index(word) for word in ("agent", "SPL-", "BSA-", "CSR-", "oracle")]
    assert places == sorted(places)
    assert "nDTW" not in terminal
    for column in ("SR", "SPL-look", "BSA-all", "CSR-all", "justified"):
        assert f"{column}: " in terminal, "what each column is"
    assert "nDTW" in evaluate(*files, "--table", "main").stdout
    named = evaluate(*files, "--table", "category").stdout
    assert "Main results" not in named
    every = evaluate(*files, "--all").stdout
    assert all(table["title"] in every for table in tables.values())
    wrong = evaluate(*files, "--table", "nothing")
    assert wrong.exit_code == 1
    assert "…" not in terminal  # no number is cut


def test_original_against_the_oracle_twin(evaluate: Any, agents: dict[str, Path]) -> None:
    then, oracle, wrong = (agents[name] for name in ("always-then", "oracle", "wrong-branch"))
    tables = documents(evaluate, then, wrong, "--oracle", oracle, "--oracle", wrong)
    rows = tables["twin_main"]["rows"]
    assert [row["agent"] for row in rows] == [
        "always-then (oracle text)", "always-then (conditions)",
        "wrong-branch (oracle text)", "wrong-branch (conditions)",
    ]  # fmt: skip
    gap = {row["first"]: row for row in tables["twin_comparison"]["rows"] if row["measure"] == "success"}
    then_rate = next(r for r in tables["main"]["rows"] if r["agent"] == "always-then")["success"]["mean"]
    assert gap["always-then (oracle text)"]["difference"] == pytest.approx(1 - then_rate)
    assert gap["wrong-branch (oracle text)"]["difference"] == 0
    short = evaluate(then, wrong, "--oracle", oracle)
    assert short.exit_code != 0


@pytest.mark.parametrize("kept", [0, 3])
def test_missing_predictions_are_counted_aloud(
    evaluate: Any, export: Path, split: str, agents: dict[str, Path], tmp_path: Path, kept: int
) -> None:
    tasks = split_tasks(export, split)
    short = tmp_path / "short.json"
    whole = json.loads(agents["oracle"].read_text())
    some = dict(list(whole.items())[:kept])
    short.write_text(json.dumps(some))
    lacking = [int(task.episode_id) for task in tasks if task.episode_id not in some]
    document = json.loads(evaluate(short, agents["oracle"], "--json").stdout)
    warning, unchecked = document["warnings"]
    assert unchecked.startswith(f"justified is undefined in {len(tasks)} of {len(tasks)} episodes")
    count = f"{len(tasks) - kept} of {len(tasks)} episodes have no prediction"
    assert warning.startswith(f"{short}: {count}")
    first, second = document["predictions"]
    assert (first["file"], first["missing"], first["missing_ids"]) == (str(short), len(lacking), lacking)
    assert (second["episodes"], second["missing"], second["missing_ids"]) == (len(tasks), 0, [])
    # They stay failures.
    (main,) = (table for table in document["tables"] if table["name"] == "main")
    assert main["rows"][0]["success"]["mean"] == pytest.approx(kept / len(tasks))
    for form in ((), ("--latex",), ("--markdown",)):
        assert count in " ".join(evaluate(short, *form).output.split())
    refused = evaluate(short, "--strict")
    assert isinstance(refused.exception, FormatError)
    assert count in str(refused.exception)
    assert refused.exception.exit_code == 3
    assert evaluate(agents["oracle"], "--strict").exit_code == 0


def test_a_split_without_episodes_says_so(evaluate: Any, export: Path, agents: dict[str, Path], tmp_path: Path) -> None:
    copied = tmp_path / "export"
    shutil.copytree(export, copied)
    (copied / "manifest" / "val_seen.jsonl").write_text("")
    out = tmp_path / "nearest.json"
    for words in (["walk", str(copied), "val_seen", "--agent", "nearest", "--out", str(out)],
                  ["evaluate", str(copied), "val_seen", str(out)]):  # fmt: skip
        result = runner.invoke(app, words)
        assert result.exit_code == 0, result.output
        assert "the split has no episodes" in " ".join(result.output.split())


def broken(whole: dict[str, Any], kind: str) -> dict[str, Any]:
    """Predictions of which the first two are not walks of an agent."""
    changed = {name: [dict(pose) for pose in poses] for name, poses in whole.items()}
    for poses in list(changed.values())[:2]:
        if kind == "two poses":
            poses[1:-1] = []
        elif kind == "far away":
            poses.insert(1, {**poses[0], "position": [99_999.0, 0.0, 0.0]})
        elif kind == "above the floor":
            poses.insert(1, {**poses[0], "position": np.add(poses[0]["position"], [0, 0.6, 0]).tolist()})
    return changed


@pytest.mark.parametrize("kind", ["two poses", "far away", "above the floor"])
def test_walks_that_no_agent_can_have_made_are_named_and_refused_by_strict(
    evaluate: Any, agents: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "agent.json"
    whole = json.loads(agents["oracle"].read_text())
    path.write_text(json.dumps(broken(whole, kind)))
    names = [int(name) for name in list(whole)[:2]]  # as in the tables
    document = json.loads(evaluate(path, agents["oracle"], "--json").stdout)
    first, second = document["predictions"]
    off = kind != "two poses"
    assert first["gap_ids"] == names
    assert first["gaps"] >= 2
    assert (first["off_navmesh"], first["off_navmesh_ids"]) == ((2, names) if off else (0, []))
    assert (second["gaps"], second["off_navmesh"], second["notes"]) == (0, 0, [])
    said = " ".join(document["warnings"])
    assert "2 of " in said
    assert "episodes have steps that no single action can make" in said
    assert all(str(name) in said for name in names)
    assert ("off the navmesh" in said) is off
    refused = evaluate(path, "--strict")
    assert isinstance(refused.exception, FormatError)
    assert "steps that no single action can make" in str(refused.exception)
    main = documents(evaluate, path)["main"]["rows"][0]
    assert main["spl"]["mean"] <= main["success"]["mean"]


def test_a_longer_action_forward_is_named(
    evaluate: Any, export: Path, split: str, agents: dict[str, Path], tmp_path: Path
) -> None:
    """An agent that walks a metre at once, as VLN-Zero does."""
    path = tmp_path / "strides.json"
    walks = {task.episode_id: densify(task.gold.path, 1.0).tolist() for task in split_tasks(export, split)}
    path.write_text(
        json.dumps({name: [{"position": p, "stop": p is way[-1]} for p in way] for name, way in walks.items()})
    )
    assert "steps that no single action can make" in str(evaluate(path, "--strict").exception)
    assert evaluate(path, "--strict", "--forward-step", 1.0).exception is None
    for wrong in (0, -1, "nan", "inf"):
        assert isinstance(evaluate(path, "--forward-step", wrong).exception, UsageError)


def test_a_file_of_a_run_that_was_killed_and_started_again(
    evaluate: Any, split: str, agents: dict[str, Path], tmp_path: Path
) -> None:
    whole = json.loads(agents["oracle"].read_text())
    lines = [
        json.dumps({"episode_id": float(name), "path": [pose["position"] for pose in poses]})
        for name, poses in whole.items()
    ]
    path = tmp_path / "agent.jsonl"
    path.write_text("\n".join([*lines, lines[0], lines[1][:-20]]))
    assert "--duplicates keep-last" in str(evaluate(path).exception)
    path.write_text("\n".join([*lines[:-1], lines[-1][:-20]]))
    assert "--allow-partial" in str(evaluate(path).exception)
    path.write_text("\n".join([*lines, lines[0], lines[1][:-20]]))
    result = evaluate(path, "--duplicates", "keep-last", "--allow-partial", "--json", "--html", tmp_path / "page")
    document = json.loads(result.stdout)
    (row,) = next(table for table in document["tables"] if table["name"] == "main")["rows"]
    assert row["success"]["mean"] == 1
    assert len(document["predictions"][0]["notes"]) == 2
    assert len(document["warnings"]) == 3, "the notes, and that no scenes were named to justify walks in"
    assert isinstance(evaluate(path, "--duplicates", "first").exception, UsageError)


AGENT = """
class Seer:
    def __init__(self):
        self.seen = {}

    def begin(self, observation):
        self.turns = 0
        self.episode = observation.episode_id

    def act(self, observation):
        self.seen.setdefault(self.episode, set()).update(observation.labels)
        self.turns += 1
        if self.turns == 24:
            open("seen.txt", "a").write(" ".join(sorted(self.seen[self.episode])) + "\\n")
        return 2 if self.turns < 24 else 0

class Wild(Seer):
    def act(self, observation):
        return 7

class Deaf:
    pass
"""


def test_ones_own_agent_walks_and_sees(
    evaluate: Any,
    export: Path,
    split: str,
    made_run: tuple[Config, Report],
    made_dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    (tmp_path / "seer_agent.py").write_text(AGENT)
    (tmp_path / "run.yaml").write_text(made_run[0].model_dump_json())
    words = ["walk", str(export), split, "--data", str(made_dataset), "--out", "seer.json", "--agent"]
    result = runner.invoke(app, [*words, "seer_agent:Seer", "--objects", "run.yaml"])
    assert result.exit_code == 0, result.output
    # a whole turn on the spot: it sees what is about, stops where it began, and reaches nothing
    seen = (tmp_path / "seen.txt").read_text().splitlines()
    assert any(seen)
    main = documents(evaluate, tmp_path / "seer.json")["main"]["rows"][0]
    assert (main["success"]["mean"], main["path_length"]["mean"]) == (0, 0)
    assert main["episodes"] == len(seen)
    branches = documents(evaluate, tmp_path / "seer.json")["branches"]["rows"][0]
    assert branches["collisions"]["mean"] == 0  # turns meet nothing, and that is known
    (tmp_path / "seen.txt").unlink()
    assert runner.invoke(app, [*words, "seer_agent:Seer"]).exit_code == 0
    assert not any((tmp_path / "seen.txt").read_text().split())  # without objects there is nothing to see
    for name in ("seer_agent:Deaf", "seer_agent:Nobody", "no_such_module:A", "seer_agent:Wild", "nobody"):
        assert runner.invoke(app, [*words, name]).exit_code != 0


def chunks(page: Path) -> dict[str, Any]:
    return dict(chunk_content(path.read_bytes()) for path in sorted((page / "data").glob("*.js")))


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--distance", "euclidean", "--radius", 2, "--radius", 4, "--oracle-radius", 30, "--fast-dtw"),
        ("--assume-stop",),
    ],
    ids=["plain", "distances", "stop"],
)
def test_the_page_has_the_scores_of_its_evaluation(
    evaluate: Any, split: str, agents: dict[str, Path], tmp_path: Path, options: tuple[Any, ...]
) -> None:
    never = json.loads(agents["oracle"].read_text())
    for poses in never.values():
        for pose in poses:
            pose.pop("stop")
    (tmp_path / "walker.json").write_text(json.dumps(never))
    files = [tmp_path / "walker.json", agents["always-then"], agents["wrong-branch"]]
    written = [*files, *options, "--html", tmp_path / "page", "--scores", tmp_path / "scores.jsonl"]
    tables = documents(evaluate, *written)
    found = chunks(tmp_path / "page")
    shown = {table["name"]: table for table in found["agents"]["tables"]}
    differences = shown.pop("differences")["rows"]
    assert [*shown] == [*tables]
    for name, table in tables.items():
        assert {key: shown[name][key] for key in table} == table
        assert shown[name]["split"] == split
        assert all(len(row) == len(shown[name]["headings"]) for row in shown[name]["cells"])
    assert ("sweep" in shown) is ("--radius" in options)
    index = found["index"]
    assert [agent["name"] for agent in index["agents"]] == [path.stem for path in files]
    scores = [json.loads(line) for line in (tmp_path / "scores.jsonl").read_text().splitlines()]
    for agent in index["agents"]:
        assert agent["splits"] == [split]
        own = {str(row["episode_id"]): row for row in scores if row["agent"] == agent["name"]}
        for k, name in enumerate(index["columns"]["id"]):
            assert (agent["outcome"][k] == index["outcomes"].index("success")) is (
                name in own and own[name]["success"] == 1
            )
            for measure, values in agent["scores"].items():
                wanted = own[name][measure] if name in own else None
                assert values[k] == (None if wanted is None else pytest.approx(wanted, abs=1e-4))
    means = {path.stem: np.mean([row["success"] for row in scores if row["agent"] == path.stem]) for path in files}
    overall = [row for row in differences if row["axis"] == "all"]
    assert len(overall) == len(files) * (len(files) - 1)
    for row in overall:
        wanted = means[row["first"]] - means[row["second"]]
        assert row["success"]["mean"] == pytest.approx(wanted, abs=1e-9)
        assert row["own"] - row["other"] == pytest.approx(wanted, abs=1e-9)
    rates = {row["agent"]: row["success"]["mean"] for row in shown["main"]["rows"]}
    assert rates["walker"] == (1.0 if "--assume-stop" in options else 0.0)
    walks = {name: walk for key, many in found.items() if key.startswith("walks-") for name, walk in many.items()}
    assert walks
    assert all(walk.keys() == {path.stem for path in files} for walk in walks.values())
    assert {walk["walker"]["stopped"] for walk in walks.values()} == {"--assume-stop" in options}


def test_the_page_has_the_oracle_twin(evaluate: Any, agents: dict[str, Path], tmp_path: Path) -> None:
    files = [agents["always-then"], "--oracle", agents["oracle"]]
    tables = documents(evaluate, *files, "--html", tmp_path / "page")
    found = chunks(tmp_path / "page")
    names = [table["name"] for table in found["agents"]["tables"]]
    assert names == [*tables, "differences"]
    assert "twin_main" in names
    assert [agent["name"] for agent in found["index"]["agents"]] == ["always-then", "always-then (oracle text)"]
    wanted = {row["agent"]: row["success"]["mean"] for row in tables["twin_main"]["rows"]}
    for agent in found["index"]["agents"]:
        own = [outcome for outcome in agent["outcome"] if outcome]
        rate = sum(outcome == found["index"]["outcomes"].index("success") for outcome in own) / len(own)
        label = agent["name"] if agent["name"].endswith(")") else f"{agent['name']} (conditions)"
        assert rate == pytest.approx(wanted[label])


def test_osr_and_ndtw_as_stock_vlnce_has_them(evaluate: Any, agents: dict[str, Path]) -> None:
    (ours,) = documents(evaluate, agents["wrong-branch"])["main"]["rows"]
    (stock,) = documents(evaluate, agents["wrong-branch"], "--oracle-radius", 1000, "--fast-dtw")["main"]["rows"]
    assert stock["oracle_success"]["mean"] == 1 > ours["oracle_success"]["mean"]
    assert stock["ndtw"]["mean"] <= ours["ndtw"]["mean"]  # an approximation from above, of a distance
    assert {key for key in ours if ours[key] != stock[key]} <= {"oracle_success", "ndtw"}


def test_subgoals_as_the_two_forks_count_them(evaluate: Any, agents: dict[str, Path]) -> None:
    modes = ("geodesic", "euclidean", "euclidean-any-order")
    rows = [documents(evaluate, agents["wrong-branch"], "--distance", mode)["main"]["rows"][0] for mode in modes]
    for row in rows:
        assert {key for key in row if row[key] != rows[0][key]} <= {"bsa", "csr", "bsa_all", "csr_all"}
    in_order, any_order = (row["bsa_all"]["mean"] for row in rows[1:])
    assert in_order <= any_order


def test_one_step_budget_for_files_configurations_walker_and_evaluator(
    export: Path, split: str, made_dataset: Path
) -> None:
    said = {row["max_steps"] for path in (export / "manifest").glob("*.jsonl") for row in map(json.loads, path.open())}
    for path in export.glob("*/*/*.json.gz"):
        document = read(path)
        said |= {episode["info"]["max_steps"] for episode in document.get("episodes", [])}
    steps = [
        yaml.safe_load(path.read_text())["ENVIRONMENT"]["MAX_EPISODE_STEPS"]
        for path in (export / "configs").glob("*/*task.yaml")
        if "open_nav" not in path.parts  # counts waypoints
    ]
    lab = yaml.safe_load((export / "configs" / "habitat_lab" / "condvln.yaml").read_text())
    said |= {*steps, lab["habitat"]["environment"]["max_episode_steps"]}
    assert said == {500}
    opened = open_export(export, [made_dataset])
    for task in opened.tasks(split)[:3]:

        class Late:
            """Turns until STOP is the last action that counts."""

            def begin(self, observation: Observation) -> None: ...

            def act(self, observation: Observation) -> int:
                return 0 if observation.step == self.last else 2

            last = 499

        agent = Late()
        walked = walk(task, agent, opened.pathfinder(task))
        assert (len(walked.positions) - 1, walked.stopped) == (500, True)
        agent.last = 500
        assert not walk(task, agent, opened.pathfinder(task)).stopped
        late = walk_to_leaf(task, opened.pathfinder(task), task.gold_leaf)
        turns = np.repeat(late.positions[:1], 500 - (len(late.positions) - 1), axis=0)
        for spare, success in ((turns, 1), (np.vstack([turns, turns[:1]]), 0)):
            made = Prediction(task.episode_id, np.vstack([spare, late.positions]), True, True)
            scores = evaluate_tasks([task], [made], opened.pathfinder).scores
            assert (scores["success"][0], scores["over_budget"][0]) == (success, 1 - success)


def test_sensors_and_info_measure_to_one_goal(export: Path, made_dataset: Path) -> None:
    opened = open_export(export, [made_dataset])
    several, other_end = 0, 0
    for split in opened.splits:
        for row in opened.episodes(split):
            nav = opened.pathfinder(row)
            for leaf in row.leaves:
                ways = [nav.geodesic_distance(row.start_position, goal) for goal in leaf.goals]
                assert ways[0] == min(ways) == pytest.approx(leaf.geodesic_distance, abs=1e-6)
                several += len(ways) > 1
                other_end += math.dist(leaf.goals[0], leaf.reference_path[-1]) > 0.01
            gold = row.leaves[row.gold_leaf]
            assert row.geodesic_distance == gold.geodesic_distance
            # VLN-CE's progress sensor: the first goal alone, against the distance in info
            at_start = nav.geodesic_distance(row.start_position, gold.goals[0])
            assert 1 - at_start / row.geodesic_distance == pytest.approx(0, abs=1e-6)
    assert several
    assert other_end, "routes past stops may end at another goal"


@pytest.mark.parametrize(
    "words", [("--radius", "0"), ("--radius", "nan"), ("--oracle-radius", "-1"), ("--distance", "taxi")]
)
def test_wrong_usage(evaluate: Any, agents: dict[str, Path], words: tuple[str, str]) -> None:
    assert evaluate(agents["oracle"], *words).exit_code != 0
