"""A split from its files to its scores: the manifest's reader, predictions matched to tasks, navmeshes proven."""

from __future__ import annotations

import gzip
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from condvln.episodes.identity import numeric_id
from condvln.evaluation.aggregate import summary
from condvln.evaluation.episode_stats import evaluation_of_stats, is_episode_stats, read_episode_stats
from condvln.evaluation.evaluate import AXES, Evaluation, evaluate
from condvln.evaluation.predictions import Prediction
from condvln.evaluation.reading import ReadRules
from condvln.evaluation.split import evaluate_split, forward_step, split_tasks
from condvln.evaluation.task import Task, read_tasks
from condvln.export.snapshot import export_snapshot
from condvln.navigation.pathfinder import Pathfinder
from condvln.navigation.scene_navmesh import NavmeshFolder
from schemas.errors import FormatError, MissingFileError, PathEscapeError, UsageError
from tests.condvln.evaluation.conftest import OpenPlain, task_with
from tests.made_snapshot import made_snapshot


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export")
    export_snapshot(made_snapshot(), out)
    return out


@pytest.fixture(scope="module")
def tasks(export: Path) -> list[Task]:
    return split_tasks(export, "train")


def perfect(task: Task) -> Prediction:
    return Prediction(task.episode_id, task.reference, True, False)


def world(task: Task) -> Any:
    return OpenPlain()


def test_tasks_are_those_of_the_manifest(export: Path, tasks: list[Task]) -> None:
    lines = [json.loads(line) for line in (export / "manifest" / "train.jsonl").read_text().splitlines()]
    assert [task.episode_id for task in tasks] == [str(line["episode_id"]) for line in lines]
    for task, line in zip(tasks, lines, strict=True):
        gold = line["leaves"][line["gold_leaf"]]
        assert task.gold.goals.tolist() == gold["goals"]
        assert task.gold.subgoals.tolist() == [s["position"] for s in gold["subgoals"]]
        assert task.reference[0].tolist() == line["start_position"]
        assert task.axes["scene"] == f"{line['source']}/{line['scene_id']}"
        assert set(task.axes) == set(AXES)
        assert len(task.leaves) == len(line["leaves"])


def test_a_split_has_a_part_of_each_source(export: Path, tasks: list[Task]) -> None:
    sources = sorted({str(task.axes["source"]) for task in tasks})
    parts = {source: [task.episode_id for task in split_tasks(export, f"train:{source}")] for source in sources}
    for source, found in parts.items():
        assert found == [task.episode_id for task in tasks if task.axes["source"] == source] != []
    with pytest.raises(UsageError, match=rf"no episodes of 'hm3d'.*{sources[0]}"):
        split_tasks(export, "train:hm3d")


def test_without_ground_truth_the_reference_path_is_made_dense(export: Path, tasks: list[Task]) -> None:
    for bare, full in zip(read_tasks(export / "manifest" / "train.jsonl"), tasks, strict=True):
        np.testing.assert_allclose(bare.reference, full.reference, atol=6e-4)  # ground truth is rounded to 1 mm


