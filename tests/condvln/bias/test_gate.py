"""The gate lets fair rows pass and names what gives the gold leaf away."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.bias import judge, judge_export
from condvln.bias.gate import LEAST_EPISODES
from condvln.bias.regression import blocks
from condvln.bias.report import ALL
from condvln.labels.lists import goes_with
from schemas.errors import FormatError, MissingFileError
from tests.condvln.bias.conftest import LABELS


def caught(rows: list[dict[str, Any]]) -> set[str]:
    return {finding.guesser for finding in judge(rows).beaten}


@pytest.mark.parametrize("seed", range(2))
def test_fair_rows_pass(made_rows, seed: int) -> None:
    report = judge(made_rows(seed, categories=("simple", "chain", "nested_chain")))
    assert report.passed, report.verdict()
    assert report.verdict().startswith("no guesser beats chance")
    # A test a guesser and part, and the leaves of the cells with 200 episodes and more.
    assert report.tests == 19 * 4 + len(report.uniformity)
    assert {cell.category: cell.p for cell in report.uniformity} == {"chain": 1.0, "nested_chain": 1.0}


def test_a_near_target_that_is_gold_too_often_is_found(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if rng.random() < 0.35:
            row["leaves"][row["gold_leaf"]]["geodesic_distance"] = 1.0

    assert caught(made_rows(0, leak=leak)) == {"nearest target"}


def test_a_far_target_and_a_long_route_are_told_apart(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if rng.random() < 0.35:
            row["leaves"][row["gold_leaf"]]["route_length"] = 90.0

    assert caught(made_rows(0, leak=leak)) == {"longest route"}


def test_labels_that_tell_their_truth_are_found(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        for condition in row["program"]["conditions"]:
            if rng.random() < 0.7:
                condition["label"] = "lamp" if condition["truth"] else "sofa"

    assert caught(made_rows(0, leak=leak)) >= {"label and room", "whole statement", "words in place"}


def test_labels_whose_truths_are_balanced_over_scenes_are_found(made_rows) -> None:
    """Each label is true in every other block of scenes and false in the others: after each it is owed the other truth,
    so that betting on what was seen loses, and betting against it wins.
    """
    scenes = [f"made/s{k}" for k in range(20)]
    even = {scenes[k] for block in blocks(scenes)[::2] for k in block.tolist()}

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        for condition in row["program"]["conditions"]:
            due = bool(condition["truth"]) == (f"made/{row['scene_id']}" in even)
            condition["label"] = LABELS[2 * rng.integers(3) + due]

    found = caught(made_rows(0, leak=leak))
    assert {"against label and room", "against whole statement"} <= found
    assert not {"label and room", "whole statement"} & found


def test_a_word_that_goes_with_a_leaf_is_found(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if row["gold_leaf"] == 0 and rng.random() < 0.6:
            row["instruction_text"] = row["instruction_text"].replace("go to", "please go to")

    assert caught(made_rows(0, leak=leak)) >= {"bag of words", "form of the text"}


def test_goals_that_are_worth_more_are_found(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if rng.random() < 0.6:
            row["program"]["leaves"][row["gold_leaf"]]["moves"][-1]["label"] = "washing machine"

    assert "worth" in caught(made_rows(0, leak=leak))


def test_goals_that_go_with_what_was_asked_are_found(made_rows) -> None:
    fitting = sorted(goes_with()["towel"])

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        row["program"]["conditions"][0]["label"] = "towel"
        if rng.random() < 0.6:
            row["program"]["leaves"][row["gold_leaf"]]["moves"][-1]["label"] = str(rng.choice(fitting))

    assert "purpose" in caught(made_rows(0, leak=leak))


def test_a_voice_that_goes_with_a_leaf_is_found(made_rows) -> None:
    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if rng.random() < 0.7:
            row["instruction_text"] = row["instruction_text"].replace(
                "go to", ("walk to", "head to", "go to")[row["gold_leaf"]]
            )

    assert caught(made_rows(0, leak=leak)) >= {"voice and length"}


def test_a_length_that_goes_with_a_leaf_is_found(made_rows) -> None:
    """Longer by words of things alone, which say nothing else."""

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if rng.random() < 0.6:
            things = rng.choice(["lamp", "sofa", "bed"], 12 * row["gold_leaf"])
            row["instruction_text"] = row["instruction_text"].replace("go to", f"{' '.join(things)} go to")

    assert "voice and length" in caught(made_rows(0, leak=leak))


def test_definiteness_that_goes_with_a_leaf_is_found(made_rows) -> None:
    """What is known to be there is said "the lamp": where only true things are, the words tell."""

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        for condition in row["program"]["conditions"]:
            condition["definite"] = bool(condition["truth"]) == (rng.random() < 0.75)

    assert {"voice and length", "definite or not"} <= caught(made_rows(0, leak=leak))


def test_a_pair_of_conditions_that_is_definite_together_is_found(made_rows) -> None:
    """Neither alone tells: of a chain's two conditions both are definite, or neither, where its last leaf is gold."""

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if row["category"] == "chain":
            one = bool(rng.integers(2))
            same = (row["gold_leaf"] == 2) == (rng.random() < 0.85)
            for condition, flag in zip(row["program"]["conditions"], (one, one == same), strict=True):
                condition["definite"] = flag

    assert "voice and length" in caught(made_rows(0, each=8, categories=("chain",), leak=leak))


