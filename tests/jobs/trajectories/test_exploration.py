"""Exploration walks: they look at the evidence of each condition, in order, and then walk to the gold leaf."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from condvln.evaluation.export_folder import open_export
from condvln.samples import make_samples
from condvln.sensors import open_renderer
from condvln.sources.registry import open_source
from jobs.generate import run_generate
from jobs.trajectories import Request, make_trajectories
from schemas.config import CameraConfig, Config, Family, InstructionsConfig, SourceConfig, TrajectoryConfig
from schemas.errors import ProofError
from schemas.program import CATEGORIES
from tests.jobs.trajectories.made import proven, rows, to

WIDE = CameraConfig(width=160, height=120, hfov=79.0, max_depth=None, normalized=False)


@pytest.fixture(scope="module")
def explored(asked: Request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Exploration walks of the whole split, as a recipe; read only."""
    out = tmp_path_factory.mktemp("explored") / "out"
    config = TrajectoryConfig(walks=("exploration",))
    report = make_trajectories(to(asked, out, config=config, layouts=("streamvln",), recipe_only=True))
    assert report.exit_code == 0
    return out


def request_of(folder: Path, family: Family, scenes: int, seed: int, episodes: int, **more: Any) -> Request:
    """A request for exploration walks over the largest split of an export of made scenes.

    episodes : asked of each category in each scene
    """
    make_samples(folder / "data", family=family, scenes=scenes, seed=seed)
    config = Config(
        name="made",
        store=folder / "store",
        export=folder / "export",
        sources=(SourceConfig(family=family, root=folder / "data"),),
        instructions=InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, episodes)),
    )
    assert run_generate(config, inline=True).exit_code == 0
    counts: dict[str, int] = json.loads((folder / "export" / "export.json").read_text())["episodes"]
    return Request(
        target=str(folder / "export"),
        out=folder / "out",
        split=max(counts, key=lambda name: counts[name]),
        camera="tiny",
        config=TrajectoryConfig(walks=("exploration",)),
        layouts=("streamvln",),
        scenes=(f"{family}={folder / 'data'}",),
        inline=True,
        recipe_only=True,
        **more,
    )


def walks_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    return {name: [*group] for name, group in groupby(rows(folder, "poses"), lambda row: row["trajectory"])}


def test_most_episodes_have_a_walk_and_all_are_proven(asked: Request, explored: Path) -> None:
    made, left_out = rows(explored, "trajectories"), rows(explored, "left_out")
    assert len(made) >= 3 * len(left_out)
    assert {row["kind"] for row in made} == {"exploration"}
    assert all(row["n_frames"] <= row["max_steps"] for row in made)
    report = proven(asked, explored, render_every=200)
    assert report.document["faults"] == []
    assert report.document["looked_for"] >= len(made)


@pytest.mark.parametrize("seed", [2, 5])
def test_things_are_seen_from_where_a_level_camera_sees_them(seed: int, tmp_path: Path) -> None:
    """In small rooms low things are below the view of whoever stands right before them. A plan expects the frames of
    looking, also of walks that are left out in the end: they are in the expectation, and not in the count.
    """
    asked = request_of(tmp_path, "gibson", scenes=1, seed=seed, episodes=6, licensed=True)
    assert make_trajectories(asked).exit_code == 0
    report = proven(asked, asked.out, render_every=0)
    assert report.document["faults"] == []
    assert report.document["walks"] > 15
    plan = make_trajectories(to(asked, tmp_path / "planned", plan=True)).document["plan"]
    made, left_out = rows(asked.out, "trajectories"), rows(asked.out, "left_out")
    frames = sum(row["n_frames"] for row in made) * (len(made) + len(left_out)) / len(made)
    assert frames * 0.7 < plan["frames"] < frames * 1.4


