"""The layout of Uni-NaVid: a video of all frames up to the present one, and the next four actions.

The videos are MP4 files with a track of JPEG images, one a second, for which no encoder is needed.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from condvln.navigation.follower import FORWARD, LEFT, RIGHT, STOP
from condvln.trajectories.hub import AddScene, Hub, SceneWalks, json_array
from condvln.trajectories.layouts import main_image, new_folder, usable

__all__ = ["ACTIONS_AHEAD", "REDUCED", "mp4_of_jpegs", "samples_of", "uninavid"]

ACTIONS_AHEAD: Final = 4
"""Actions of an answer, and frames between two samples of a walk."""
REDUCED: Final = 2
"""Factor by which the hub's images are reduced in videos; the loaders reduce them further."""
_QUALITY: Final = 85

_WORDS: Final = {STOP: "stop", FORWARD: "forward", LEFT: "left", RIGHT: "right"}
_PROMPT: Final = (
    "Imagine you are a robot programmed for navigation tasks. You have been given a video of historical observations "
    "and an image of the current observation <image>. Your assigned task is: '{task}'. Analyze this series of images "
    "to determine your next four actions. The predicted action should be one of the following: forward, left, right, "
    "or stop."
)
"""The words that Uni-NaVid sends when it is evaluated (jzhzhang/Uni-NaVid, ``offline_eval_uninavid.py``). It finds
navigation samples by those from ``a video`` to ``current observation``.
"""


@contextmanager
def uninavid(hub: Hub) -> Iterator[AddScene]:
    """Write Uni-NaVid's samples to ``uninavid/annotations.json``, and one video per sample to ``uninavid/nav_videos/``.

    A sample is taken at every fourth frame and at the last one. An answer has four actions, the last ones STOP at the
    end of a walk; it never reaches into a mistake.
    """
    with new_folder(hub.folder / "uninavid") as part, json_array(part / "annotations.json") as entries:
        (part / "nav_videos").mkdir()

        def add(scene: SceneWalks) -> None:
            for row in scene.trajectories():
                frames, size = _reduced(hub.folder, row)
                for at, answer in samples_of(row):
                    video = f"nav_videos/{row['trajectory']}_{at:03d}.mp4"
                    (part / video).write_bytes(mp4_of_jpegs(frames[: at + 1], *size))
                    entry = {
                        "id": f"NAV_ID_{row['trajectory']}_{at}",
                        "video": video,
                        "conversations": [
                            {"from": "human", "value": _PROMPT.format(task=row["instruction_text"])},
                            {"from": "gpt", "value": " ".join(answer)},
                        ],
                        "episode_id": row["episode_id"],
                        "kind": row["kind"],
                    }
                    for _ in range(row["repeats"][at]):
                        entries.entry(orjson.dumps(entry))

        yield add


def samples_of(row: dict[str, Any]) -> Iterator[tuple[int, list[str]]]:
    """Yield (frame, the next four actions as words) for each sample of a walk."""
    right = usable(row)
    count = len(right)
    words = [_WORDS[action] for action in row["actions"]] + [_WORDS[STOP]] * (ACTIONS_AHEAD - 1)
    for at in sorted({*range(0, count, ACTIONS_AHEAD), count - 1}):
        if np.all(right[at : at + ACTIONS_AHEAD]):
            yield at, words[at : at + ACTIONS_AHEAD]


def _reduced(folder: Path, row: dict[str, Any]) -> tuple[list[bytes], tuple[int, int]]:
    """Return the frames of a walk as smaller JPEG files, and their width and height."""
    from PIL import Image

    found = []
    size = (0, 0)
    for frame in range(row["n_frames"]):
        with Image.open(folder / main_image(row, frame)) as image:
            size = (max(image.width // REDUCED, 1), max(image.height // REDUCED, 1))
            image.draft("RGB", size)  # decodes at the smaller size, which costs a quarter
            stream = io.BytesIO()
            small = image if image.size == size else image.resize(size, Image.Resampling.BOX)
            small.save(stream, "JPEG", quality=_QUALITY)
        found.append(stream.getvalue())
    return found, size


_SCALE: Final = 1000
"""Time units a second; a frame lasts one second."""
_MATRIX: Final = struct.pack(">9i", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)


def mp4_of_jpegs(frames: Sequence[bytes], width: int, height: int) -> bytes:
    """Return an MP4 file with one JPEG image a second (ISO/IEC 14496-12; the images as QuickTime's ``jpeg`` track).

    Equal images give equal bytes: the file has no dates.
    """
    start = _box(b"ftyp", b"qt  \x00\x00\x02\x00qt  ")
    data = b"".join(frames)
    media = _box(b"mdat", data)
    first = len(start) + 8
    duration = len(frames) * _SCALE
    entry = struct.pack(">6xH16xHHIIIH", 1, width, height, 0x480000, 0x480000, 0, 1)
    entry += b"\x04JPEG" + bytes(27) + struct.pack(">Hh", 24, -1)
    samples = _box(
        b"stbl",
        _full(b"stsd", struct.pack(">I", 1) + _box(b"jpeg", entry)),
        _full(b"stts", struct.pack(">III", 1, len(frames), _SCALE)),
        _full(b"stsc", struct.pack(">IIII", 1, 1, len(frames), 1)),
        _full(b"stsz", struct.pack(f">II{len(frames)}I", 0, len(frames), *map(len, frames))),
        _full(b"stco", struct.pack(">II", 1, first)),
    )
    information = _box(
        b"minf",
        _full(b"vmhd", bytes(8), flags=1),
        _box(b"dinf", _full(b"dref", struct.pack(">I", 1) + _full(b"url ", b"", flags=1))),
        samples,
    )
    handler = _full(b"hdlr", struct.pack(">4s4s12x", b"mhlr", b"vide") + b"\x00")
    track = _box(
        b"trak",
        _full(
            b"tkhd",
            struct.pack(">IIIII8xhhhH", 0, 0, 1, 0, duration, 0, 0, 0, 0)
            + _MATRIX
            + struct.pack(">II", width << 16, height << 16),
            flags=7,
        ),
        _box(
            b"mdia",
            _full(b"mdhd", struct.pack(">IIIIHH", 0, 0, _SCALE, duration, 0x55C4, 0)),
            handler,
            information,
        ),
    )
    movie = struct.pack(">IIIIIH10x", 0, 0, _SCALE, duration, 0x10000, 0x100) + _MATRIX + bytes(24)
    return start + media + _box(b"moov", _full(b"mvhd", movie + struct.pack(">I", 2)), track)


def _box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", len(body) + 8) + kind + body


def _full(kind: bytes, body: bytes, flags: int = 0) -> bytes:
    return _box(kind, struct.pack(">I", flags), body)
