"""Prediction files: the three formats, and every way of getting them wrong."""

from __future__ import annotations

import gzip
import json
import math
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
from condvln.evaluation.reading import ReadRules
from schemas.errors import FormatError, UsageError


def pose(x: float, stop: bool | None = False, **more: Any) -> dict[str, Any]:
    return {"position": [x, 0.0, 0.0], "heading": 0.5, **({} if stop is None else {"stop": stop}), **more}


def write(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document))
    return path


def only(path: Path, **rules: Any) -> Prediction:
    (found,) = read_predictions(path, rules=ReadRules(**rules))
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
    # VLN-CE writes "stop": false at every pose of an agent that never stopped.
    denied = write(tmp_path / "q.json", {"a": [pose(0), pose(1)]})
    assert not only(denied).stopped
    assert only(denied, assume_stop=True).stopped
    early = write(tmp_path / "s.json", {"a": [pose(0), pose(1, True), pose(2)]})
    assert len(only(early, assume_stop=True).positions) == 2, "a STOP that is there stays where it is"
    assert not only(write(tmp_path / "r.json", {"a": []}), assume_stop=True).stopped


def test_collisions_where_given(tmp_path: Path) -> None:
    path = write(tmp_path / "p.json", {"a": [pose(0), pose(1, collision=True), pose(2, collision=False)]})
    found = only(path)
    assert found.collided.tolist() == [False, True, False]
    write_predictions(tmp_path / "again.json", [found])
    again = only(tmp_path / "again.json")
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
        ('{"a": [{"heading": 0}]}', "episode a, step 0", "the position is null, not three numbers"),
        (
            '{"a": [{"position": [0, 0, 0]}, {"position": [1e308, 0, 0]}]}',
            "episode a, step 1",
            "the position [1e+308,0,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"b": [], "a": [{"position": [0, 0, 0]}, {"position": [NaN, 0, 0]}]}',
            "episode a, step 1",
            "the number nan in the position is not finite",
        ),
        ('{"a": [{"position": [0, 0, 0], "stop": 2}]}', "episode a, step 0", "stop is 2, neither true nor false"),
        (
            '{"a": [{"position": [0, 0, 0], "position": [1, 0, 0]}]}',
            "episode a",
            "invalid JSON: the key 'position' occurs twice in one object",
        ),
        ('{"a": [{"position": [0, 0, 0', "entry 0", "the file is truncated, or its brackets do not match"),
        ('{"a": [' + "[" * 9999, "entry 0", "the document is nested more than 64 levels deep"),
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
            '{"instruction_id": 1, "path": [[0, 1e308, 0]]}',
            "episode 1, step 0",
            "the position [0,1e+308,0] is farther than 100000 m from the origin of its scene",
        ),
        (
            '{"instruction_id": 1, "path": []}\n{"instruction',
            "line 2, character 1",
            "not JSON: Unterminated string starting at",
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


# -- what agents' own files look like ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "trajectory",
    [
        ["a", "b", "c", "d"],
        [["a", 0.1, 0.0], ["b", 0, 0], ["c", 0, 0], ["d", 0, 0]],
        [["a"], ["b", "c"], ["d"]],
        [["a"], ["b", "c", "d"]],
        [["a"], ["a", "b"], ["b", "c", "d"]],
        [["a"], [], [["b", 0.5, 0.0], ["c", 0.1, 0.2]], "d"],
        [[["a", "b"], ["c"]], ["d"]],
        [["a", "b", "c", "d"]],
    ],
)
def test_every_viewpoint_of_a_step_is_on_the_path(tmp_path: Path, trajectory: Any) -> None:
    entry = {"instr_id": "1_0", "trajectory": trajectory}
    for path in write(tmp_path / "array.json", [entry]), write(tmp_path / "line.jsonl", entry):
        assert detect_format(path) == "r2r"
        assert list(read_graph_predictions(path)) == [GraphPrediction("1_0", ("a", "b", "c", "d"))]


@pytest.mark.parametrize("end", [True, 1, 1.0])
def test_stop_may_be_one_or_zero(tmp_path: Path, end: Any) -> None:
    path = write(tmp_path / "p.json", {"a": [pose(0, 0), pose(0.25, end), pose(0.5, 0)]})  # type: ignore[arg-type]
    found = only(path)
    assert (found.stopped, len(found.positions)) == (True, 2)


@pytest.mark.parametrize("name", ["474", 474, 474.0, "474.0", "474.00"])
def test_ids_are_whole_numbers_however_they_are_written(tmp_path: Path, name: Any) -> None:
    path = write(tmp_path / "p.jsonl", {"instruction_id": name, "path": [[0, 0, 0]]})
    assert only(path).episode_id == "474"
    assert only(write(tmp_path / "p.json", {str(name): [pose(0)]})).episode_id == "474"


