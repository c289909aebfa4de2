"""Prediction files: the three formats, and every way of getting them wrong."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.evaluation.predictions import (
    GraphPrediction,
    Prediction,
    detect_format,
    read_graph_predictions,
    read_predictions,
    write_predictions,
)
from schemas.errors import FormatError


def pose(x: float, stop: bool | None = False, **more: Any) -> dict[str, Any]:
    return {"position": [x, 0.0, 0.0], "heading": 0.5, **({} if stop is None else {"stop": stop}), **more}


def write(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document))
    return path


def only(path: Path, **options: Any) -> Prediction:
    (found,) = read_predictions(path, **options)
    return found


def test_vlnce(tmp_path: Path) -> None:
    path = write(tmp_path / "p.json", {"7": [pose(0), pose(0.25), pose(0.25, True)], "x": [pose(1)], "none": []})
    first, second, empty = read_predictions(path)
    assert first.episode_id == "7"
    assert first.positions.tolist() == [[0, 0, 0], [0.25, 0, 0], [0.25, 0, 0]]
    assert (first.stopped, first.counts_actions, first.collided) == (True, True, None)
    assert (second.stopped, len(empty.positions), empty.stopped) == (False, 0, False)
    packed = tmp_path / "p.json.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert [p.episode_id for p in read_predictions(packed)] == ["7", "x", "none"]


def test_what_comes_after_stop_does_not_count(tmp_path: Path) -> None:
    found = only(write(tmp_path / "p.json", {"a": [pose(0), pose(1, True), pose(2), pose(3, True)]}))
    assert found.positions[:, 0].tolist() == [0, 1]


def test_without_stop_flags_nobody_stopped_unless_assumed(tmp_path: Path) -> None:
    path = write(tmp_path / "p.json", {"a": [pose(0, None), pose(1, None)]})
    assert not only(path).stopped
    assert only(path, assume_stop=True).stopped
    told = write(tmp_path / "q.json", {"a": [pose(0), pose(1)]})
    assert not only(told, assume_stop=True).stopped
    assert not only(write(tmp_path / "r.json", {"a": []}), assume_stop=True).stopped


def test_collisions_where_given(tmp_path: Path) -> None:
    path = write(tmp_path / "p.json", {"a": [pose(0), pose(1, collision=True), pose(2, collision=False)]})
    found = only(path)
    assert found.collided is not None
    assert found.collided.tolist() == [False, True, False]
    write_predictions(tmp_path / "again.json", [found])
    again = only(tmp_path / "again.json")
    assert again.collided is not None
    assert again.collided.tolist() == [False, True, False]


def test_rxr(tmp_path: Path) -> None:
    path = tmp_path / "p.jsonl"
    path.write_text('{"instruction_id": 12, "path": [[0, 0, 0], [1.5, 0, 2]]}\n{"instruction_id": "b", "path": []}\n')
    first, empty = read_predictions(path)
    assert (first.episode_id, first.stopped, first.counts_actions) == ("12", True, False)
    assert first.positions.tolist() == [[0, 0, 0], [1.5, 0, 2]]
    assert (empty.episode_id, empty.stopped, len(empty.positions)) == ("b", False, 0)


def test_r2r(tmp_path: Path) -> None:
    path = write(
        tmp_path / "p.json",
        [
            {"instr_id": "1_0", "trajectory": [["v", 0.1, 0.0], ["w", 0.2, 0.0]]},
            {"instr_id": "1_1", "trajectory": ["v"]},
        ],
    )
    assert list(read_graph_predictions(path)) == [GraphPrediction("1_0", ("v", "w")), GraphPrediction("1_1", ("v",))]
    with pytest.raises(FormatError, match="viewpoints of a graph"):
        list(read_predictions(path))


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('{"1": []}', "vlnce"),
        ("{}", "vlnce"),
        ('{ "path": [], "instruction_id": 3}', "rxr"),
        ('\n {"instruction_id": 3, "path": []}', "rxr"),
        ("[]", "r2r"),
    ],
)
def test_formats_are_told_by_their_beginning(tmp_path: Path, text: str, kind: str) -> None:
    (tmp_path / "p").write_text(text)
    assert detect_format(tmp_path / "p") == kind


def test_no_format(tmp_path: Path) -> None:
    (tmp_path / "p").write_text("position,heading")
    with pytest.raises(FormatError, match="neither"):
        detect_format(tmp_path / "p")


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ('{"a": [{"position": [0, 0, 0]}], "a": []}', "episode a: stands twice"),
        ('{"a": {"position": [0, 0, 0]}}', "episode a: is not a list of poses"),
        ('{"a": [[0, 0, 0]]}', "episode a, step 0: is not {position, heading, stop}"),
        ('{"a": [{"position": [0, 0, 0]}, {"position": [0, 0]}]}', "episode a, step 1: has a position"),
        ('{"a": [{"position": [0, 0, "0"]}]}', "episode a, step 0: has a position"),
        ('{"a": [{"position": null}]}', "episode a, step 0: has a position"),
        ('{"a": [{"heading": 0}]}', "episode a, step 0: has a position"),
        ('{"a": [{"position": [1e999, 0, 0]}]}', "episode a"),
        ('{"a": [{"position": [NaN, 0, 0]}]}', "episode a is not JSON.*NaN"),
        ('{"a": [{"position": [0, 0, 0], "stop": 1}]}', "episode a, step 0: has a stop"),
        ('{"a": [{"position": [0, 0, 0], "stop": "true"}]}', "episode a, step 0: has a stop"),
        ('{"a": [{"position": [0, 0, 0', "cut short"),
    ],
)
def test_vlnce_gone_wrong(tmp_path: Path, document: str, says: str) -> None:
    path = tmp_path / "wrong.json"
    path.write_text(document)
    with pytest.raises(FormatError, match=says) as caught:
        list(read_predictions(path))
    assert "wrong.json" in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ('{"instruction_id": 1, "path": []}\n{"instruction_id": 1, "path": []}', "episode 1: stands twice"),
        ('{"instruction_id": 1, "path": 3}', "line 1"),
        ('{"path": [[0, 0, 0]]}', "line 1: has no id"),
        ('{"instruction_id": true, "path": []}', "line 1: has no id"),
        ('{"instruction_id": 1, "path": [[0, 0, 0], [0, 0, null]]}', "episode 1, step 1"),
        ('{"instruction_id": 1, "path": []}\n{"instruction', "line 2"),
    ],
)
def test_rxr_gone_wrong(tmp_path: Path, lines: str, says: str) -> None:
    path = tmp_path / "wrong.jsonl"
    path.write_text(lines)
    with pytest.raises(FormatError, match=says):
        list(read_predictions(path, "rxr"))


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ([{"instr_id": "1", "trajectory": []}] * 2, "1: stands twice|episode 1: stands twice"),
        ([{"instr_id": "1"}], "entry 0"),
        ([{"trajectory": []}], "entry 0: has no id"),
        ([{"instr_id": "1", "trajectory": [[3]]}], "1, step 0"),
        ([[1]], "entry 0"),
    ],
)
def test_r2r_gone_wrong(tmp_path: Path, document: Any, says: str) -> None:
    with pytest.raises(FormatError, match=says):
        list(read_graph_predictions(write(tmp_path / "wrong.json", document)))


def test_a_long_path_is_read_to_its_last_digit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 10, (5000, 3))
    path = write(tmp_path / "p.json", {"a": [{"position": p, "stop": False} for p in points.tolist()]})
    np.testing.assert_array_equal(only(path).positions, points)
