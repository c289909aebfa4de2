"""Records and images of a folder of trajectories that are damaged, or that an older version wrote."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from condvln.formats.image_files import png16
from condvln.navigation.follower import VLN_CE
from condvln.trajectories.recipe import Recipe
from condvln.verify.trajectories import _Frames, prove_trajectories
from condvln.verify.trajectory_files import walks_with_poses
from jobs.trajectory_units import encoder_lines
from schemas.config import CameraConfig, TrajectoryConfig
from schemas.errors import FormatError
from schemas.tables import TRAJECTORIES, TRAJECTORY_TABLES

CAMERA = CameraConfig(width=8, height=6, hfov=79.0, max_depth=None, normalized=False)
RECORD: dict[str, Any] = {
    "split": "train",
    "layouts": ["streamvln"],
    "cameras": {name: CAMERA.model_dump(mode="json") for name in ("rgb", "depth.a")},
    "config": TrajectoryConfig().model_dump(mode="json"),
    "export_snapshot": "",
    **{key: {} for key in ("scene_files", "libraries", "encoders", "decoders")},
}
DEPTH = np.full((6, 8), 2.0, np.float32)


@pytest.mark.parametrize("part", [{"decoders": None}, {"decoders": []}, {"encoders": "x"}, {"encoders": {"jpg": 1}}])
def test_a_damaged_record_is_named(part: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | part))
    with pytest.raises(FormatError, match="not a record of trajectories"):
        prove_trajectories(tmp_path, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("part", "what"),
    [
        ({"cameras": {"rgb": {"width": 0}}}, "cameras.rgb.width"),
        ({"cameras": {"rgb": 640}}, "cameras.rgb"),
        ({"cameras": {"rgb": {"lens": 1}}}, "cameras.rgb.lens"),
        ({"cameras": {"rgb/../..": {}}}, "cameras.rgb/../.."),
        ({"cameras": {"rgb.\0": {}}}, "cameras.rgb."),
        ({"cameras": [[1, {}]]}, "not a record of trajectories"),
        ({"cameras": "rgb"}, "not a record of trajectories"),
        ({"config": {"png_level": "fast"}}, "config.png_level"),
        ({"config": {"png_level": 10}}, "config.png_level"),
        ({"config": {"png_level": 4}, "encoders": {"png": "isal 1"}}, "config.png_level"),
        ({"config": {"png_level": -1}}, "config.png_level"),
        ({"config": {"png_level": None}}, "config.png_level"),
        ({"config": {"jpeg_quality": 0}}, "config.jpeg_quality"),
        ({"config": {"walks": "gold"}}, "config.walks"),
        ({"config": {"recoveries": []}}, "config.recoveries"),
        ({"config": [["png_level", 9]]}, "not a record of trajectories"),
        ({"config": 3}, "not a record of trajectories"),
    ],
)
def test_a_camera_or_a_configuration_that_cant_be_is_named(part: dict[str, Any], what: str, tmp_path: Path) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | part))
    with pytest.raises(FormatError, match=re.escape(what)) as found:
        prove_trajectories(tmp_path, None)  # type: ignore[arg-type]
    assert "trajectories.json" in str(found.value)


@pytest.mark.parametrize(
    ("columns", "what"),
    [
        ({"n_frames": None}, "the column n_frames is missing"),
        ({"actions": pa.list_(pa.float32())}, "the column actions is list<"),
    ],
)
def test_a_column_that_is_missing_or_of_another_type_is_named(
    columns: dict[str, pa.DataType | None], what: str, tmp_path: Path
) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | {"images_written": False}))
    fields = [
        field.with_type(columns.get(field.name, field.type))
        for field in TRAJECTORIES
        if columns.get(field.name, field) is not None
    ]
    pq.write_table(pa.schema(fields).empty_table(), tmp_path / "trajectories.parquet")
    with pytest.raises(FormatError, match=re.escape(what)):
        prove_trajectories(tmp_path, None)  # type: ignore[arg-type]


def test_a_value_that_is_missing_is_named(tmp_path: Path) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | {"images_written": False}))
    arrays = [pa.nulls(1, field.type) for field in TRAJECTORIES]
    loose = pa.schema([field.with_nullable(True) for field in TRAJECTORIES])
    pq.write_table(pa.table(arrays, schema=loose), tmp_path / "trajectories.parquet")
    with pytest.raises(FormatError, match=r"a value of the column [a-z_]+ is missing"):
        prove_trajectories(tmp_path, None)  # type: ignore[arg-type]


def test_rows_that_fill_the_memory_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recipe comes from strangers, and a million equal rows take a kilobyte."""
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | {"images_written": False}))
    for name in TRAJECTORY_TABLES:
        path = tmp_path / f"{name}.parquet"
        pq.write_table(pa.table({"trajectory": pa.array(["a"] * 1_000_000)}), path)
        assert path.stat().st_size < 5_000

    def read(*given: object, **named: object) -> None:
        raise AssertionError("the rows were read")

    monkeypatch.setattr(pq, "read_table", read)
    monkeypatch.setattr(pq.ParquetFile, "read_row_group", read)
    for reads in (
        lambda: prove_trajectories(tmp_path, None),  # type: ignore[arg-type]
        lambda: next(walks_with_poses(tmp_path / "poses.parquet")),
        lambda: Recipe(tmp_path).scenes,
    ):
        with pytest.raises(FormatError, match="1,000,000 rows in a file of"):
            reads()


