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
    with pytest.raises(FormatError, match="paths over viewpoints, not positions"):
        list(read_predictions(path))


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ('{"1": []}', "vlnce"),
        ("{}", "vlnce"),
        ('{ "path": [], "instruction_id": 3}', "rxr"),
        ('\n {"instruction_id": 3, "path": []}', "rxr"),
        ('[{"instr_id": "1_0", "trajectory": []}]', "r2r"),
        ('{"language": "en-US", "instruction_id": 3, "path": []}', "rxr"),
        ('\ufeff{"1": []}', "vlnce"),
    ],
)
def test_formats_are_told_by_their_beginning(tmp_path: Path, text: str, kind: str) -> None:
    (tmp_path / "p").write_text(text)
    assert detect_format(tmp_path / "p") == kind


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("position,heading", "neither a JSON object nor a JSON array"),
        ("", "the file is empty"),
        (" \n", "the file is empty"),
        ("[]", "an empty array: it holds no prediction"),
        ("[[1, 2]]", "an array of arrays, not of predictions"),
        ("[" * 100_000, "an array of arrays, not of predictions"),
        ("[3]", "an array of numbers or words, not of predictions"),
        ('["a"]', "an array of texts, not of predictions"),
        ('{"episodes": 3}', "a JSON object, but not one of predictions by episode"),
    ],
)
def test_what_is_no_file_of_predictions_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "p.json"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        list(read_predictions(path))
    assert says in caught.value.what
    assert caught.value.where == str(path)
    # What would be accepted is said of every format.
    assert all(word in caught.value.remedy for word in ("position", "instruction_id", "instr_id", "measure"))


@pytest.mark.parametrize(
    ("document", "place", "says"),
    [
        ('{"a": [{"position": [0, 0, 0]}], "a": []}', "episode a", "the file has two predictions of this episode"),
        (
            '{"a": {"position": [0, 0, 0]}}',
            "",
            "the file is a JSON object, but not one of predictions by episode",
        ),
        ('{"b": [], "a": {"position": [0, 0, 0]}}', "episode a", "the value is not a list of poses"),
        ('{"a": [[0, 0, 0]]}', "episode a, step 0", "the pose is not an object with position, heading and stop"),
        (
            '{"a": [{"position": [0, 0, 0]}, {"position": [0, 0]}]}',
            "episode a, step 1",
            "the position is [0,0], not three numbers",
        ),
        ('{"a": [{"position": [0, 0, "0"]}]}', "episode a, step 0", 'the position is [0,0,"0"], not three numbers'),
        ('{"a": [{"position": [true, 0, 0]}]}', "episode a, step 0", "the position is [true,0,0], not three numbers"),
        ('{"a": [{"position": null}]}', "episode a, step 0", "the position is null, not three numbers"),
        ('{"a": [{"heading": 0}]}', "episode a, step 0", "the position is null, not three numbers"),
        (
            '{"a": [{"position": [0, 0, 0]}, {"position": [1e308, 0, 0]}]}',
            "episode a, step 1",
            "the position [1e+308,0,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"a": [{"position": [0, 0, 0]}, {"position": [0, -100001, 0]}]}',
            "episode a, step 1",
            "the position [0,-100001,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"a": [{"position": [18446744073709551615, 0, 0]}]}',
            "episode a, step 0",
            "the position [18446744073709551615,0,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"a": [{"position": [0, 0, 0]}, {"position": [0, 1e999, 0]}]}',
            "episode a, step 1",
            "the number inf is not finite, and JSON has no such number",
        ),
        (
            '{"b": [], "a": [{"position": [0, 0, 0]}, {"position": [NaN, 0, 0]}]}',
            "episode a, step 1",
            "the number nan is not finite, and JSON has no such number",
        ),
        ('{"a": [{"position": [0, 0, 0], "stop": 1}]}', "episode a, step 0", "stop is 1, neither true nor false"),
        (
            '{"a": [{"position": [0, 0, 0], "stop": "true"}]}',
            "episode a, step 0",
            "stop is 'true', neither true nor false",
        ),
        (
            '{"a": [{"position": [0, 0, 0], "position": [1, 0, 0]}]}',
            "episode a",
            "the key 'position' is there twice in one object",
        ),
        ('{"a": [{"position": [0, 0, 0', "after entry 0", "the file is truncated, or its brackets do not match"),
        ('{"a": [' + "[" * 70 + "]" * 70 + "]}", "episode a", "the text is nested 71 levels deep; at most 64 are read"),
        ('{"a": [' + "[" * 9999, "entry 0", "the text is nested 10001 levels deep; at most 64 are read"),
    ],
)
def test_vlnce_gone_wrong(tmp_path: Path, document: str, place: str, says: str) -> None:
    path = tmp_path / "wrong.json"
    path.write_text(document)
    with pytest.raises(FormatError) as caught:
        list(read_predictions(path))
    assert (caught.value.where, caught.value.place, caught.value.what) == (str(path), place, says)