def test_predictions_in_any_order_and_missing_ones(tasks: list[Task]) -> None:
    handed_in = [perfect(task) for task in tasks]
    whole = evaluate(tasks, handed_in, world)
    assert evaluate(tasks, handed_in[::-1], world).rows() == whole.rows()
    half = evaluate(tasks, handed_in[: len(tasks) // 2], world)
    assert half.scores["missing"].sum() == len(tasks) - len(tasks) // 2
    assert half.scores["success"].sum() == len(tasks) // 2
    assert evaluate(tasks, [], world).scores["success"].sum() == 0


def test_rxr_numbers_stand_for_ids(tasks: list[Task]) -> None:
    numbered = [Prediction(str(numeric_id(t.episode_hash)), t.reference, True, False) for t in tasks]
    assert (evaluate(tasks, numbered, world).scores["success"] == 1).all()
    assert len({numeric_id(t.episode_hash) for t in tasks}) == len(tasks)
    with pytest.raises(FormatError, match="predicted twice"):
        evaluate(tasks, [numbered[0], perfect(tasks[0])], world)


def test_unknown_and_repeated_ids_are_errors(tasks: list[Task]) -> None:
    stranger = Prediction("stranger", tasks[0].reference, True, False)
    with pytest.raises(FormatError, match=r"agent.json: no episode 'stranger' in this split"):
        evaluate(tasks, [stranger], world, where="agent.json")
    with pytest.raises(FormatError, match="predicted twice"):
        evaluate(tasks, [perfect(tasks[0])] * 2, world)


def test_a_sweep_keeps_what_depends_on_the_distance(tasks: list[Task]) -> None:
    short = [Prediction(t.episode_id, t.reference[:-5], True, False) for t in tasks if len(t.reference) > 6]
    found = evaluate(tasks, short, world, radii=(0.5, 1.0, 3.0))
    assert set(found.sweep) == {0.5, 1.0, 3.0}
    rates = [found.sweep[radius]["success"].mean() for radius in (0.5, 1.0, 3.0)]
    assert rates == sorted(rates)
    assert rates[0] < rates[-1]
    np.testing.assert_array_equal(found.sweep[1.0]["spl"], found.scores["spl"])


# -- files -------------------------------------------------------------------------------------------------------------


def spoiled(export: Path, folder: Path, change: Any) -> Path:
    lines = [json.loads(line) for line in (export / "manifest" / "train.jsonl").read_text().splitlines()]
    change(lines)
    path = folder / "train.jsonl"
    path.write_text("\n".join(json.dumps(line) for line in lines))
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: lines[2].pop("gold_leaf"), "line 3: gold_leaf"),
        (lambda lines: lines[1].update(extra=1), "line 2: extra"),
        (lambda lines: lines[1].update(gold_leaf=9), "line 2: gold_leaf: there is no leaf"),
        (lambda lines: lines[1].update(gold_leaf=-1), "line 2: gold_leaf: there is no leaf"),
        (lambda lines: lines[1]["leaves"].pop(), "line 2: leaves"),
        (lambda lines: lines[1]["leaves"][0].update(leaf=1), "line 2: leaves"),
        (lambda lines: lines.append(lines[0]), "occurs twice"),
        (lambda lines: lines[0].update(start_position=[0, 0]), "line 1: start_position"),
    ],
)
def test_a_damaged_manifest_is_told_by_line(export: Path, tmp_path: Path, change: Any, says: str) -> None:
    with pytest.raises(FormatError, match=says):
        list(read_tasks(spoiled(export, tmp_path, change)))


def test_ground_truth_must_fit(export: Path, tmp_path: Path) -> None:
    manifest = export / "manifest" / "train.jsonl"
    truth = tmp_path / "gt.json"
    for text, says in (
        ("{}", "has no entry in"),
        ('{"a": {"locations": []}}', "episode a: locations: empty"),
        ('{"a": {"locations": [[0, 0]]}}', "episode a"),
        ("[[1]]", "an array"),
    ):
        truth.write_text(text)
        with pytest.raises(FormatError, match=says):
            list(read_tasks(manifest, truth))


def test_no_such_split_names_those_there_are(export: Path) -> None:
    with pytest.raises(MissingFileError, match="test, train, val_seen, val_unseen"):
        split_tasks(export, "all")


def test_two_agents_of_one_name_are_refused(export: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="have the same name"):
        evaluate_split(export, "train", [tmp_path / "near.json"] * 2)


@pytest.fixture
def navmesh(tmp_path: Path, l_shape: Pathfinder) -> tuple[Path, str]:
    path = tmp_path / "data" / "meshes" / "a.navmesh"
    path.parent.mkdir(parents=True)
    l_shape.save(path)
    return path, hashlib.sha256(path.read_bytes()).hexdigest()


LEAVES = [{"goals": [[1, 0, 1]]}, {"goals": [[3, 0, 1]]}]


def test_navmeshes_are_found_below_the_roots_and_proven(navmesh: tuple[Path, str], tmp_path: Path) -> None:
    _, digest = navmesh
    task = task_with(LEAVES, navmesh="meshes/a.navmesh", navmesh_sha256=digest)
    folder = NavmeshFolder((tmp_path, tmp_path / "data"))
    assert folder(task).navigable_area == pytest.approx(12)
    assert folder(task) is folder(task)
    with pytest.raises(MissingFileError, match="--data DIR"):
        NavmeshFolder((tmp_path,))(task)
    with pytest.raises(FormatError, match="its hash differs"):
        NavmeshFolder((tmp_path / "data",))(task_with(LEAVES, navmesh="meshes/a.navmesh", navmesh_sha256="1" * 64))


