"""Hostile files of predictions, results and episodes: what is read is sound, or one error names file and place."""

from __future__ import annotations

import gzip
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from condvln.evaluation.discrete import read_graph_episodes
from condvln.evaluation.episode_stats import NAMES, is_episode_stats, read_episode_stats
from condvln.evaluation.predictions import detect_format, read_graph_predictions, read_predictions
from condvln.evaluation.task import read_ground_truth, read_tasks
from condvln.formats.json_document import MAX_COORDINATE
from schemas.errors import FormatError

VLNCE = {
    "1": [{"position": [0.0, 1.5, -2], "heading": 0.5, "stop": False}, {"position": [1, 2, 3], "stop": True}],
    "2": [],
}
RXR = [{"instruction_id": 1, "path": [[0.0, 1, 2], [3, 4, 5.5]]}, {"instruction_id": "b", "path": []}]
R2R = [{"instr_id": "1_0", "trajectory": [["v", 0.1, 0.0], ["w", 0, 0]]}, {"instr_id": "1_1", "trajectory": ["v"]}]
STATS = {"1": {"success": 1.0, "spl": 0.5, "path_length": 9.5, "collisions": {"count": 2}}, "2": {"success": 0.0}}
EPISODES = [{"path_id": 4, "scan": "s", "path": ["v", "w"], "instructions": ["Go.", "Stop."], "heading": 1.0}]
TRUTHS = {"1": {"locations": [[0, 0, 0], [1, 0.5, 0]], "forward_steps": 1, "actions": [1, 0]}}


def lines(rows: list[Any]) -> bytes:
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


SOUND = [
    json.dumps(VLNCE).encode(),
    lines(RXR),
    json.dumps(R2R).encode(),
    json.dumps(STATS).encode(),
    json.dumps(EPISODES).encode(),
    json.dumps(TRUTHS).encode(),
]

TOKENS = [
    *(b"NaN", b"-Infinity", b"1e999", b"1e308", b"-1e308", b"1e-400", b"9" * 30, b"9" * 400, b"9" * 5000, b"-0"),
    *(b"null", b"true", b'"\\ud800"', b'"\\u0000"', b'"\xff"', b'"', b"\\", b",", b":", b"\n", b"}\n{", b"\x00"),
    *(b"{}", b"[]", b"[[[[", b"[" * 100, b"[" * 3000, b'{"a":' * 200, b'{"1":[]}', b"\xef\xbb\xbf", b"\x1f\x8b"),
    *(b'"a":1,"a":2', b'"position":[0,0,0],', b'"stop":"true"', b'"instr_id":7', b'"instruction_id"'),
    *(b'"success":1e300', b'"path":{}', b"1", b"0.5", b"-2", b"false", b'"x"', b'"w"', b" "),
]
BARE = re.compile(rb'-?[0-9.]+|"[^"]*"|[\[\]{}:,]|true|false')


@st.composite
def hostile(draw: st.DrawFn) -> bytes:
    """A sound file of one of the formats with up to three places changed, cut, doubled or replaced; plain or packed."""
    data = draw(st.sampled_from(SOUND))
    for _ in range(draw(st.sampled_from([1, 1, 2, 3]))):
        kind = draw(st.sampled_from(["token", "token", "insert", "cut", "double", "byte"]))
        spots = [found.span() for found in BARE.finditer(data)] or [(0, len(data))]
        begin, end = draw(st.sampled_from(spots))
        if kind == "token":
            data = data[:begin] + draw(st.sampled_from(TOKENS)) + data[end:]
        elif kind == "insert":
            data = data[:begin] + draw(st.sampled_from(TOKENS)) + data[begin:]
        elif kind == "cut":
            data = data[:begin]
        elif kind == "double":
            data = data[:end] + data[begin:]
        else:
            data = data[:begin] + draw(st.binary(max_size=3)) + data[end:]
    if draw(st.integers(0, 4)) == 0:
        data = gzip.compress(data, mtime=0)
        data = data[: draw(st.integers(0, len(data)))] if draw(st.booleans()) else data
    return data


def read_as_evaluate_does(path: Path) -> None:
    """What evaluation does with a file that it is given, and that what comes out of it can be reckoned with."""
    if is_episode_stats(path):
        for measures in read_episode_stats(path).values():
            assert set(measures) <= set(NAMES.values())
            assert all(math.isnan(value) or -1 <= value <= 1e8 for value in measures.values())
    elif detect_format(path) == "r2r":
        found = list(read_graph_predictions(path))
        assert len({one.instruction_id for one in found}) == len(found)
        assert all(isinstance(viewpoint, str) for one in found for viewpoint in one.viewpoints)
    else:
        seen = list(read_predictions(path))
        assert len({one.episode_id for one in seen}) == len(seen)
        for one in seen:
            assert one.positions.dtype == np.float64
            assert one.positions.ndim == 2
            assert one.positions.shape[1] == 3
            assert (np.abs(one.positions) <= MAX_COORDINATE).all()
            assert isinstance(one.stopped, bool)


READERS: dict[str, Callable[[Path], Any]] = {
    "predictions": read_as_evaluate_does,
    "R2R episodes": read_graph_episodes,
    "ground truth": read_ground_truth,
    "manifest": lambda path: list(read_tasks(path)),
}


@pytest.mark.costly
@pytest.mark.parametrize("reader", READERS)
@given(data=hostile())
@example(data=b"")
@example(data=b"\xef\xbb\xbf")
@example(data=b"[" * 200_000)
@example(data=b'{"a":' * 100_000)
@example(data=b"{}")
@example(data=b"[]")
@example(data=b'{"1": {"success": ' + b"9" * 400 + b"}}")
def test_sound_values_or_one_error_with_its_file(
    tmp_path_factory: pytest.TempPathFactory, reader: str, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "hostile.json"
    path.write_bytes(data)
    refused: list[FormatError] = []
    try:
        READERS[reader](path)
    except FormatError as error:
        refused.append(error)
    for error in refused:
        assert error.where == str(path)
        assert error.what
        assert error.remedy
        str(error).encode()  # no half of a surrogate pair breaks the terminal
        assert len(str(error)) < 1000


@pytest.mark.parametrize("document", SOUND[:4], ids=["VLN-CE", "RxR", "R2R", "results"])
def test_the_sound_files_are_read(tmp_path: Path, document: bytes) -> None:
    path = tmp_path / "sound.json"
    path.write_bytes(document)
    read_as_evaluate_does(path)
    path.write_bytes(gzip.compress(document))
    read_as_evaluate_does(path)


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"success": 1e300}, "success is 1e+300, outside of 0 to 1"),
        ({"spl": -0.5}, "spl is -0.5, outside of 0 to 1"),
        ({"path_length": 1e308}, "path_length is 1e+308, outside of 0 to 1e+07"),
        ({"steps_taken": "12"}, "steps_taken is '12', which is not a number"),
        ({"success": 0.5}, "success is 0.5, neither 0 nor 1, so not one episode's result"),
        ({"ne": 3.0, "distance_to_goal": 2.0}, "two keys have values of navigation_error: 2, and ne 3"),
    ],
)
def test_results_beyond_their_range_are_refused(tmp_path: Path, changed: dict[str, Any], what: str) -> None:
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"7": {"success": 1.0, **changed}}))
    with pytest.raises(FormatError) as caught:
        read_episode_stats(path)
    assert (caught.value.place, caught.value.what) == ("episode 7", what)