@pytest.mark.parametrize(
    ("lines", "place", "says"),
    [
        (
            '{"instruction_id": 1, "path": []}\n{"instruction_id": 1, "path": []}',
            "episode 1",
            "the file has two predictions of this episode",
        ),
        (
            '{"instruction_id": 1, "path": 3}',
            "line 1",
            "the line is not an object with instruction_id and a list path",
        ),
        ('{"path": [[0, 0, 0]]}', "line 1", "instruction_id is missing"),
        ('{"instruction_id": true, "path": []}', "line 1", "instruction_id is true, not text or a number"),
        (
            '{"instruction_id": 1, "path": [[0, 0, 0], [0, 0, null]]}',
            "episode 1, step 1",
            "the position is [0,0,null], not three numbers",
        ),
        (
            '{"instruction_id": 1, "path": []}\n{"instruction_id": 2, "path": [[0, 0, 0], [0, 0, -Infinity]]}',
            "line 2, step 1",
            "the number -inf is not finite, and JSON has no such number",
        ),
        (
            '{"instruction_id": 1, "path": [[0, 1e308, 0]]}',
            "episode 1, step 0",
            "the position [0,1e+308,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"instruction_id": 1, "path": []}\n{"instruction',
            "line 2",
            "the text is not JSON (Unterminated string starting at: line 1 column 2)",
        ),
    ],
)
def test_rxr_gone_wrong(tmp_path: Path, lines: str, place: str, says: str) -> None:
    path = tmp_path / "wrong.jsonl"
    path.write_text(lines)
    with pytest.raises(FormatError) as caught:
        list(read_predictions(path, "rxr"))
    assert (caught.value.where, caught.value.place, caught.value.what) == (str(path), place, says)


@pytest.mark.parametrize(
    ("document", "place", "says"),
    [
        ([{"instr_id": "1", "trajectory": []}] * 2, "episode 1", "the file has two predictions of this episode"),
        ([{"instr_id": "1"}], "entry 0", "the entry is not an object with instr_id and a list trajectory"),
        ([{"trajectory": []}], "entry 0", "instr_id is missing"),
        ([{"instr_id": "1", "trajectory": [["v"], [3]]}], "instruction 1, step 1", "the step has no viewpoint id"),
        ([[1]], "entry 0", "the entry is not an object with instr_id and a list trajectory"),
    ],
)
def test_r2r_gone_wrong(tmp_path: Path, document: Any, place: str, says: str) -> None:
    path = write(tmp_path / "wrong.json", document)
    with pytest.raises(FormatError) as caught:
        list(read_graph_predictions(path))
    assert (caught.value.where, caught.value.place, caught.value.what) == (str(path), place, says)


@pytest.mark.parametrize("colons", ["a:b", "::", '\\":'])
def test_colons_in_names_are_no_keys(tmp_path: Path, colons: str) -> None:
    path = write(tmp_path / "p.json", {colons: [pose(0, note=colons), pose(1, True, more={colons: colons})]})
    assert only(path).episode_id == colons


def test_a_long_path_is_read_to_its_last_digit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, 10, (5000, 3))
    path = write(tmp_path / "p.json", {"a": [{"position": p, "stop": False} for p in points.tolist()]})
    np.testing.assert_array_equal(only(path).positions, points)
