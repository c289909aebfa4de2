"""LeRobot's files, as its own loader finds them, without `lerobot`: paths, indices, and statistics in closed form."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from condvln.formats.image_files import jpeg, png16
from condvln.navigation.follower import VLN_CE
from condvln.trajectories import lerobot as layout
from condvln.trajectories.hub import Hub, SceneWalks, write_tables
from condvln.trajectories.images import image_path
from condvln.trajectories.walks import vector
from condvln.verify.layouts import prove_layouts
from jobs.verify_trajectories import write_layout
from schemas.config import CameraConfig
from schemas.errors import StoreError
from schemas.tables import LEFT_OUT, POSES, TRAJECTORIES

CAMERA = CameraConfig(width=8, height=6, hfov=79.0, max_depth=None, normalized=False)
CAMERAS = {"rgb": CAMERA, "depth.125cm_30deg": CAMERA.model_copy(update={"look_down": 30.0})}
LENGTHS = (5, 3, 7)


def scene_of(folder: Path) -> SceneWalks:
    """Three walks of one scene with images of one colour and one depth each."""
    walks, poses = [], []
    for number, count in enumerate(LENGTHS):
        name = f"apt_condvln_{number:06d}"
        actions = [1] * (count - 1) + [0]
        walk = {"scene_id": "apt", "trajectory": name, "episode_id": 2**50 + number, "kind": "direct"}
        own = {"actions": actions, "executed": actions, "repeats": [1] * count}
        empty = {"goals": [], "success_distance": 1.0, "max_steps": 500, "navmesh": "", "navmesh_sha256": ""}
        start = {"start_position": vector((0, 0, 0)), "start_rotation": dict(zip("xyzw", (0, 0, 0, 1), strict=True))}
        text = {"instruction_text": f"Go to the sofa {number}.", "frames_of": name, "n_frames": count}
        walks.append(walk | own | empty | start | text)
        for frame in range(count):
            for camera in sorted(CAMERAS):
                depth = camera.startswith("depth")
                grey = np.full((6, 8, 3), 10 * number, np.uint8)
                data = png16(np.full((6, 8), 2.0, np.float32), 1) if depth else jpeg(grey, 90)
                path = image_path(name, camera, frame)
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_bytes(data)
                pose = {"frame": frame, "action": actions[frame], "executed": actions[frame], "heading": 0.25}
                pose |= {"position": vector((frame, number, -1)), "rotation": start["start_rotation"], "leaf": 1}
                pose |= {"looks_for": None, "distance_to_goal": float(count - frame), "camera": camera, "image": path}
                pose |= {"width": 8, "height": 6, "hfov": 79.0, "eye_height": 1.25, "look_down": 0.0}
                pose |= {"intrinsics": None, "goal": None, "goal_frame": None, "bytes": len(data), "sha256": ""}
                poses.append(walk | pose)
    tables = {"trajectories": (TRAJECTORIES, walks), "poses": (POSES, poses), "left_out": (LEFT_OUT, [])}
    made = {name: schema.empty_table().from_pylist(rows, schema=schema) for name, (schema, rows) in tables.items()}
    return SceneWalks("replicacad", "apt", made)


@pytest.fixture(params=[1, 2**30], ids=["a file a walk", "one file"])
def dataset(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(layout, "FILE_BYTES", request.param)
    monkeypatch.setattr(layout, "CHUNK", 2)
    scene = scene_of(tmp_path)
    with layout.lerobot(Hub(tmp_path, "train", CAMERAS, VLN_CE)) as add:
        add(scene)
    return tmp_path / "lerobot"


def test_each_episode_is_where_the_metadata_says(dataset: Path) -> None:
    info = json.loads((dataset / "meta/info.json").read_bytes())
    episodes = pq.read_table(dataset / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    tasks = pq.read_table(dataset / "meta/tasks.parquet").to_pylist()
    assert [row["length"] for row in episodes] == [*LENGTHS]
    assert info["total_frames"] == sum(LENGTHS) == episodes[-1]["dataset_to_index"]
    assert info["splits"] == {"train": "0:3"}
    for number, row in enumerate(episodes):
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        rows = pq.read_table(dataset / info["data_path"].format(**place)).to_pylist()
        own = [frame for frame in rows if frame["episode_index"] == number]
        assert [frame["index"] for frame in own] == [*range(row["dataset_from_index"], row["dataset_to_index"])]
        assert [frame["next.done"] for frame in own] == [False] * (row["length"] - 1) + [True]
        assert [frame["observation.state"] for frame in own] == [[k, number, -1, 0.25] for k in range(row["length"])]
        assert {frame["episode_id"] for frame in own} == {row["episode_id"]} == {2**50 + number}
        assert tasks[own[0]["task_index"]]["task"] == row["tasks"][0] == f"Go to the sofa {number}."
        for frame in own:
            image = frame["observation.images.rgb"]
            assert image["bytes"] == (dataset.parent / image["path"]).read_bytes()
    # The rows follow each other from file to file, in the order in which the loader sorts the files.
    files = sorted((dataset / "data").glob("*/*.parquet"))
    assert [k for path in files for k in pq.read_table(path)["index"].to_pylist()] == [*range(sum(LENGTHS))]


def test_statistics_are_those_of_all_frames(dataset: Path) -> None:
    stats = json.loads((dataset / "meta/stats.json").read_bytes())
    counts = np.array(LENGTHS)
    heights = np.repeat(np.arange(3), counts)
    assert stats["observation.state"]["mean"][1] == pytest.approx(heights.mean())
    assert stats["observation.state"]["std"][1] == pytest.approx(heights.std())
    assert stats["observation.state"]["max"] == [6, 2, -1, 0.25]
    ids = 2**50 + heights.astype(np.float64)
    assert stats["episode_id"]["std"] == pytest.approx([(ids - 2**50).std()])
    assert stats["action"]["count"] == [sum(LENGTHS)]
    # Of fifty frames one is decoded: here the first one, which is black, 2 m from everything.
    assert stats["observation.images.rgb"]["max"] == [[[0.0]]] * 3
    assert stats["observation.images.depth.125cm_30deg"]["mean"] == [[[2000.0]]]
    assert stats["observation.images.rgb"]["count"] == [48]


def test_pandas_reads_the_tasks_as_lerobot_does(dataset: Path) -> None:
    pandas = pytest.importorskip("pandas")
    tasks = pandas.read_parquet(dataset / "meta/tasks.parquet")
    assert [tasks.iloc[k].name for k in range(3)] == [f"Go to the sofa {k}." for k in range(3)]
    assert tasks["task_index"].tolist() == [0, 1, 2]


def test_images_decode_to_the_features_shapes(dataset: Path) -> None:
    features = json.loads((dataset / "meta/info.json").read_bytes())["features"]
    table = pq.read_table(next((dataset / "data").glob("*/*.parquet")))
    assert table.schema.names == [*features]
    for name in ("observation.images.rgb", "observation.images.depth.125cm_30deg"):
        with Image.open(dataset.parent / table[name][0]["path"].as_py()) as image:
            assert [image.height, image.width, len(image.getbands())] == features[name]["shape"]


@pytest.mark.parametrize("at", ["write_table", "close"])
def test_a_full_disk_is_an_error_of_the_store(at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """pyarrow's own error names no file."""

    def full(*given: object, **named: object) -> None:
        raise OSError("No space left on device")

    scene = scene_of(tmp_path)
    monkeypatch.setattr(pq.ParquetWriter, at, full)
    with (
        pytest.raises(StoreError, match="No space left") as found,
        layout.lerobot(Hub(tmp_path, "train", CAMERAS, VLN_CE)) as add,
    ):
        add(scene)
    assert "lerobot" in str(found.value)
    with pytest.raises(StoreError, match="No space left") as found:
        list(write_tables(tmp_path, [scene]))
    assert ".parquet" in str(found.value)
    assert not [*tmp_path.glob("*.part")]
    assert not [*tmp_path.glob("*.parquet")]