@pytest.mark.parametrize("name", ["/etc/passwd", "../data/meshes/a.navmesh", "a/../../b"])
def test_a_navmesh_outside_of_the_roots_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PathEscapeError):
        NavmeshFolder((tmp_path,))(task_with(LEAVES, navmesh=name))


# -- results that others wrote -----------------------------------------------------------------------------------------


def test_episode_stats_are_aggregated_without_flattery(tmp_path: Path) -> None:
    tasks = [
        task_with(LEAVES, episode_id=name)
        if name != "d"
        else task_with([{**LEAVES[0], "subgoals": [[0, 0, 1]]}, LEAVES[1]], episode_id=name)
        for name in "abcd"
    ]
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "stats_a.json").write_text(
        '{"distance_to_goal": 0.5, "success": 1.0, "spl": 0.9, "collisions": {"count": 3}}'
    )
    (folder / "stats_b.json").write_text('{"distance_to_goal": Infinity, "success": 0.0, "spl": NaN}')
    (folder / "stats_d.json").write_text('{"d": {"success": true, "bsa": 1.0, "spl": 1.0}}')
    (folder / "notes.json").write_text("[]")
    stats = read_episode_stats(folder)
    assert stats["a"] == {"navigation_error": 0.5, "success": 1.0, "spl": 0.9, "collisions": 3.0}
    found: Evaluation = evaluation_of_stats(tasks, stats, agent="theirs")
    assert found.scores["success"].tolist() == [1, 0, 0, 1]
    assert found.scores["missing"].tolist() == [0, 0, 1, 0]
    assert math.isnan(found.scores["navigation_error"][1])  # infinite is undefined, never 0
    assert found.scores["spl"][1] == 0  # a failure's
    assert found.notes == tuple(
        f"{name} is undefined in 2 of 3 results, which its mean leaves out"
        for name in ("bsa_all", "collisions", "navigation_error")
    )
    np.testing.assert_array_equal(found.scores["bsa"], [1, np.nan, np.nan, 1])
    np.testing.assert_array_equal(found.scores["csr"], [1, np.nan, np.nan, 1])
    np.testing.assert_array_equal(found.scores["bsa_all"], [1, 0, 0, 1])
    together = tmp_path / "snapshot.json"
    together.write_text(json.dumps({"a": {"success": 1}}))
    assert read_episode_stats(together) == {"a": {"success": 1.0}}
    with pytest.raises(FormatError, match="no episode 'z'"):
        evaluation_of_stats(tasks, {"z": {}})


BRANCHES = ("bsa", "csr", "bsa_all", "csr_all")


def test_results_of_the_forks_have_their_own_bsa_and_those_of_vlnce_none(tmp_path: Path) -> None:
    with_stop = [{**LEAVES[0], "subgoals": [[0, 0, 1]]}, LEAVES[1]]
    tasks = [task_with(with_stop if name in "cd" else LEAVES, episode_id=name) for name in "abcde"]
    path = tmp_path / "stats.json"
    stock = {name: {"success": float(name in "ac"), "spl": 0.5} for name in "abcd"}
    path.write_text(json.dumps(stock))
    plain = evaluation_of_stats(tasks, read_episode_stats(path))
    for name in BRANCHES:
        assert np.isnan(plain.scores[name]).all(), "what is not there is undefined"
    assert plain.scores["success"].tolist() == [1, 0, 1, 0, 0]
    assert plain.scores["spl"].tolist() == [0.5, 0, 0.5, 0, 0]
    assert plain.notes == ("spl was set to 0, as a failure has it, in 2 of 4 results",)
    assert np.isnan(plain.scores["ndtw"]).all(), "not even where an episode is missing"
    theirs = {"a": 1.0, "b": 0.0, "c": 0.25, "d": 1.0}
    path.write_text(json.dumps({name: {**stock[name], "branch_selection_accuracy": theirs[name]} for name in stock}))
    fork = evaluation_of_stats(tasks, read_episode_stats(path))
    assert fork.scores["bsa_all"].tolist() == [1, 0, 0.25, 1, 0]
    assert fork.scores["csr_all"].tolist() == [1, 0, 0, 0, 0]
    np.testing.assert_array_equal(fork.scores["bsa"], [1, np.nan, 0.25, 1, np.nan])


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("stats_a.json", "{", "not JSON"),
        ("other.json", '{"success": 1}', "neither"),
        ("stats_a.json", "[1]", "neither"),
    ],
)
def test_episode_stats_gone_wrong(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=says):
        read_episode_stats(tmp_path / name)


