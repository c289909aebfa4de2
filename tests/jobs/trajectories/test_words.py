"""What samples say, replayed as the agents that read them mean it; and the prompts that they send."""

from __future__ import annotations

import json
import math
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from condvln.navigation.follower import VLN_CE, ActionSpace, Follower
from condvln.trajectories.hub import Hub, SceneWalks
from condvln.trajectories.uninavid import uninavid
from jobs.trajectories import Request, make_trajectories
from jobs.trajectory_units import find_split
from jobs.verify_trajectories import trajectory_world
from schemas.config import TrajectoryConfig
from schemas.errors import UsageError
from tests.jobs.trajectories.made import FIFTEEN, THIRTY, WALKS, proven, rows, to


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    out = tmp_path / "copy"
    shutil.copytree(made, out, copy_function=os.link, ignore=shutil.ignore_patterns(".condvln"))
    return out


def test_walks_of_30_degrees_are_proven_and_each_word_leads_to_the_goal(asked: Request, wide: Path) -> None:
    report = proven(asked, wide, render_every=100)
    assert report.document["faults"] == []
    assert report.document["layout_walks"] == dict.fromkeys(THIRTY, len(rows(wide, "trajectories")))
    assert json.loads((wide / "trajectories.json").read_bytes())["config"]["turn"] == 30


def test_gold_answers_of_uninavid_succeed_at_30_degrees(asked: Request, wide: Path) -> None:
    """As an evaluation replays them: four words a sample, the next sample four frames on."""
    world = trajectory_world(find_split(asked.target, asked.split, asked.scenes))
    samples = {}
    for entry in json.loads((wide / "uninavid" / "annotations.json").read_bytes()):
        walk, _, frame = entry["id"].removeprefix("NAV_ID_").rpartition("_")
        samples[walk, int(frame)] = entry["conversations"][1]["value"].split()
    numbers = {"stop": 0, "forward": 1, "left": 2, "right": 3}
    replayed = 0
    for walk in rows(wide, "trajectories"):
        if walk["kind"] != "direct":
            continue
        actions: list[int] = []
        while 0 not in actions:
            actions += [numbers[word] for word in samples[walk["trajectory"], len(actions)]]
        episode = world.episodes[walk["episode_id"]]
        pathfinder = world.pathfinder(episode)
        heading = 2 * math.atan2(episode.start_rotation[1], episode.start_rotation[3])
        follower = Follower(pathfinder, ActionSpace(0.25, 30.0))
        end = follower.walk(episode.start_position, heading, actions).positions[-1]
        goals = np.array([[goal[axis] for axis in "xyz"] for goal in walk["goals"]])
        assert pathfinder.distance_table(end[None], goals).min() <= episode.success_distance
        replayed += 1
    assert replayed > 10


def test_words_of_30_degrees_on_walks_of_15_are_a_fault(asked: Request, copy: Path) -> None:
    """As a release before wrote them: each word is the walk's own action, and leads elsewhere."""
    tables = {name: pq.read_table(copy / f"{name}.parquet") for name in ("trajectories", "poses")}
    with uninavid(Hub(copy, asked.split, {}, VLN_CE)) as add:
        add(SceneWalks("replicacad", "all", tables))
    record = json.loads((copy / "trajectories.json").read_bytes())
    (copy / "trajectories.json").unlink()
    (copy / "trajectories.json").write_text(json.dumps(record | {"layouts": [*record["layouts"], "uninavid"]}))
    found = [fault["what"] for fault in proven(asked, copy, render_every=0).document["faults"]]
    said = [what for what in found if what.startswith("uninavid: its words lead")]
    assert found == said
    assert len(said) > len(rows(copy, "trajectories")) * 0.9
    assert any("turns of 30°" in what for what in said)


ANSWERS = (
    (" 15 degrees", " 30 degrees", "its words lead"),
    ("left", "right", "its words lead"),
    ("25 cm", "20 cm", "an answer is 'The next action is move forward 20 cm.'"),
)
"""What answers say, what they say instead, and the fault that must be found; each in every third walk."""


