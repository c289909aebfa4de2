"""Looking walks: those of the episodes, which see the evidence of each condition before they act on it."""

from __future__ import annotations

import json
import math
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from condvln.evaluation.split import open_export
from condvln.sensors import open_renderer
from condvln.sources.registry import open_source
from jobs.generate import run_generate
from jobs.trajectories import Request, make_trajectories
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import ProofError
from schemas.evaluation import ManifestEpisode
from tests.jobs.conftest import made_config
from tests.jobs.trajectories.made import proven, rows, to

STREAMVLN = CameraConfig(width=640, height=480, hfov=79.0, max_depth=None, normalized=False)


@pytest.fixture(scope="module")
def looked(asked: Request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Looking walks of the whole split, as a recipe; read only."""
    out = tmp_path_factory.mktemp("looked") / "out"
    config = TrajectoryConfig()
    assert config.walks == ("looking",)
    report = make_trajectories(to(asked, out, config=config, layouts=("streamvln",), recipe_only=True))
    assert report.exit_code == 0
    return out


def walks_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    return {name: [*group] for name, group in groupby(rows(folder, "poses"), lambda row: row["trajectory"])}


def episodes_of(asked: Request) -> dict[int, ManifestEpisode]:
    export = open_export(asked.target, [Path(asked.scenes[0].partition("=")[2])])
    return {int(episode.episode_id): episode for episode in export.episodes(asked.split)}


def test_every_episode_has_its_walk_and_all_are_proven(asked: Request, looked: Path) -> None:
    episodes, made = episodes_of(asked), rows(looked, "trajectories")
    assert rows(looked, "left_out") == []
    assert {row["episode_id"]: tuple(row["actions"]) for row in made} == {
        name: episode.looking_actions for name, episode in episodes.items()
    }
    assert proven(asked, looked, render_every=200).document["faults"] == []
    for poses in walks_of(looked).values():
        episode = episodes[poses[0]["episode_id"]]
        decided = dict(zip(dict.fromkeys(episode.program.route()[0]), episode.looking_decided or (), strict=True))
        for row in poses:
            open_ones = [number for number, frame in decided.items() if row["frame"] < frame]
            assert row["looks_for"] == (open_ones[0] if open_ones else None)
            assert row["leaf"] == (-1 if open_ones else episode.gold_leaf)


def test_a_plan_expects_the_frames_of_the_walks(asked: Request, looked: Path, tmp_path: Path) -> None:
    planned = to(asked, tmp_path, config=TrajectoryConfig(), layouts=("streamvln",), plan=True)
    frames = sum(row["n_frames"] for row in rows(looked, "trajectories"))
    assert make_trajectories(planned).document["plan"]["frames"] == frames


def test_frames_show_the_evidence_before_the_decision_and_the_goal_at_the_end(tmp_path: Path) -> None:
    """Another implementation of sight: instance images of the project's camera, as in training data."""
    assert run_generate(made_config(tmp_path, "replicacad", 2, 8, episodes=6), inline=True).exit_code == 0
    counts: dict[str, int] = json.loads((tmp_path / "export" / "export.json").read_text())["episodes"]
    asked = Request(
        target=str(tmp_path / "export"),
        out=tmp_path / "out",
        split=max(counts, key=lambda name: counts[name]),
        camera="tiny",
        layouts=("streamvln",),
        scenes=(f"replicacad={tmp_path / 'data'}",),
        inline=True,
        recipe_only=True,
    )
    assert make_trajectories(asked).exit_code == 0
    source = open_source("replicacad", tmp_path / "data")
    scenes = {name: source.read(name) for name in source.scene_ids()}
    renderers = {name: open_renderer(scene, source.geometry(scene)) for name, scene in scenes.items()}
    episodes = episodes_of(asked)
    shown, ends = [], []
    for poses in walks_of(asked.out).values():
        episode = episodes[poses[0]["episode_id"]]
        number = {thing.object_id: at + 1 for at, thing in enumerate(scenes[episode.scene_id].objects)}

        def seen(row: dict[str, Any], scene_id: str = episode.scene_id) -> set[int]:
            place = [row["position"][axis] for axis in "xyz"]
            frame = renderers[scene_id].look(STREAMVLN, place, row["heading"], rgb=False)
            return {*np.unique(frame.instance).tolist()}

        met = [episode.program.conditions[k] for k in dict.fromkeys(episode.program.route()[0])]
        wanted = [{number[name] for name in condition.witnesses} for condition in met if condition.truth]
        missing = wanted
        for row in reversed(poses[: max(episode.looking_decided or ()) + 1]):
            if not missing:
                break  # no frame before needs to be rendered
            there = seen(row)
            missing = [names for names in missing if not names & there]
        shown += [names not in missing for names in wanted]
        goal = scenes[episode.scene_id].object_of[episode.program.leaves[episode.gold_leaf].goal.object_id]
        x, _, z = goal.center - [poses[-1]["position"][axis] for axis in "xyz"]
        off = math.remainder(math.atan2(-x, -z) - poses[-1]["heading"], 2 * math.pi)
        assert abs(off) <= math.radians(7.5) + 1e-6
        ends.append(number[goal.object_id] in seen(poses[-1]))
    assert min(len(shown), len(ends)) > 10
    assert np.mean(shown) >= 0.99
    assert np.mean(ends) >= 0.99


def test_a_walk_that_decides_first_is_a_fault(asked: Request, looked: Path, tmp_path: Path) -> None:
    for name in ("trajectories.json", "trajectories.parquet", "left_out.parquet"):
        (tmp_path / name).write_bytes((looked / name).read_bytes())
    poses = rows(looked, "poses")
    name = next(row["trajectory"] for row in poses if row["looks_for"] is not None)
    for row in poses:
        if row["trajectory"] == name and row["frame"] == 0:
            row |= {"looks_for": None, "leaf": poses[-1]["leaf"]}
    schema = pq.read_schema(looked / "poses.parquet")
    pq.write_table(pa.Table.from_pylist(poses, schema=schema), tmp_path / "poses.parquet")
    report = proven(asked, tmp_path, render_every=0)
    assert report.exit_code == ProofError.exit_code
    assert {fault["trajectory"] for fault in report.document["faults"]} == {name}
