"""Prove the layouts of a folder of trajectories: each row, image and video is computed again from the hub (the images
and poses that all layouts share) and compared.

The rules are those of the agents' loaders (``docs/training.md``), written here a second time.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
import pyarrow as pa

from condvln.formats.regular_file import read_regular
from condvln.verify.layout_files import Counts, Faults, Row, linked
from condvln.verify.lerobot_layouts import internvla_faults, lerobot_faults

__all__ = ["LayoutProof", "prove_layouts"]

_NAVILA: Final = {1: "move forward {} cm", 2: "turn left {} degrees", 3: "turn right {} degrees"}
_NAVILA_UNIT: Final = {1: 25, 2: 15, 3: 15}
_JANUS: Final = ("STOP", "MOVE_FORWARD", "TURN_LEFT", "TURN_RIGHT")
_UNINAVID: Final = ("stop", "forward", "left", "right")
_SAID_BY_UNINAVID: Final = "a video of historical observations and an image of the current observation"
_HUB: Final = "streamvln"
"""The layout whose files are the hub's own."""


_DAMAGED: Final = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    struct.error,
    pa.ArrowException,
)
"""What a damaged file of a layout raises."""


class LayoutProof:
    """The result of proving layouts: how many rows were compared, by layout, and each difference as (walk, what
    differs).
    """

    def __init__(self) -> None:
        self.rows: Counts = {}
        self.faults: list[tuple[str, str]] = []


def prove_layouts(folder: Path, record: Row, walks: Sequence[Row]) -> LayoutProof:
    """Compare the layouts that `record` names with the hub.

    record : content of ``trajectories.json``
    walks : rows of ``trajectories.parquet``, in their order
    """
    from PIL import Image

    proof = LayoutProof()
    checks = {
        "navila": _navila,
        "uninavid": _uninavid,
        "janusvln": _janusvln,
        "internvla-n1": internvla_faults,
        "lerobot": lerobot_faults,
    }
    for name in sorted({*record["layouts"]} - {*checks, _HUB}):
        proof.faults.append(("", f"{name}: the record names a layout that is not known here"))
    for name in sorted(checks.keys() - {*record["layouts"]}):
        if (folder / name).exists():
            proof.faults.append(("", f"{name}: the folder is there, but the record does not name this layout"))
    for name in sorted(checks.keys() & {*record["layouts"]}):
        proof.rows[name] = 0
        try:
            for walk, fault in checks[name](folder, record, walks, proof.rows):
                proof.faults.append((walk, f"{name}: {fault}"))
        except (*_DAMAGED, Image.DecompressionBombError) as error:
            proof.faults.append(("", f"{name}: a file is missing or damaged ({error})"))
    return proof


def _navila(folder: Path, record: Row, walks: Sequence[Row], rows: Counts) -> Faults:
    with (folder / "navila" / "annotations.json").open("rb") as lines:
        for walk in walks:
            wanted = [*_navila_rows(walk)]
            found = [orjson.loads(line) for _, line in zip(wanted, lines, strict=False)]
            rows["navila"] += len(found)
            if found != wanted:
                yield walk["trajectory"], "the rows are not the walk's"
                return
        if lines.read(1):
            yield "", "there are more rows than steps"


def _navila_rows(walk: Row) -> Iterator[dict[str, Any]]:
    """Yield the rows of a walk in NaVILA's layout: the row of each step, as many times as `repeats` says. A step is up
    to three equal actions in a row, none of them a mistake; STOP is a step of its own.
    """
    actions, repeats = walk["actions"], walk["repeats"]
    at = 0
    while at < len(actions):
        action, count = actions[at], 1
        while (
            action
            and repeats[at]
            and count < 3
            and at + count < len(actions)
            and actions[at + count] == action
            and repeats[at + count]
        ):
            count += 1
        said = _NAVILA[action].format(_NAVILA_UNIT[action] * count) if action else "stop"
        row = {
            "video_id": f"{walk['trajectory']}_{at}",
            "q": walk["instruction_text"],
            "a": f"The next action is {said}.",
            "frames": [_image(walk, k).removeprefix("images/") for k in range(at + 1)],
            "episode_id": walk["episode_id"],
            "kind": walk["kind"],
        }
        yield from [row] * repeats[at]
        at += count