def repeated() -> pa.Table:
    """One text of a megabyte, 300 times."""
    text = pa.DictionaryArray.from_arrays(pa.array([0] * 300, pa.int32()), pa.array(["x" * (1 << 20)]))
    return pa.table({"trajectory": text, "number": range(300)})


def prefixed() -> pa.Table:
    """Texts of a megabyte, each stored as what follows after the one before."""
    return pa.table({"trajectory": ["x" * (1 << 20)] * 300, "number": range(300)})


def listed() -> pa.Table:
    """A list of 80 million equal numbers in one row."""
    values = pa.DictionaryArray.from_arrays(pa.array(np.zeros(80_000_000, np.int8)), pa.array([0], pa.int8()))
    return pa.table({"actions": pa.ListArray.from_arrays([0, len(values)], values.dictionary_decode())})


@pytest.mark.parametrize(
    ("table", "options"),
    [
        (repeated, {}),
        (prefixed, {"use_dictionary": False, "column_encoding": {"trajectory": "DELTA_BYTE_ARRAY"}}),
        (listed, {}),
    ],
    ids=["repeated", "prefixed", "listed"],
)
def test_values_that_fill_the_memory_are_refused_before_they_are_decoded(
    table: Callable[[], pa.Table], options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | {"images_written": False}))
    pq.write_table(table(), tmp_path / "one", compression="zstd", store_schema=False, **options)
    assert (tmp_path / "one").stat().st_size < 200_000
    for name in TRAJECTORY_TABLES:
        shutil.copyfile(tmp_path / "one", tmp_path / f"{name}.parquet")
    monkeypatch.setattr(pq, "read_table", lambda *_given, **_named: pytest.fail("the rows were read"))
    for reads in (
        lambda: prove_trajectories(tmp_path, None),  # type: ignore[arg-type]
        lambda: next(walks_with_poses(tmp_path / "poses.parquet")),
        lambda: Recipe(tmp_path).scenes,
    ):
        allocated = pa.total_allocated_bytes()
        with pytest.raises(FormatError, match=r"\.parquet: .*whose rows take more than 268,435,456 bytes"):
            reads()
        assert pa.total_allocated_bytes() - allocated < 64 << 20


