"""``condvln trajectories``: walks that replay to their poses, images that repeat, runs that go on after a stop."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from PIL import Image

from condvln.evaluation.split import open_export
from condvln.formats.image_files import jpeg
from condvln.navigation.follower import Follower
from condvln.scene.rotations import heading_of
from condvln.sensors import open_renderer
from condvln.sources.registry import open_source
from jobs.trajectories import Request, make_trajectories, trajectory_config
from schemas.errors import FormatError, ProofError, UsageError
from tests.jobs.trajectories.made import FIFTEEN, TINY, WALKS, content, proven, rows, to


def test_every_walk_replays_to_its_poses_and_ends_at_the_goal(asked: Request, made: Path) -> None:
    export = open_export(asked.target, [Path(asked.scenes[0].partition("=")[2])])
    episodes = {int(episode.episode_id): episode for episode in export.episodes(asked.split)}
    walks = rows(made, "trajectories")
    assert {row["kind"] for row in walks} == {"direct", "oracle", "recovery"}
    assert {row["episode_id"] for row in walks if row["kind"] == "direct"} == set(episodes)
    poses: dict[str, list[dict[str, Any]]] = {}
    for row in rows(made, "poses"):
        poses.setdefault(row["trajectory"], []).append(row)
    slipped = 0
    for walk in walks:
        episode = episodes[walk["episode_id"]]
        found = [row for row in poses[walk["frames_of"]] if row["camera"] == "rgb"]
        assert [row["frame"] for row in found] == [*range(walk["n_frames"])]
        assert [row["executed"] for row in found] == walk["executed"]
        pathfinder = export.pathfinder(episode)
        replay = Follower(pathfinder).walk(episode.start_position, heading_of(episode.start_rotation), walk["executed"])
        places = np.array([[row["position"][axis] for axis in "xyz"] for row in found])
        np.testing.assert_array_equal(places, replay.positions[:-1].astype(np.float64))
        np.testing.assert_array_equal([row["heading"] for row in found], replay.headings[:-1])
        goals = [[goal[axis] for axis in "xyz"] for goal in walk["goals"]]
        left = pathfinder.distance_table(places[-1:], goals).min()
        assert left <= walk["success_distance"]
        assert found[-1]["distance_to_goal"] == left
        wrong = np.array(walk["actions"]) != np.array(walk["executed"])
        assert walk["actions"][-1] == 0
        assert walk["repeats"] == (~wrong).astype(int).tolist()
        assert wrong.any() == (walk["kind"] == "recovery")
        slipped += int(wrong.sum())
    assert slipped


def test_the_images_are_what_the_renderer_draws(asked: Request, made: Path) -> None:
    source = open_source("replicacad", asked.scenes[0].partition("=")[2])
    scenes = {name: source.read(name) for name in source.scene_ids()}
    renderers = {name: open_renderer(scene, source.geometry(scene)) for name, scene in scenes.items()}
    for row in [row for row in rows(made, "poses") if row["camera"] == "rgb"][::97]:
        data = (made / row["image"]).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (row["bytes"], row["sha256"])
        assert Image.open(made / row["image"]).size == (32, 24) == (row["width"], row["height"])
        place = [row["position"][axis] for axis in "xyz"]
        frame = renderers[row["scene_id"]].look(TINY, place, row["heading"])
        assert jpeg(frame.rgb, WALKS.jpeg_quality) == data
        assert row["rotation"]["y"] == pytest.approx(math.sin(row["heading"] / 2))


def test_annotations_are_streamvln_s(made: Path) -> None:
    walks = {row["trajectory"]: row for row in rows(made, "trajectories")}
    entries = json.loads((made / "annotations.json").read_bytes())
    assert len(entries) == len(walks)
    for entry in entries:
        walk = walks[entry["trajectory"]]
        images = sorted(path.name for path in (made / entry["video"] / "rgb").iterdir())
        assert images == [f"{k:03d}.jpg" for k in range(1, walk["n_frames"] + 1)]
        assert len(entry["actions"]) == len(images)
        assert [*entry["actions"][1:], 0] == walk["actions"]
        assert entry["instructions"] == [walk["instruction_text"]]
        assert entry["id"] == walk["episode_id"]


def test_pairs_of_cameras_are_internvla_n1_s(made: Path) -> None:
    walks = {row["trajectory"]: row for row in rows(made, "trajectories")}
    lines = 0
    goals = []
    for scene in (made / "internvla-n1").iterdir():
        for line in (scene / "meta" / "episodes.jsonl").read_bytes().splitlines():
            entry = json.loads(line)
            walk, lines = walks[entry["trajectory"]], lines + 1
            number, count = entry["episode_index"], walk["n_frames"]
            data = pq.read_table(scene / "data" / "chunk-000" / f"episode_{number:06d}.parquet").to_pydict()
            assert data["action"] == [-1, *walk["actions"][:-1]]
            assert len(data["action"]) == entry["length"] == count
            for kind, suffix in (("rgb.125cm_0deg", "jpg"), ("rgb.125cm_30deg", "jpg"), ("depth.125cm_30deg", "png")):
                images = scene / "videos" / "chunk-000" / f"observation.images.{kind}"
                assert all((images / f"episode_{number:06d}_{frame}.{suffix}").is_file() for frame in range(count))
            assert Image.open(images / f"episode_{number:06d}_0.png").mode == "I;16"
            poses = np.array(data["pose.125cm_30deg"])
            assert poses.shape == (count, 4, 4)
            for frame, ahead in enumerate(data["relative_goal_frame_id.125cm_30deg"]):
                if ahead < 0:
                    continue
                column, row = data["goal.125cm_30deg"][frame]
                assert 0 <= column < 32
                assert 0 <= row < 24
                # The goal's pixel is where the place reached `ahead` frames later is projected.
                feet = poses[frame + ahead][:3, 3] - [0, 1.25, 0]
                x, y, z = np.linalg.solve(poses[frame], [*feet, 1])[:3]
                focal = 16 / math.tan(math.radians(39.5))
                middle = [column + 0.5, row + 0.5]
                np.testing.assert_allclose([16 + focal * x / z, 12 + focal * y / z], middle, atol=0.5001)
                goals.append(ahead)
    assert lines == len(walks)
    assert len(goals) > 20
    assert max(goals) > 3


def test_a_scene_of_internvla_n1_is_a_dataset_of_lerobot_2_1(asked: Request, made: Path) -> None:
    """What `LeRobotDataset` of lerobot 0.3.3 reads and asserts when it opens a folder."""
    for scene in (made / "internvla-n1").iterdir():
        info = json.loads((scene / "meta/info.json").read_bytes())
        assert info["codebase_version"] == "v2.1"
        tasks, episodes, stats = (
            [json.loads(line) for line in (scene / f"meta/{name}.jsonl").read_bytes().splitlines()]
            for name in ("tasks", "episodes", "episodes_stats")
        )
        numbers = [*range(info["total_episodes"])]
        assert [row["episode_index"] for row in episodes] == [row["episode_index"] for row in stats] == numbers
        assert [row["task_index"] for row in tasks] == [*range(info["total_tasks"])]
        assert info["splits"] == {asked.split: f"0:{len(numbers)}"}
        files = [scene / info["data_path"].format(episode_chunk=k // 1000, episode_index=k) for k in numbers]
        assert sorted(files) == sorted((scene / "data").rglob("*.parquet"))
        tables = [pq.read_table(file) for file in files]
        assert [table.num_rows for table in tables] == [row["length"] for row in episodes]
        whole = pa.concat_tables(tables)
        assert whole.column_names == [*info["features"]]
        assert whole["index"].to_pylist() == [*range(info["total_frames"])]
        for name, feature in info["features"].items():
            values = np.array(tables[0][name].to_pylist())
            assert [*values.shape[1:]] == ([] if feature["shape"] == [1] else feature["shape"])
            kind = whole.schema.field(name).type
            while pa.types.is_list(kind):
                kind = kind.value_type
            assert str(kind) == {"float64": "double", "float32": "float"}.get(feature["dtype"], feature["dtype"])
            found = stats[0]["stats"][name]
            assert found["count"] == [len(values)]
            assert all(np.ndim(one) > 0 for one in found.values())
            np.testing.assert_allclose(np.ravel(found["mean"]), np.ravel(values.mean(axis=0)), atol=1e-9)
        for table in tables:
            assert np.diff(table["timestamp"].to_numpy()).tolist() == [1 / info["fps"]] * (table.num_rows - 1)
        assert info["features"]["action"]["info"] == {"forward_metres": 0.25, "turn_degrees": 15.0}


def test_trajectories_are_proven(asked: Request, made: Path) -> None:
    report = proven(asked, made, render_every=100)
    assert report.document["faults"] == []
    assert report.exit_code == 0
    assert report.document["rendered"] > 3
    counts = report.document["layout_rows"]
    walks = rows(made, "trajectories")
    assert counts["navila"] == sum(1 for _ in (made / "navila" / "annotations.json").open())
    assert counts["janusvln"] == sum(sum(row["repeats"]) for row in walks)
    assert counts["internvla-n1"] == counts["lerobot"] == sum(row["n_frames"] for row in walks)
    assert report.document["layout_walks"] == dict.fromkeys(FIFTEEN, len(walks))


def test_a_walk_that_no_file_speaks_of_is_missed(asked: Request, made: Path, tmp_path: Path) -> None:
    """All tables and annotations agree on fewer walks than the split has."""
    out = tmp_path / "copy"
    out.mkdir()
    for path in made.iterdir():
        if path.name == "images":
            (out / "images").symlink_to(path)
        elif path.is_file():
            shutil.copy(path, out)
    record = json.loads((made / "trajectories.json").read_bytes())
    (out / "trajectories.json").write_text(json.dumps(record | {"layouts": ["streamvln"]}))
    lost = rows(made, "trajectories")[0]["episode_id"]
    for name in ("trajectories", "poses"):
        table = pq.read_table(made / f"{name}.parquet")
        pq.write_table(table.filter(pc.not_equal(table["episode_id"], lost)), out / f"{name}.parquet")
    entries = json.loads((made / "annotations.json").read_bytes())
    (out / "annotations.json").write_text(json.dumps([entry for entry in entries if entry["id"] != lost]))
    report = proven(asked, out, render_every=0)
    assert report.exit_code == ProofError.exit_code
    assert {fault["what"] for fault in report.document["faults"]} == {
        f"the {kind} walks of episode {lost}: 0 made and 0 left out, of 1" for kind in ("direct", "oracle", "recovery")
    }


@pytest.mark.soak
def test_a_second_run_finds_everything_and_a_damaged_image_is_made_again(
    asked: Request, made: Path, tmp_path: Path
) -> None:
    before = content(made)
    out = tmp_path / "copy"
    shutil.copytree(made, out)
    again = make_trajectories(to(asked, out))
    assert again.document["counts"]["fresh"] == again.document["counts"]["total"]
    assert content(out) == before
    victim = next((out / "images").rglob("003.jpg"))
    victim.write_bytes(victim.read_bytes()[:-9])
    (out / "images" / "stray").mkdir()
    (out / "poses.parquet").unlink()
    repaired = make_trajectories(to(asked, out))
    assert repaired.document["stages"] == {"frames": 1}
    assert content(out) == before


@pytest.mark.soak
def test_other_images_in_between_are_not_taken_for_the_first_ones(asked: Request, made: Path, tmp_path: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(made, out)
    rough = WALKS.model_copy(update={"jpeg_quality": 10})
    assert make_trajectories(to(asked, out, config=rough)).exit_code == 0
    assert content(out) != content(made)
    make_trajectories(to(asked, out))
    assert content(out) == content(made)


def test_what_is_refused(asked: Request, made: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    for changes, words in (
        ({"layouts": ("habitat",)}, "no layout 'habitat'"),
        ({"camera": "gopro"}, "no main camera 'gopro'"),
        ({"split": "dev"}, "no split 'dev'"),
        ({"scenes": ()}, "no dataset was named"),
        ({"out": tmp_path / "mine"}, "did not write"),
        ({"out": Path(asked.target) / "frames"}, "must not hold meshes or images"),
    ):
        with pytest.raises(UsageError, match=words):
            make_trajectories(to(asked, **{"out": tmp_path / "new", **changes}))
    for text in ("jpeg_quality", "jpeg_quality=high", "quality=3", "least_mistake=99"):
        with pytest.raises(UsageError):
            trajectory_config((), (text,))
    assert (tmp_path / "mine" / "thesis.tex").exists()


@pytest.mark.parametrize("length", ["1e200", "1e154", "-1.0", "100001", "1" + "0" * 30])
def test_a_route_of_a_length_that_no_route_has_is_refused_with_its_line(
    asked: Request, tmp_path: Path, length: str
) -> None:
    export = shutil.copytree(asked.target, tmp_path / "export")
    path = export / "manifest" / f"{asked.split}.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    fields = json.loads(lines[1])
    fields["route_length"] = 12345.25
    lines[1] = json.dumps(fields).replace("12345.25", length) + "\n"
    path.write_text("".join(lines))
    with pytest.raises(FormatError, match="length of a route") as caught:
        make_trajectories(to(asked, tmp_path / "planned", target=str(export), plan=True))
    assert (caught.value.where, caught.value.place) == (str(path), "line 2: route_length")


def test_a_plan_makes_nothing(asked: Request, made: Path, tmp_path: Path) -> None:
    plan = make_trajectories(to(asked, tmp_path / "planned", plan=True)).document["plan"]
    assert not (tmp_path / "planned").exists()
    record = json.loads((made / "trajectories.json").read_bytes())
    assert plan["episodes"] == record["episodes"]
    assert record["frames"] * 0.75 < plan["frames"] < record["frames"] * 1.3
    poses = {(row["scene_id"], *row["position"].values(), row["heading"]) for row in rows(made, "poses")}
    assert len(poses) * 0.75 < plan["rendered"] < len(poses) * 1.4
    assert len(poses) < record["frames"] * 0.75
    # Hard links cost nothing; LeRobot's tables hold copies.
    files = {path.stat().st_ino: path.stat().st_size for path in made.rglob("*") if path.is_file()}
    held = sum(path.stat().st_size for path in (made / "lerobot").rglob("*.parquet"))
    assert held > record["bytes"]
    assert sum(files.values()) / 2 < plan["gigabytes"] * 1e9 < sum(files.values()) * 2
    alone = make_trajectories(to(asked, tmp_path / "planned", plan=True, layouts=("streamvln", "internvla-n1")))
    hub = {path.stat().st_ino: path.stat().st_size for path in (made / "images").rglob("*") if path.is_file()}
    assert sum(hub.values()) == record["stored_bytes"] < record["bytes"] * 0.8
    assert sum(hub.values()) / 2 < alone.document["plan"]["gigabytes"] * 1e9 < sum(hub.values()) * 2
    assert alone.document["plan"]["hours"] == pytest.approx(plan["hours"])
    assert f"of which {plan['rendered']:,} are rendered" in alone.lines[0]
    bare = make_trajectories(to(asked, tmp_path / "planned", plan=True, recipe_only=True)).document["plan"]
    assert bare == {**plan, "gigabytes": 0.0, "hours": pytest.approx(plan["hours"])}


def test_walks_without_shared_poses_are_all_rendered(asked: Request, tmp_path: Path) -> None:
    """A recovery alone shares its poses with no walk that is made."""
    recovery = WALKS.model_copy(update={"walks": ("recovery",)})
    plan = make_trajectories(to(asked, tmp_path / "out", plan=True, config=recovery)).document["plan"]
    assert plan["rendered"] == plan["frames"]


def test_the_plan_of_a_recipe_counts_its_poses(asked: Request, made: Path, tmp_path: Path) -> None:
    recipe = to(asked, tmp_path / "out", target="", recipe=made / "recipe", plan=True)
    plan = make_trajectories(recipe).document["plan"]
    poses = {(row["scene_id"], *row["position"].values(), row["heading"]) for row in rows(made, "poses")}
    record = json.loads((made / "trajectories.json").read_bytes())
    assert (plan["rendered"], plan["frames"]) == (len(poses), record["frames"])