def test_episode_stats_of_nothing_or_twice(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="holds no episode"):
        read_episode_stats(tmp_path)
    (tmp_path / "stats_a.json").write_text('{"success": 1}')
    (tmp_path / "stats_b.json").write_text('{"a": {"success": 1}}')
    with pytest.raises(FormatError, match="two results"):
        read_episode_stats(tmp_path)


def results(tasks: list[Task], path: Path, text: str, **rules: Any) -> Evaluation:
    path.write_text(text)
    notes: list[str] = []
    return evaluation_of_stats(tasks, read_episode_stats(path, ReadRules(**rules), notes), notes=notes)


TEN = tuple(str(number) for number in range(10))
UNKNOWN = ("NaN", "Infinity", "-Infinity", "null", None)
"""How an episode's results say that a measure is not known; None leaves its key out."""


def of_ten(**measures: Any) -> str:
    """A file of ten results, in which each measure is a function of the number of the episode, as JSON."""
    entries = []
    for number in range(10):
        known = {name: value(number) for name, value in measures.items()}
        pairs = [f'"{name}": {value}' for name, value in known.items() if value is not None]
        entries.append(f'"{number}": {{{", ".join(pairs)}}}')
    return "{" + ", ".join(entries) + "}"


@pytest.fixture(scope="module")
def ten() -> list[Task]:
    return [task_with(LEAVES, episode_id=name) for name in TEN]


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_a_failure_has_no_spl_whatever_its_file_says(ten: list[Task], tmp_path: Path, unknown: str | None) -> None:
    """Five of ten succeed with an SPL of 0.9; the others' SPL is not known."""
    text = of_ten(
        success=lambda k: int(k < 5),
        spl=lambda k: 0.9 if k < 5 else unknown,
        sdtw=lambda k: 0.8 if k < 5 else unknown,
        csr=lambda k: 1 if k < 5 else unknown,
    )
    found = results(ten, tmp_path / "r.json", text)
    means = summary(found).estimates
    assert [means[name].mean for name in ("success", "spl", "sdtw", "csr_all")] == [0.5, 0.45, 0.4, 0.5]
    assert [means[name].n for name in ("success", "spl", "sdtw", "csr_all")] == [10] * 4
    assert found.notes == ()


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_what_is_undefined_is_counted_and_said(ten: list[Task], tmp_path: Path, unknown: str | None) -> None:
    text = of_ten(
        success=lambda k: int(k < 5),
        spl=lambda k: 0.9 if k in (0, 9) else (unknown if k < 5 else 0),
        os=lambda k: unknown if k in (0, 9) else int(k < 7),
        ne=lambda k: unknown if k < 3 else 1.5,
        ndtw=lambda k: unknown if k == 4 else 0.5,
    )
    found = results(ten, tmp_path / "r.json", text)
    means = summary(found).estimates
    assert means["spl"].n == 6
    assert means["spl"].mean == pytest.approx(0.15)
    assert (means["oracle_success"].n, means["oracle_success"].mean) == (9, pytest.approx(7 / 9))
    assert (means["navigation_error"].n, means["ndtw"].n) == (7, 9)
    assert found.notes == (
        "spl was set to 0, as a failure has it, in 1 of 10 results",
        "navigation_error is undefined in 3 of 10 results, which its mean leaves out",
        "ndtw is undefined in 1 of 10 results, which its mean leaves out",
        "oracle_success is undefined in 1 of 10 results, which its mean leaves out",
        "spl is undefined in 4 of 10 results, which its mean leaves out",
    )


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_without_a_success_what_it_decides_is_undefined_too(
    ten: list[Task], tmp_path: Path, unknown: str | None
) -> None:
    text = of_ten(
        success=lambda k: unknown if k < 8 else 0,
        spl=lambda k: 1 if k < 8 else 0,
        os=lambda k: 0,
        bsa=lambda k: 0.5,
        csr=lambda k: 1,
    )
    means = summary(results(ten, tmp_path / "r.json", text)).estimates
    assert [means[name].n for name in ("success", "spl", "oracle_success", "bsa_all", "csr_all")] == [2] * 5
    assert means["spl"].mean == means["csr_all"].mean == 0