def test_the_conditions_of_the_gold_route_are_looked_for_in_order(asked: Request, explored: Path) -> None:
    export = open_export(asked.target, [Path(asked.scenes[0].partition("=")[2])])
    episodes = {int(episode.episode_id): episode for episode in export.episodes(asked.split)}
    looked = 0
    for poses in walks_of(explored).values():
        episode = episodes[poses[0]["episode_id"]]
        runs = [(key, len([*group])) for key, group in groupby(poses, lambda row: (row["looks_for"], row["leaf"]))]
        *before, (last, _) = runs
        assert last == (None, episode.gold_leaf)
        assert all(leaf == -1 for (_, leaf), _ in before)
        route = [*dict.fromkeys(episode.program.route()[0])]
        asked_for = [number for (number, _), _ in before]
        assert asked_for == [number for number in route if number in asked_for]
        looked += sum(count for _, count in before)
    assert looked > 20


def test_the_renderer_shows_a_witness_before_the_decision(tmp_path: Path) -> None:
    """Another implementation of sight: instance images of the camera."""
    asked = request_of(tmp_path, "replicacad", scenes=3, seed=8, episodes=8)
    explored = asked.out
    assert make_trajectories(asked).exit_code == 0
    root = Path(asked.scenes[0].partition("=")[2])
    source = open_source("replicacad", root)
    scenes = {name: source.read(name) for name in source.scene_ids()}
    renderers = {name: open_renderer(scene, source.geometry(scene)) for name, scene in scenes.items()}
    export = open_export(asked.target, [root])
    episodes = {int(episode.episode_id): episode for episode in export.episodes(asked.split)}
    shown = []
    for poses in walks_of(explored).values():
        episode = episodes[poses[0]["episode_id"]]
        scene = scenes[episode.scene_id]
        number = {thing.object_id: at + 1 for at, thing in enumerate(scene.objects)}
        # The last action of looking leads to the next frame.
        before = poses[: 1 + sum(row["looks_for"] is not None for row in poses)]
        for k in dict.fromkeys(episode.program.route()[0]):
            condition = episode.program.conditions[k]
            if not condition.truth:
                continue
            witnesses = {number[name] for name in condition.witnesses}
            found: set[int] = set()
            for row in before:
                place = [row["position"][axis] for axis in "xyz"]
                frame = renderers[episode.scene_id].look(WIDE, place, row["heading"], rgb=False)
                found |= set(np.unique(frame.instance).tolist())
                if found & witnesses:
                    break
            shown.append(bool(found & witnesses))
    assert len(shown) > 20
    assert np.mean(shown) > 0.9


def test_a_walk_that_decides_first_is_a_fault(asked: Request, explored: Path, tmp_path: Path) -> None:
    for name in ("trajectories.json", "trajectories.parquet", "left_out.parquet"):
        (tmp_path / name).write_bytes((explored / name).read_bytes())
    poses = rows(explored, "poses")
    name = next(row["trajectory"] for row in poses if row["looks_for"] is not None)
    for row in poses:
        if row["trajectory"] == name and row["frame"] == 0:
            row |= {"looks_for": None, "leaf": poses[-1]["leaf"]}
    schema = pq.read_schema(explored / "poses.parquet")
    pq.write_table(pa.Table.from_pylist(poses, schema=schema), tmp_path / "poses.parquet")
    report = proven(asked, tmp_path, render_every=0)
    assert report.exit_code == ProofError.exit_code
    assert {fault["trajectory"] for fault in report.document["faults"]} == {name}


def test_a_walk_that_decides_without_looking_is_a_fault(asked: Request, explored: Path, tmp_path: Path) -> None:
    """Each walk claims that it knew everything at the start: whoever had to look is found out, and nobody else."""
    for name in ("trajectories.json", "trajectories.parquet", "left_out.parquet"):
        (tmp_path / name).write_bytes((explored / name).read_bytes())
    poses = rows(explored, "poses")
    looked = {row["trajectory"] for row in poses if row["looks_for"] is not None}
    gold = {row["trajectory"]: row["leaf"] for row in poses}
    for row in poses:
        row |= {"looks_for": None, "leaf": gold[row["trajectory"]]}
    schema = pq.read_schema(explored / "poses.parquet")
    pq.write_table(pa.Table.from_pylist(poses, schema=schema), tmp_path / "poses.parquet")
    found = proven(asked, tmp_path, render_every=0).document["faults"]
    assert len(looked) > 2
    assert {fault["trajectory"] for fault in found} == looked
    assert all("is decided before its evidence is seen" in fault["what"] for fault in found)