def test_words_that_mean_other_sizes_are_found(asked: Request, copy: Path) -> None:
    third = {row["trajectory"]: number % 3 for number, row in enumerate(rows(copy, "trajectories"))}
    path, info = copy / "navila" / "annotations.json", copy / "lerobot" / "meta" / "info.json"
    answers = [json.loads(line) for line in path.read_bytes().splitlines()]
    for row in answers:
        said, instead, _ = ANSWERS[third[row["video_id"].rpartition("_")[0]]]
        row["a"] = row["a"].replace(said, instead)
    path.unlink()
    path.write_text("".join(json.dumps(row) + "\n" for row in answers))
    document = json.loads(info.read_bytes())
    document["features"]["action"]["info"]["turn_degrees"] = 30.0
    info.unlink()
    info.write_text(json.dumps(document))
    faults = proven(asked, copy, render_every=0).document["faults"]
    for number, (_, _, what) in enumerate(ANSWERS):
        whose = [fault["what"] for fault in faults if third.get(fault["trajectory"]) == number]
        assert any(one.startswith(f"navila: {what}") for one in whose)
        assert any(one.startswith("lerobot: its words lead") for one in whose)
    assert all(fault["what"].startswith(("navila: ", "lerobot: ")) for fault in faults)


def test_layouts_that_mean_other_sizes_are_refused_before_anything_is_made(asked: Request, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="one walk can't have both"):
        make_trajectories(to(asked, tmp_path / "out", layouts=(*FIFTEEN, "uninavid")))
    config = TrajectoryConfig(walks=WALKS.walks, turn=30)
    with pytest.raises(UsageError, match="would mean other walks"):
        make_trajectories(to(asked, tmp_path / "out", layouts=("navila",), config=config))
    assert not (tmp_path / "out").exists()


def test_a_folder_of_other_actions_has_no_annotations_of_streamvln(wide: Path, asked: Request, tmp_path: Path) -> None:
    assert json.loads((wide / "trajectories.json").read_bytes())["layouts"] == [*THIRTY]
    out = tmp_path / "out"
    shutil.copytree(wide, out, copy_function=os.link)
    report = make_trajectories(to(asked, out, layouts=("uninavid",)))
    assert report.exit_code == 0
    assert not (out / "annotations.json").exists()
    assert proven(asked, out, render_every=0).document["faults"] == []


def human(entry: dict[str, Any]) -> str:
    return str(entry["conversations"][0]["value"])


def test_prompts_are_what_the_agents_send(made: Path, wide: Path) -> None:
    """``offline_eval_uninavid.py`` of jzhzhang/Uni-NaVid, and ``call_model`` in ``src/evaluation.py`` of
    MIV-XJTU/JanusVLN: the system's turn, then images and text of the user's.
    """
    texts = {row["trajectory"]: row["instruction_text"] for row in rows(wide, "trajectories")}
    for entry in json.loads((wide / "uninavid" / "annotations.json").read_bytes()):
        text = texts[entry["id"].removeprefix("NAV_ID_").rpartition("_")[0]]
        assert human(entry) == (
            "Imagine you are a robot programmed for navigation tasks. You have been given a video of historical "
            "observations and an image of the current observation <image>. Your assigned task is: '"
            f"{text}'. Analyze this series of images to determine your next four actions. The predicted action should "
            "be one of the following: forward, left, right, or stop."
        )
    texts = {row["trajectory"]: row["instruction_text"] for row in rows(made, "trajectories")}
    system = (
        "You are a visual language navigation model, and your should go to the locations to complete the given task. "
        "Compare the observation and instruction to infer your current progress, and then select the correct direction "
        "from the candidates to go to the target location and finish the task."
    )
    for sample in json.loads((made / "janusvln" / "train.json").read_bytes()):
        user = (
            "These images are your historical observations and your current observation.\n Your task is to "
            f"{texts[sample['id'].split('/')[1]]} \n You should take one of the following actions:\n MOVE_FORWARD\n "
            "TURN_LEFT\n TURN_RIGHT\n STOP."
        )
        assert human(sample) == f"{system}\n {'<image>' * len(sample['images'])}{user}"