@pytest.mark.parametrize("special", ["FIFO", "device", "link to itself"])
@pytest.mark.parametrize("name", ["trajectories.json", "annotations.json", "trajectories.parquet", "poses.parquet"])
def test_what_is_no_file_is_named_and_not_waited_for(name: str, special: str, tmp_path: Path) -> None:
    if name != "trajectories.json":
        (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD))
    if name != "annotations.json":
        (tmp_path / "annotations.json").write_bytes(b"[]")
    path = tmp_path / name
    if special == "FIFO":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero" if special == "device" else name)
    words = {"FIFO": "it is a FIFO", "device": "it is a character device", "link to itself": "symbolic links"}[special]
    reads: list[Callable[[], object]] = [lambda: prove_trajectories(tmp_path, None)]  # type: ignore[arg-type]
    if name == "poses.parquet":
        reads = [lambda: next(walks_with_poses(path))]
    if name == "trajectories.json":
        reads.append(lambda: Recipe(tmp_path))
    for read in reads:
        with pytest.raises(FormatError, match=f"{name}: .*{words}"):
            read()


@pytest.mark.parametrize("actions", [5, None, {"a": 1}, "0123"])
def test_actions_that_are_no_list_are_named(actions: object, tmp_path: Path) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD))
    entry = {"id": 1, "video": "", "instructions": [], "kind": "direct", "actions": actions}
    (tmp_path / "annotations.json").write_bytes(orjson.dumps([entry]))
    with pytest.raises(FormatError, match="the actions of an entry are not a list"):
        prove_trajectories(tmp_path, None)  # type: ignore[arg-type]


def test_an_encoder_that_the_record_does_not_name(tmp_path: Path) -> None:
    (tmp_path / "trajectories.json").write_bytes(orjson.dumps(RECORD | {"encoders": {"jpg": "x"}}))
    lines = encoder_lines(Recipe(tmp_path))
    assert [line.partition(" wrote the ")[0] for line in lines] == ["x", "An unnamed encoder"]


def fault_of(folder: Path, data: bytes) -> str | None:
    """What is wrong with a depth image that another encoder wrote."""
    place = "images/a/depth.a/001.png"
    (folder / place).parent.mkdir(parents=True)
    (folder / place).write_bytes(data)
    row = {"trajectory": "a", "camera": "depth.a", "frame": 0, "image": place}
    row |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    frame = SimpleNamespace(rgb=np.zeros((6, 8, 3), np.uint8), depth=DEPTH)
    renderer = SimpleNamespace(look=lambda *given: frame)
    world: Any = SimpleNamespace(render_every=1, renderer=lambda episode: renderer)
    images = {"png_level": 3, "encoders": {"png": "Pillow 11"}}
    frames = _Frames(folder, {}, [], {"depth.a": CAMERA}, images, world, VLN_CE)
    proof: Any = SimpleNamespace(rendered=0)
    episode: Any = None
    return frames._image(row, np.zeros(3), 0.0, episode, proof)


def test_images_of_another_encoder_are_rendered_again(tmp_path: Path) -> None:
    assert fault_of(tmp_path, png16(DEPTH, 1)) is None
    assert fault_of(tmp_path / "other", png16(DEPTH + 1, 1)) == "the pose shows another image"


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("edge", [7, 12_000, 40_000])
def test_an_image_that_claims_a_large_size_is_a_fault(edge: int, tmp_path: Path) -> None:
    small = png16(DEPTH, 1)
    header = b"IHDR" + struct.pack(">II", edge, edge) + small[24:29]
    fault = fault_of(tmp_path, small[:12] + header + struct.pack(">I", zlib.crc32(header)) + small[33:])
    assert fault.startswith("the image ")


def test_a_number_of_frames_is_compared_before_a_list_is_built() -> None:
    walk = {"n_frames": 2**31 - 1}
    world: Any = None
    frames = _Frames(None, walk, [], {"rgb": CAMERA}, {}, world, VLN_CE)
    proof: Any = SimpleNamespace(frames=0)
    assert [*frames.faults(proof)] == ["a frame has no pose, or more than one"]
