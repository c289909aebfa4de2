"""Answers and samples of the layouts, and videos that hold their images unchanged."""

from __future__ import annotations

import re
import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from condvln.trajectories.navila import merged, navila_answer
from condvln.trajectories.uninavid import mp4_of_jpegs, samples_of

walks = st.lists(st.tuples(st.integers(1, 3), st.booleans()), min_size=1, max_size=60)


@given(walks)
def test_merged_steps_cover_each_right_frame_once(steps: list[tuple[int, bool]]) -> None:
    actions = np.array([action for action, _ in steps] + [0], np.int8)
    right = np.array([fine for _, fine in steps] + [True])
    covered = []
    for at, action, count in merged(actions, right):
        assert 1 <= count <= 3
        assert set(actions[at : at + count].tolist()) == {action}
        assert right[at : at + count].all()
        covered += range(at, at + count)
    assert covered == np.flatnonzero(right).tolist()


def test_navila_s_evaluator_reads_the_answers() -> None:
    for count in (1, 2, 3):
        assert re.search(r"move forward (\d+) cm", navila_answer(1, count))[1] == str(25 * count)  # type: ignore[index]
        for action, side in ((2, "left"), (3, "right")):
            found = re.search(r"turn (left|right) (\d+) degree", navila_answer(action, count))
            assert found is not None
            assert found.groups() == (side, str(15 * count))
    assert "stop" in navila_answer(0, 1)


@given(walks)
def test_four_actions_ahead_never_reach_into_a_mistake(steps: list[tuple[int, bool]]) -> None:
    actions = [action for action, _ in steps] + [0]
    executed = [action if fine else action % 3 + 1 for action, fine in steps] + [0]
    words = {"stop": 0, "forward": 1, "left": 2, "right": 3}
    found = dict(samples_of({"actions": actions, "executed": executed}))
    assert found[len(actions) - 1] == ["stop"] * 4
    for at, answer in found.items():
        assert len(answer) == 4
        assert [words[word] for word in answer] == (executed[at:] + [0] * 3)[:4]
    fine = [at for at in range(0, len(actions), 4) if actions[at : at + 4] == executed[at : at + 4]]
    assert sorted(found) == sorted({*fine, len(actions) - 1})


def boxes(data: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        assert size >= 8
        found[data[at + 4 : at + 8]] = data[at + 8 : at + size]
        at += size
    assert at == len(data)
    return found


@given(
    st.lists(st.binary(min_size=1, max_size=50), min_size=1, max_size=20), st.integers(1, 4000), st.integers(1, 4000)
)
def test_a_video_holds_its_images_unchanged(frames: list[bytes], width: int, height: int) -> None:
    data = mp4_of_jpegs(frames, width, height)
    track = boxes(boxes(boxes(data)[b"moov"])[b"trak"])
    table = boxes(boxes(boxes(track[b"mdia"])[b"minf"])[b"stbl"])
    sizes = struct.unpack(f">{len(frames)}I", table[b"stsz"][12:])
    (start,) = struct.unpack(">I", table[b"stco"][8:])
    for frame, size in zip(frames, sizes, strict=True):
        assert data[start : start + size] == frame
        start += size
    count, per_frame = struct.unpack(">II", table[b"stts"][8:])
    (scale,) = struct.unpack_from(">I", track[b"mdia"], 8 + 12)
    assert (count, per_frame) == (len(frames), scale)  # one image a second
    assert struct.unpack_from(">HH", table[b"stsd"], 8 + 8 + 24) == (width, height)