def test_what_a_dataset_claims_is_compared_before_it_is_built(tmp_path: Path) -> None:
    """A number of frames of 2³¹ − 1, an image of 400 megapixels, and statistics that are a list."""
    scene = scene_of(tmp_path)
    cameras = {name: camera.model_dump() for name, camera in CAMERAS.items()}
    config = {"forward": 0.25, "turn": 15.0}
    record = {"layouts": ["lerobot"], "cameras": cameras, "split": "train", "config": config}
    [*write_tables(tmp_path, [scene])]
    with layout.lerobot(Hub(tmp_path, "train", CAMERAS, VLN_CE)) as add:
        add(scene)
    walks = [walk | {"source": "replicacad"} for walk in scene.trajectories()]
    assert prove_layouts(tmp_path, record, walks, write_layout).faults == []
    long = [walks[0] | {"n_frames": 2**31 - 1}, *walks[1:]]
    assert (
        "has other than 2147483647 actions or poses"
        in prove_layouts(tmp_path, record, long, write_layout).faults[-1][1]
    )
    (tmp_path / "lerobot/meta/stats.json").write_bytes(b"[]")
    assert [what for _, what in prove_layouts(tmp_path, record, walks, write_layout).faults] == [
        "lerobot: meta/stats.json is not what the walks, poses and images give"
    ]
    header = struct.pack(">II", 20_000, 20_000)
    small = png16(np.full((6, 8), 2.0, np.float32), 1)
    ihdr = b"IHDR" + header + small[24:29]
    large = small[:12] + ihdr + struct.pack(">I", zlib.crc32(ihdr)) + small[33:]
    (tmp_path / image_path(walks[0]["trajectory"], "depth.125cm_30deg", 0)).write_bytes(large)
    ((_, what),) = prove_layouts(tmp_path, record, walks, write_layout).faults
    assert what.startswith("lerobot: a file is missing or damaged")
