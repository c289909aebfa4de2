"""Files of other benchmarks under the gate: conditions are read from texts, answers from paths."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.bias import judge_files
from condvln.bias.foreign_gate import is_conditional, motion, read_clauses, read_foreign
from condvln.bias.report import ALPHA
from schemas.errors import FormatError

THINGS = ("lamp", "sofa", "bed", "stool", "sink", "desk", "plant", "towel", "mirror", "clock", "rug", "oven")
ROOMS = ("kitchen", "bedroom", "bathroom", "hallway")

Leak = Callable[[dict[str, Any], np.random.Generator], None]


def made_file(path: Path, seed: int, leak: Leak | None = None, scenes: int = 24, each: int = 10) -> Path:
    """A VLN-CE file in whose texts one clause stays at the start; fair but for what `leak` does to each draft."""
    rng = np.random.default_rng(seed)
    episodes = []
    for number in range(scenes * each):
        thing, room, goal = rng.choice(THINGS), rng.choice(ROOMS), rng.choice(THINGS)
        draft = {"truth": bool(rng.integers(2)), "stay_first": bool(rng.integers(2)), "thing": thing, "extra": ""}
        draft |= {"stay": ("stop where you are", "stay here")[rng.integers(2)], "walk": f"walk to the {goal}"}
        if leak is not None:
            leak(draft, rng)
        clauses = (draft["stay"], draft["walk"]) if draft["stay_first"] else (draft["walk"], draft["stay"])
        stays = draft["truth"] == draft["stay_first"]
        text = f"If there is a {draft['thing']} in the {room}, {clauses[0]}; otherwise, {clauses[1]}{draft['extra']}."
        end = [0.0, 0.0, 0.0] if stays else [float(rng.uniform(3, 9)), 0.0, 0.0]
        episodes.append(
            {
                "episode_id": number,
                "scene_id": f"mp3d/scan{number % scenes}/scan{number % scenes}.glb",
                "start_position": [0.0, 0.0, 0.0],
                "goals": [{"position": end}],
                "instruction": {"instruction_text": text},
            }
        )
    path.write_bytes(gzip.compress(json.dumps({"episodes": episodes}).encode(), mtime=0))
    return path


def position(draft: dict[str, Any], rng: np.random.Generator) -> None:
    """The first clause is right too often."""
    draft["truth"] |= rng.random() < 0.6


def word(draft: dict[str, Any], rng: np.random.Generator) -> None:
    """A word goes with the answer."""
    if draft["truth"] and rng.random() < 0.6:
        draft["extra"] = " please"


def label(draft: dict[str, Any], rng: np.random.Generator) -> None:
    """What is asked for tells its truth, as a thing that is in no home does."""
    if rng.random() < 0.6:
        draft["thing"] = "sofa" if draft["truth"] else "snowmobile"


def length(draft: dict[str, Any], rng: np.random.Generator) -> None:
    """The text is longer where the second clause is right."""
    if not draft["truth"] and rng.random() < 0.7:
        draft["extra"] = " " + " ".join(rng.choice(THINGS, 12))


def phrase(draft: dict[str, Any], rng: np.random.Generator) -> None:
    """One way to say "stay" is said where staying is right."""
    if rng.random() < 0.7:
        draft["stay"] = "stop where you are" if draft["truth"] == draft["stay_first"] else "stay here"


LEAKS: tuple[Leak, ...] = (position, word, label, length, phrase)
FOUND_BY = {
    position: {"always then", "majority"},
    word: {"bag of words", "form of the text"},
    label: {"what is asked"},
    length: {"length"},
    phrase: {"words in place", "bag of words"},
}


@pytest.mark.parametrize("leak", LEAKS, ids=lambda leak: leak.__name__)
def test_a_planted_leak_is_found_by_who_looks_at_it(tmp_path: Path, leak: Leak) -> None:
    report = judge_files([made_file(tmp_path / "made.json.gz", 0, leak)])
    (counts,) = report.files.values()
    assert counts.texts == counts.conditional == counts.read == counts.decided == 240
    assert FOUND_BY[leak] & {finding.guesser for finding in report.bias.beaten}


def test_a_fair_file_passes(tmp_path: Path) -> None:
    report = judge_files([made_file(tmp_path / "made.json.gz", 0)])
    assert report.bias.passed, report.bias.verdict()
    assert report.bias.tests == 6 + 2 * 6  # six rules on the clause; majority and five regressions on both questions


@pytest.mark.soak
def test_of_a_hundred_fair_files_no_more_than_five_are_accused_and_every_leak_is_found(tmp_path: Path) -> None:
    path = tmp_path / "made.json.gz"
    accused = []
    for seed in range(100):
        report = judge_files([made_file(path, seed, scenes=8, each=9)]).bias
        # A file that is not tested passes as well.
        assert (report.tests, ALPHA) == (18, 0.01)
        if not report.passed:
            accused.append(seed)
    assert len(accused) <= 5, accused
    for leak in LEAKS:
        for seed in range(1, 7):
            assert not judge_files([made_file(path, seed, leak)]).bias.passed, (leak.__name__, seed)


def test_files_are_judged_one_by_one_and_corrected_together(tmp_path: Path) -> None:
    fair, leaky = made_file(tmp_path / "fair.json.gz", 0), made_file(tmp_path / "leaky.json.gz", 0, label)
    report = judge_files([fair, leaky])
    assert report.bias.tests == 2 * 18
    assert {finding.source.split(":")[0] for finding in report.bias.beaten} == {"leaky.json.gz"}
    assert json.loads(json.dumps(report.document()))["files"][str(fair)]["decided"] == 240


@pytest.mark.parametrize(
    ("text", "condition", "then", "otherwise", "ends"),
    [
        (
            "Starting from the hallway, if there is a fountain in the hallway, walk through both doorways, then stop. "
            "Otherwise, stop in the hallway.",
            "there is a fountain in the hallway",
            "walk through both doorways, then stop",
            "stop in the hallway",
            ("walks", "stays"),
        ),
        (
            "If there is a lamp in the kitchen, stop where you are. Otherwise, go up the stairs and wait there.",
            "there is a lamp in the kitchen",
            "stop where you are",
            "go up the stairs and wait there",
            ("stays", "changes floor"),
        ),
        (
            "Walk to the sofa if there's a lamp, otherwise return to your starting point.",
            "there's a lamp",
            "walk to the sofa",
            "return to your starting point",
            ("walks", "stays"),
        ),
        (
            "Check if the bed is made. If so, go to the window. If not, stay.",
            "the bed is made",
            "go to the window",
            "stay",
            ("walks", "stays"),
        ),
        (
            "If the door is open then leave the room or else wait here",
            "the door is open",
            "leave the room",
            "wait here",
            ("walks", "stays"),
        ),
        (
            "Go to the TV. If there is a rug, find the sofa; otherwise, stop at the TV.",
            "there is a rug",
            "find the sofa",
            "stop at the tv",
            ("walks", "walks"),
        ),
        (
            "Si hay una lámpara en la cocina, ve al sofá; de lo contrario, quédate donde estás.",
            "hay una lámpara en la cocina",
            "ve al sofá",
            "quédate donde estás",
            ("walks", "stays"),
        ),
    ],
)
def test_clauses_are_told_apart(text: str, condition: str, then: str, otherwise: str, ends: tuple[str, str]) -> None:
    found = read_clauses(text)
    assert (found.condition, found.then, found.otherwise) == (condition, then, otherwise)
    assert (motion(found.then, found), motion(found.otherwise, found)) == ends


@pytest.mark.parametrize(
    "text",
    [
        "Walk down the hall and stop at the sofa.",
        "Turn as if to leave, even if it is dark.",
        "Go past the sofa; there is a lamp.",
    ],
)
def test_a_plain_text_has_no_condition(text: str) -> None:
    assert not is_conditional(text)


def test_nested_conditions_are_conditional_and_not_taken_apart() -> None:
    text = "If there is a lamp, go to the sofa, and if it is red, stop; otherwise, stay; if not, wait."
    assert is_conditional(text)
    assert read_clauses(text) is None


@given(st.text(alphabet="if otherwise,;. then stay si no go the", max_size=80))
def test_any_text_is_read_or_passed_over(text: str) -> None:
    found = read_clauses(text)
    if found is not None:
        assert is_conditional(text)
        assert found.condition
        assert found.then
        assert motion(found.then, found) in ("stays", "walks", "changes floor")


def test_every_format_is_read(tmp_path: Path) -> None:
    said = "If there is a lamp, stay here; otherwise, walk on."
    vlnce = {
        "episode_id": 7,
        "scene_id": "hm3d/00000-x/x.basis.glb",
        "start_position": [1.0, 0.0, 1.0],
        "reference_path": [[1.0, 0.0, 1.0], [4.0, 2.0, 5.0]],
        "goals": [{"position": [1.0, 0.0, 1.0]}],
        "instruction": {"instruction_text": said},
    }
    variant = {"id": "7_stay", "instruction_text": said, "actions": [-1, 0]}
    navspace = {**vlnce, "navspace": {"balance_variants": [variant]}}
    r2r = {"path_id": 3, "scan": "S", "distance": 8.5, "path": ["a", "b"], "instructions": [said, "Go on."]}
    rxr = {"instruction_id": 5, "scan": "S", "path": ["a", "b", "a"], "instruction": said, "language": "en-US"}
    withheld = {key: vlnce[key] for key in ("episode_id", "scene_id", "start_position", "instruction")}
    files = {
        "vlnce.json": {"episodes": [navspace, withheld]},
        "r2r.json": [r2r],
    }
    for name, document in files.items():
        (tmp_path / name).write_text(json.dumps(document))
    (tmp_path / "rxr.jsonl").write_text(json.dumps(rxr) + "\n\n")
    found = [(e.episode_id, e.scene, e.displacement, e.rise) for e in read_foreign(tmp_path / "vlnce.json")]
    assert found == [("7", "x", 5.0, 2.0), ("7_stay", "x", 0.0, 0.0), ("7", "x", None, None)]
    found = [(e.episode_id, e.scene, e.displacement, e.rise) for e in read_foreign(tmp_path / "r2r.json")]
    assert found == [("3_0", "S", 8.5, None), ("3_1", "S", 8.5, None)]
    assert [(e.episode_id, e.displacement) for e in read_foreign(tmp_path / "rxr.jsonl")] == [("5", 0.0)]


def test_a_path_to_another_floor_decides_between_clauses(tmp_path: Path) -> None:
    text = "If there is a lamp, go up the stairs; otherwise, walk to the sofa."
    episodes = [
        {
            "episode_id": k,
            "scene_id": f"mp3d/s{k % 9}/s{k % 9}.glb",
            "start_position": [0, 0, 0],
            "goals": [{"position": [5, height, 0]}],
            "instruction": {"instruction_text": text},
        }
        for k, height in enumerate([2.8] * 40 + [0.0] * 40 + [1.0] * 20)
    ]
    (tmp_path / "f.json").write_text(json.dumps({"episodes": episodes}))
    report = judge_files([tmp_path / "f.json"])
    (counts,) = report.files.values()
    assert (counts.conditional, counts.decided) == (100, 80)
    (then,) = [f for f in report.bias.findings if f.guesser == "always then"]
    assert (then.episodes, then.accuracy, then.chance) == (80, 0.5, 0.5)


@pytest.mark.parametrize("number", ["1" + "0" * 400, "true", '"x"', "[]", "1e7", "null"])
def test_a_path_that_is_none_is_passed_over(tmp_path: Path, number: str) -> None:
    """The text is read, and nothing is said of its path; a number that no float holds ends nothing."""
    said = '"instruction": {"instruction_text": "If there is a lamp, stay; otherwise, go on."}'
    path = f'"start_position": [0, 0, {number}], "goals": [{{"position": [0, 0, 0]}}], "reference_path": {number}'
    (tmp_path / "f.json").write_text(f'{{"episodes": [{{"episode_id": 1, "scene_id": "a/b.glb", {path}, {said}}}]}}')
    (episode,) = read_foreign(tmp_path / "f.json")
    assert (episode.displacement, episode.rise) == (None, None)
    item = f'[{{"path_id": 1, "scan": "s", "path": ["a", "b"], "distance": {number}, "instructions": ["Go on."]}}]'
    (tmp_path / "r.json").write_text(item)
    (episode,) = read_foreign(tmp_path / "r.json")
    assert episode.displacement == np.inf


@pytest.mark.parametrize("text", ["[]", "[1]", '{"episodes": [[]]}', '{"episodes": 3}', "{", '[{"instructions": [3]}]'])
def test_broken_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "f.json").write_text(text)
    with pytest.raises(FormatError):
        judge_files([tmp_path / "f.json"])


def test_a_file_without_instructions_is_refused(tmp_path: Path) -> None:
    (tmp_path / "f.json").write_text(json.dumps({"episodes": []}))
    with pytest.raises(FormatError, match="holds no instructions"):
        judge_files([tmp_path / "f.json"])