def _janusvln(folder: Path, record: Row, walks: Sequence[Row], rows: Counts) -> Faults:
    samples = iter(orjson.loads(read_regular(folder / "janusvln" / "train.json")))
    for walk in walks:
        for at, action in enumerate(walk["actions"]):
            past = [*range(at + 1)] if at < 9 else [int(k) for k in np.linspace(0, at, 9)]
            images = [_image(walk, k) for k in past]
            for _ in range(walk["repeats"][at]):
                sample = next(samples, None)
                if not sample or not _is_janus(sample, walk, at, images, _JANUS[action]):
                    yield walk["trajectory"], f"the sample of frame {at} is not the walk's"
                    return
                rows["janusvln"] += 1
    if next(samples, None) is not None:
        yield "", "there are more samples than frames"
    frames = folder / "janusvln" / "trajectory_data" / "R2R" / record["split"]
    gold = [walk for walk in walks if walk["kind"] == "gold"]
    if gold and {path.name for path in frames.iterdir()} != {str(walk["episode_id"]) for walk in gold}:
        yield "", "the folders of frames are not the episodes of gold walks"
    for walk in gold:
        wanted = {
            f"rgb_{at:04d}_{_JANUS[action].lower()}.png": _image(walk, at) for at, action in enumerate(walk["actions"])
        }
        yield from linked(folder, frames / str(walk["episode_id"]), wanted, walk["trajectory"])


def _is_janus(sample: Row, walk: Row, at: int, images: list[str], answer: str) -> bool:
    human, gpt = sample["conversations"]
    return (
        sample["id"] == f"{walk['episode_id']}/{walk['trajectory']}/{at}"
        and sample["images"] == images
        and (human["from"], gpt["from"], gpt["value"]) == ("human", "gpt", answer)
        and human["value"].count("<image>") == len(images)
        and walk["instruction_text"] in human["value"]
    )


def _uninavid(folder: Path, record: Row, walks: Sequence[Row], rows: Counts) -> Faults:
    entries = iter(orjson.loads(read_regular(folder / "uninavid" / "annotations.json")))
    videos: set[str] = set()
    for walk in walks:
        count = len(walk["actions"])
        words = [_UNINAVID[action] for action in walk["actions"]] + ["stop"] * 3
        frames: list[bytes] = []
        for at in range(count):
            if (at % 4 and at != count - 1) or not all(walk["repeats"][at : at + 4]):
                continue
            frames += [_reduced(folder / _image(walk, k)) for k in range(len(frames), at + 1)]
            video = f"nav_videos/{walk['trajectory']}_{at:03d}.mp4"
            videos.add(video.partition("/")[2])
            for _ in range(walk["repeats"][at]):
                entry = next(entries, None)
                if not entry or not _is_uninavid(entry, walk, at, video, " ".join(words[at : at + 4])):
                    yield walk["trajectory"], f"the sample of frame {at} is not the walk's"
                    return
                rows["uninavid"] += 1
            if _frames_of(read_regular(folder / "uninavid" / video)) != frames[: at + 1]:
                yield walk["trajectory"], f"the video of frame {at} has other images"
    if next(entries, None) is not None:
        yield "", "there are more samples than every fourth frame gives"
    if {path.name for path in (folder / "uninavid" / "nav_videos").iterdir()} != videos:
        yield "", "the videos are not those of the samples"


def _is_uninavid(entry: Row, walk: Row, at: int, video: str, answer: str) -> bool:
    human, gpt = entry["conversations"]
    return (
        (entry["id"], entry["video"]) == (f"NAV_ID_{walk['trajectory']}_{at}", video)
        and (entry["episode_id"], entry["kind"]) == (walk["episode_id"], walk["kind"])
        and (human["from"], gpt["from"], gpt["value"]) == ("human", "gpt", answer)
        and _SAID_BY_UNINAVID in human["value"]
        and walk["instruction_text"] in human["value"]
    )


def _reduced(path: Path) -> bytes:
    """Return an image reduced to half its size, as a JPEG, which is how Uni-NaVid's videos contain it."""
    from PIL import Image

    with Image.open(path) as image:
        size = max(image.width // 2, 1), max(image.height // 2, 1)
        image.draft("RGB", size)
        stream = io.BytesIO()
        (image if image.size == size else image.resize(size, Image.Resampling.BOX)).save(stream, "JPEG", quality=85)
    return stream.getvalue()


def _frames_of(video: bytes) -> list[bytes]:
    """Return the samples (frames) of an MP4 file, in order. The file must have one track, whose samples follow each
    other without gaps.
    """
    data, sizes = b"", []
    inside = [(0, len(video))]
    while inside:
        at, end = inside.pop()
        while at + 8 <= end:
            size, kind = struct.unpack_from(">I4s", video, at)
            if size < 8:
                raise ValueError("a box of an MP4 file is too short")
            if kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
                inside.append((at + 8, at + size))
            elif kind == b"mdat":
                data = video[at + 8 : at + size]
            elif kind == b"stsz":
                (count,) = struct.unpack_from(">I", video, at + 16)
                sizes = [*struct.unpack_from(f">{count}I", video, at + 20)]
            at += size
    ends = np.cumsum([0, *sizes]).tolist()
    if ends[-1] != len(data):
        raise ValueError("the samples of an MP4 file do not fill it")
    return [data[a:b] for a, b in pairwise(ends)]


def _image(walk: Row, frame: int) -> str:
    return f"images/{walk['frames_of']}/rgb/{frame + 1:03d}.jpg"