def test_a_failure_without_bsa_has_no_csr(tmp_path: Path) -> None:
    """CSR follows from BSA and success; a failure needs no BSA to have none."""
    with_stop = [{**LEAVES[0], "subgoals": [[0, 0, 1]]}, LEAVES[1]]
    tasks = [task_with(with_stop, episode_id=name) for name in "abcd"]
    text = '{"a": {"success": 1, "bsa": 1}, "b": {"success": 0}, "c": {"success": 1}, "d": {"bsa": 1}}'
    found = results(tasks, tmp_path / "r.json", text)
    np.testing.assert_array_equal(found.scores["csr_all"], [1, 0, np.nan, np.nan])
    np.testing.assert_array_equal(found.scores["bsa_all"], [1, np.nan, np.nan, np.nan])
    means = summary(found).estimates
    assert means["csr_all"].mean <= means["success"].mean


@pytest.mark.parametrize("value", ['"0.5"', '"yes"', "[1]", "0.5", "2", "-1"])
def test_what_is_no_result_of_one_episode_is_refused(ten: list[Task], tmp_path: Path, value: str) -> None:
    with pytest.raises(FormatError, match="episode 3: success is"):
        results(ten, tmp_path / "r.json", of_ten(success=lambda k: value if k == 3 else 1))


def test_results_without_any_measure_are_refused(ten: list[Task], tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"no measure that is known.*success"):
        results(ten, tmp_path / "r.json", '{"1": {"path": [[0, 0, 0]]}, "2": {}}')


STREAM = [{"scene_id": "apt", "episode_id": k, "success": k % 2, "spl": 0.5 * (k % 2), "ne": 1.5} for k in range(4)]
TOTAL = {"sucs_all": 0.5, "spls_all": 0.25, "length": 4}


def lines(*rows: Any) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)


@pytest.mark.parametrize(
    ("text", "notes"),
    [
        (lines(TOTAL, *STREAM), 1),
        (lines(*STREAM, TOTAL), 1),
        (lines(TOTAL, TOTAL, *STREAM, TOTAL), 1),
        ("\ufeff" + lines(*STREAM).replace("\n", "\r\n"), 0),
        (lines(*STREAM), 0),
        (json.dumps([TOTAL, *STREAM], indent=1), 1),
        (json.dumps(STREAM), 0),
        (json.dumps(STREAM, indent=2), 0),
        (lines(*({**row, "episode_id": float(row["episode_id"])} for row in STREAM)), 0),
        (lines(*({**row, "episode_id": f"{row['episode_id']}.0"} for row in STREAM)), 0),
        (lines(*({"instruction": "If {a [b", **row} for row in STREAM)), 0),
        (json.dumps({f"{row['episode_id']}.0": row for row in STREAM}), 0),
    ],
)
def test_entries_of_results_with_a_summary_anywhere(ten: list[Task], tmp_path: Path, text: str, notes: int) -> None:
    (tmp_path / "result.json").write_text(text)
    assert is_episode_stats(tmp_path / "result.json")
    found = results(ten[:4], tmp_path / "result.json", text)
    assert found.scores["success"].tolist() == [0, 1, 0, 1]
    assert found.scores["navigation_error"].tolist() == [1.5] * 4
    assert len(found.notes) == notes
    assert all("without episode_id" in note for note in found.notes)


LAST = {**STREAM[0], "success": 1, "spl": 1.0}


@pytest.mark.parametrize(
    "text",
    [
        lines(*STREAM, LAST),
        json.dumps([*STREAM, LAST]),
        "{" + ", ".join(f'"{row["episode_id"]}": {json.dumps(row)}' for row in [*STREAM, LAST]) + "}",
    ],
    ids=["lines", "array", "object"],
)
def test_the_last_of_duplicate_results_is_kept_where_that_is_asked(ten: list[Task], tmp_path: Path, text: str) -> None:
    with pytest.raises(FormatError, match="--duplicates keep-last"):
        results(ten[:4], tmp_path / "r.json", text)
    found = results(ten[:4], tmp_path / "r.json", text, duplicates="keep-last")
    assert found.scores["success"].tolist() == [1, 1, 0, 1]
    assert found.notes == ("1 results of episodes that the file has again later were left out",)