@pytest.mark.parametrize("name", [True, 0.5, [1], {}, None])
def test_what_names_no_episode_is_refused(tmp_path: Path, name: Any) -> None:
    path = write(tmp_path / "p.jsonl", {"instruction_id": name, "path": [[0, 0, 0]]})
    with pytest.raises(FormatError, match="instruction_id is"):
        only(path)


def test_headings_that_are_not_finite_are_read(tmp_path: Path) -> None:
    for value in (math.nan, math.inf, None, "north"):
        poses = [{"position": [0, 0, 0], "heading": value}, {"position": [0.25, 0, 0], "heading": 0, "stop": True}]
        assert only(write(tmp_path / "p.json", {"a": poses})).stopped
    graph = write(tmp_path / "g.json", [{"instr_id": "1_0", "trajectory": [["a", math.nan, 0], ["b", 0, math.inf]]}])
    assert list(read_graph_predictions(graph)) == [GraphPrediction("1_0", ("a", "b"))]


@pytest.mark.parametrize("key", ["path", "trajectory"])
@pytest.mark.parametrize("name", ["episode_id", "instruction_id", "instr_id"])
@pytest.mark.parametrize("lines", [True, False], ids=["lines", "array"])
def test_entries_that_name_their_episode(tmp_path: Path, lines: bool, name: str, key: str) -> None:
    points = [[0, 0, 0], [0.25, 0, 0]]
    poses = [pose(0), pose(0.25, True), pose(9)]
    found = []
    for number, way in enumerate((points, poses)):
        entry = {"model": "m", name: 7, key: way}
        path = write(tmp_path / f"{number}.json", entry if lines else [entry])
        assert detect_format(path) == "rxr"
        found.append(only(path))
    for one, counts in zip(found, (False, True), strict=True):
        assert (one.episode_id, one.stopped, one.counts_actions) == ("7", True, counts)
        assert one.positions.tolist() == points


REPEATED = {
    "object.json": '{"1": [{"position": [0, 0, 0], "stop": 0}], "2": [], "1.0": [{"position": [5, 0, 0], "stop": 0}]}',
    "lines.jsonl": '{"instruction_id": 1, "path": [[0, 0, 0]]}\n{"instruction_id": 2, "path": []}\n'
    '{"instruction_id": "1", "path": [[5, 0, 0]]}',
    "array.json": '[{"episode_id": 1, "path": [[0, 0, 0]]}, {"episode_id": 2, "path": []}, '
    '{"episode_id": "1", "path": [[5, 0, 0]]}]',
}