def test_a_leaf_that_is_gold_too_often_is_found(made_rows) -> None:
    rows = made_rows(0, scenes=24, categories=("chain",))
    rows = [r for r in rows if r["gold_leaf"] != 1 or int(r["scene_id"][1:]) % 2]
    report = judge(rows)
    assert [cell.counts for cell in report.uneven] == [(96, 48, 96)]
    assert not report.passed
    assert "uneven: [96, 48, 96]" in report.verdict()


def asking(row: dict[str, Any], rng: np.random.Generator) -> bool:
    """Makes each condition ask for a relation, an eighth of the episodes for "on"; says whether this one does."""
    asks = rng.random() < 0.125
    for k, condition in enumerate(row["program"]["conditions"]):
        predicate = "on" if asks and k == 0 else ("near", "north of", "")[rng.integers(3)]
        anchors = [{"object_id": "a", "label": "desk"}]
        condition["qualifier"] = {"predicate": predicate, "anchors": anchors} if predicate else None
    return bool(asks)


def test_a_leak_of_one_predicate_is_found_in_its_own_part(made_rows) -> None:
    """An eighth of the episodes leaks: too few to show in the whole, and all that ask for one predicate."""

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if asking(row, rng) and rng.random() < 0.9:
            row["leaves"][row["gold_leaf"]]["geodesic_distance"] = 1.0

    report = judge(made_rows(0, scenes=24, leak=leak))
    assert [(f.guesser, f.predicate, f.part) for f in report.beaten] == [("nearest target", "on", "asks: on")]
    assert "(made asks: on)" in report.verdict()
    assert ("nearest target", "made", "asks: on") in [row[:3] for row in report.overview()]
    (found,) = report.beaten
    assert found.category == ALL
    rows = made_rows(0, scenes=24, leak=leak)
    holding = [
        r for r in rows if any((c["qualifier"] or {}).get("predicate") == "on" for c in r["program"]["conditions"])
    ]
    assert found.episodes == len(holding)
    assert not any(f.beats_chance for f in judge([r for r in rows if r not in holding]).findings)


@pytest.mark.parametrize("seed", range(2))
def test_fair_rows_pass_for_each_predicate(made_rows, seed: int) -> None:
    report = judge(made_rows(seed, leak=asking))
    assert report.passed, report.verdict()
    tested = {f.predicate for f in report.findings}
    assert tested == {ALL, "near", "north of", "on", "presence"}
    # All tests count in the correction: the least p-value is multiplied by their number.
    least = min(report.findings, key=lambda f: f.p)
    assert least.p_holm == pytest.approx(min(1.0, least.p * report.tests))