@pytest.mark.parametrize(
    "text",
    [
        lines(*STREAM)[:-9],
        json.dumps(STREAM)[:-9],
        "{" + ", ".join(f'"{row["episode_id"]}": {json.dumps(row)}' for row in STREAM)[:-9],
    ],
    ids=["lines", "array", "object"],
)
def test_an_unfinished_result_is_left_out_where_that_is_asked(ten: list[Task], tmp_path: Path, text: str) -> None:
    with pytest.raises(FormatError, match="--allow-partial"):
        results(ten[:4], tmp_path / "r.json", text)
    found = results(ten[:4], tmp_path / "r.json", text, allow_partial=True)
    assert found.scores["missing"].tolist() == [0, 0, 0, 1]
    assert len(found.notes) == 1
    assert "left out" in found.notes[0]


def test_an_unfinished_file_of_a_folder_is_left_out_where_that_is_asked(ten: list[Task], tmp_path: Path) -> None:
    for row in STREAM:
        (tmp_path / f"stats_{row['episode_id']}.json").write_text(json.dumps(row))
    (tmp_path / "stats_2.json").write_text('{"success": 1, "sp')
    with pytest.raises(FormatError, match=r"stats_2\.json.*--allow-partial"):
        read_episode_stats(tmp_path)
    notes: list[str] = []
    found = read_episode_stats(tmp_path, ReadRules(allow_partial=True), notes)
    assert [*found] == ["0", "1", "3"]
    assert len(notes) == 1
    assert "stats_2.json can't be read and was left out" in notes[0]


def test_the_step_of_an_export_is_that_of_its_configuration(tmp_path: Path) -> None:
    assert forward_step(tmp_path) == 0.25
    path = tmp_path / "configs" / "vlnce" / "condvln_task.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("SIMULATOR: {FORWARD_STEP_SIZE: 0.5}")
    assert forward_step(tmp_path) == 0.5
    for text in ("SIMULATOR: {}", "[]", "SIMULATOR: {FORWARD_STEP_SIZE: -1}", "{", "SIMULATOR: {FORWARD_STEP_SIZE: x}"):
        path.write_text(text)
        with pytest.raises(FormatError, match="--forward-step"):
            forward_step(tmp_path)


def test_results_of_a_stock_split_without_a_manifest(tmp_path: Path) -> None:
    """As R2R_VLNCE's: {episodes} beside results of VLN-CE by id; paths are refused with a reason."""
    episodes = [
        {"episode_id": number, "scene_id": f"mp3d/{scene}/{scene}.glb"}
        for number, scene in enumerate(("a", "a", "b", "c"))
    ]
    (tmp_path / "val_seen").mkdir()
    (tmp_path / "val_seen" / "val_seen.json").write_text(json.dumps({"episodes": episodes}))
    with gzip.open(tmp_path / "val_seen" / "val_seen.json.gz", "wt") as file:
        json.dump({"episodes": episodes}, file)
    results = tmp_path / "stats.json"
    results.write_text(json.dumps({str(k): {"success": float(k < 2), "spl": k / 4 if k < 2 else 0} for k in range(4)}))
    (found,), tasks = evaluate_split(tmp_path, "val_seen", [results])
    assert tasks == []
    assert found.means["success"] == 0.5
    assert found.means["spl"] == pytest.approx(0.25 / 4, abs=1e-12)
    assert np.isnan(found.means["bsa_all"])
    assert np.isnan(found.means["csr"])
    assert found.axes["scene"].tolist() == [episode["scene_id"] for episode in episodes]
    paths = tmp_path / "paths.json"
    paths.write_text(json.dumps({"0": [{"position": [0, 0, 0], "stop": True}]}))
    with pytest.raises(UsageError, match="manifest"):
        evaluate_split(tmp_path, "val_seen", [paths])
    with gzip.open(tmp_path / "val_seen" / "val_seen.json.gz", "wt") as file:
        json.dump({"episodes": [*episodes, episodes[0]]}, file)
    with pytest.raises(FormatError, match="twice"):
        evaluate_split(tmp_path, "val_seen", [results])