@pytest.mark.parametrize("name", REPEATED)
def test_the_last_of_duplicates_is_kept_where_that_is_asked(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(REPEATED[name])
    with pytest.raises(FormatError, match="--duplicates keep-last"):
        list(read_predictions(path))
    notes: list[str] = []
    found = list(read_predictions(path, rules=ReadRules(duplicates="keep-last"), notes=notes))
    assert [(one.episode_id, one.positions.tolist()) for one in found] == [("1", [[5, 0, 0]]), ("2", [])]
    assert notes == ["1 predictions of episodes that the file has again later were left out"]


CUT = {
    "object.json": '{"1": [{"position": [0, 0, 0], "stop": 0}], "2": [{"position": [0, 0',
    "lines.jsonl": '{"instruction_id": 1, "path": [[0, 0, 0]]}\n{"instruction_id": 2, "path": [[0, ',
    "array.json": '[{"episode_id": 1, "path": [[0, 0, 0]]}, {"episode_id": 2, "path": [[0',
}


@pytest.mark.parametrize("name", CUT)
def test_an_unfinished_end_is_left_out_where_that_is_asked(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(CUT[name])
    with pytest.raises(FormatError, match="--allow-partial"):
        list(read_predictions(path))
    notes: list[str] = []
    found = list(read_predictions(path, rules=ReadRules(allow_partial=True), notes=notes))
    assert [one.episode_id for one in found] == ["1"]
    assert len(notes) == 1
    assert "left out" in notes[0]


@pytest.mark.parametrize("shape", ["object", "array", "lines"])
def test_a_gzip_file_is_read_up_to_the_place_where_it_is_cut_off(tmp_path: Path, shape: str) -> None:
    """As a killed run leaves it: 200 episodes, whose points no compressor shortens, cut in the middle."""
    rng = np.random.default_rng(1)
    paths = {str(k): rng.normal(0, 10, (40, 3)).tolist() for k in range(200)}
    if shape == "object":
        text = json.dumps({name: [{"position": p, "stop": False} for p in path] for name, path in paths.items()})
    else:
        rows = [{"episode_id": name, "path": path} for name, path in paths.items()]
        text = json.dumps(rows) if shape == "array" else "\n".join(map(json.dumps, rows))
    packed = gzip.compress(text.encode())
    path = tmp_path / "p.backup"
    path.write_bytes(packed[: len(packed) // 2])
    with pytest.raises(FormatError, match=r"the gzip file ends early.*--allow-partial"):
        list(read_predictions(path))
    notes: list[str] = []
    found = list(read_predictions(path, rules=ReadRules(allow_partial=True), notes=notes))
    assert [one.episode_id for one in found] == [*paths][: len(found)]
    assert 90 <= len(found) <= 110
    assert notes == [f"the gzip file ends early: {len(found)} entries were read, and what follows them was left out"]


def test_a_broken_line_before_the_last_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "p.jsonl"
    path.write_text('{"instruction_id": 1, "path": []}\n{"instruction_id": 2, "pa\n{"instruction_id": 3, "path": []}\n')
    with pytest.raises(FormatError, match="line 2"):
        list(read_predictions(path, rules=ReadRules(allow_partial=True)))


@pytest.mark.parametrize("end", [{}, {"stop": None}, {"Stop": True}, {"done": True}])
@pytest.mark.parametrize("lines", [False, True])
def test_paths_that_say_nothing_of_a_stop_are_counted(tmp_path: Path, lines: bool, end: dict[str, Any]) -> None:
    silent, aloud = [pose(0, None), pose(0.25, None) | end], [pose(0), pose(0.25, True)]
    rows = [{"episode_id": name, "path": path} for name, path in (("1", silent), ("2", aloud))]
    path = write(tmp_path / "p.json", rows if lines else {"1": silent, "2": aloud})
    notes: list[str] = []
    assert [one.stopped for one in read_predictions(path, notes=notes)] == [False, True]
    assert len(notes) == 1
    assert notes[0].startswith("1 of 2 paths do not say whether the agent stopped")
    notes.clear()
    assumed = read_predictions(path, rules=ReadRules(assume_stop=True), notes=notes)
    assert [one.stopped for one in assumed] == [True, True]
    assert not notes


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("array", [True, False])
@pytest.mark.parametrize("place", [[0, 0, 0], "viewpoint"])
def test_a_summary_beside_predictions_is_left_out(tmp_path: Path, place: Any, array: bool, first: bool) -> None:
    rows: list[Any] = [{"episode_id": k, "path": [place]} for k in (474, 475.0)]
    rows.insert(0 if first else 2, {"mean_success": 0.5, "length": 2})
    path = tmp_path / "p.json"
    path.write_text(json.dumps(rows) if array else "\r\n".join(map(json.dumps, rows)))
    notes: list[str] = []
    if isinstance(place, str):
        found = [one.instruction_id for one in read_graph_predictions(path, notes=notes)]
    else:
        found = [one.episode_id for one in read_predictions(path, notes=notes)]
    assert found == ["474", "475"]
    assert len(notes) == 1
    assert notes[0].startswith("1 entries without in")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (json.dumps({"1": [pose(0)]}).encode("utf-16"), "the text is UTF-16, not UTF-8"),
        (b'{"all": [{"episode_id": 1, "path": [[0, 0, 0]]}]}', "the key 'all' holds a list of predictions"),
        (b'[{"episode_id": 1e999, "path": [[0, 0, 0]]}]', "episode_id is Infinity, not text or a number"),
        (b'{"1": [{"position": {"x": 0, "y": 0, "z": 0}}]}', 'the position is {"x":0,"y":0,"z":0}, not three numbers'),
        (b'{"1": []}' + b"\0" * 9, "there is text after the end of the JSON document"),
        (gzip.compress(b'{"1": []}', mtime=0) + b"more", "the gzip file is damaged"),
        (gzip.compress(gzip.compress(b'{"1": []}', mtime=0), mtime=0), "neither a JSON object nor a JSON array"),
    ],
)
def test_other_odd_files_are_refused_by_what_is_wrong(tmp_path: Path, data: bytes, says: str) -> None:
    path = tmp_path / "agent.backup"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        list(read_predictions(path))
    assert says in str(caught.value)


def test_rules_that_are_unknown_are_refused() -> None:
    with pytest.raises(UsageError, match="keep-last"):
        ReadRules(duplicates="first")  # type: ignore[arg-type]