def test_a_predicate_that_all_ask_for_is_not_tested_twice(made_rows) -> None:
    report = judge(made_rows(0, categories=("simple",)))
    assert {f.predicate for f in report.findings} == {ALL}


def test_one_scene_that_leaks_is_not_the_dataset(made_rows) -> None:
    """Guesses of one scene stand and fall together: only the scenes' own test knows."""

    def leak(row: dict[str, Any], rng: np.random.Generator) -> None:
        if row["scene_id"] in ("s0", "s1"):
            row["leaves"][row["gold_leaf"]]["geodesic_distance"] = 1.0

    report = judge(made_rows(0, each=20, scenes=10, categories=("simple",), leak=leak))
    (found,) = [f for f in report.findings if f.guesser == "nearest target" and f.part == ALL]
    assert found.accuracy > 0.55
    assert found.p > 0.01


def test_order_says_nothing(made_rows) -> None:
    rows = made_rows(1)
    turned = [rows[k] for k in np.random.default_rng(0).permutation(len(rows))]
    assert judge(turned).document() == judge(rows).document()


def test_of_a_group_one_episode_is_guessed_at(made_rows) -> None:
    rows = made_rows(2, categories=("simple",))
    groups = [{**row, "episode_hash": f"{row['episode_hash']}-g{k}", "group_id": row["episode_hash"]}
              for row in rows for k in range(4)]  # fmt: skip
    report = judge([*rows, *groups])
    assert report.groups == len(rows)
    assert report.episodes == 2 * len(rows)
    assert sum(report.uniformity[0].counts) == 5 * len(rows)
    # Which one is drawn has nothing to do with what the others are.
    assert judge([*rows, *groups[::-1]]).document() == report.document()


def test_small_exports_are_not_judged(made_rows) -> None:
    report = judge(made_rows(0, scenes=2, each=2, categories=("simple",)))
    assert report.tests == 0
    assert report.passed
    assert report.untested == (("made", "simple", 8),)
    assert "too few" in report.verdict()
    assert judge([]).passed


def test_small_cells_count_in_the_whole(made_rows) -> None:
    rows = [*made_rows(0, categories=("simple",)), *made_rows(0, categories=("chain",))[: LEAST_EPISODES - 1]]
    report = judge(rows)
    assert report.untested == (("made", "chain", LEAST_EPISODES - 1),)
    (whole,) = [f for f in report.findings if f.guesser == "nearest target" and f.part == ALL]
    assert whole.episodes == len(rows)
    assert whole.chance == pytest.approx((160 / 2 + 29 / 3) / 189)


def test_the_document_is_json_and_the_overview_its_rows(made_rows) -> None:
    report = judge(made_rows(3))
    document = json.loads(json.dumps(report.document()))
    assert document["passed"] is True
    assert len(document["findings"]) + len(document["uniformity"]) == report.tests
    assert [row[0] for row in report.overview()] == list(dict.fromkeys(f.guesser for f in report.findings))


def test_exports_are_read(made_rows, tmp_path: Path) -> None:
    rows = made_rows(0)
    (tmp_path / "manifest").mkdir()
    for split, part in (("train", rows[::2]), ("test", rows[1::2])):
        lines = "".join(json.dumps(row) + "\n" for row in part)
        (tmp_path / "manifest" / f"{split}.jsonl").write_text(lines)
    assert judge_export(tmp_path).document() == judge(rows).document()
    with pytest.raises(MissingFileError, match="manifest"):
        judge_export(tmp_path / "manifest")


@pytest.mark.parametrize(
    "change",
    [{"gold_leaf": 2}, {"gold_leaf": None}, {"category": "odd"}, {"leaves": []}, {"program": None}, {"program": {}}],
    ids=lambda change: next(iter(change.items()))[0],
)
def test_rows_that_are_none_are_refused(made_rows, change: dict[str, Any]) -> None:
    row = made_rows(0, scenes=1, categories=("simple",))[0]
    with pytest.raises(FormatError, match="manifest row"):
        judge([{**row, **change}])
