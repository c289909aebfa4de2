"""Faults planted in the layouts of a folder: the verifier names the layout."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from condvln.verify.layouts import prove_layouts
from jobs.verify_trajectories import write_layout
from tests.jobs.trajectories.made import rows


def copied(folder: Path, out: Path) -> Path:
    """Return a copy whose images are links: a test replaces files, and writes into none."""
    shutil.copytree(folder, out, copy_function=os.link, ignore=shutil.ignore_patterns(".condvln"))
    return out


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return copied(made, tmp_path / "copy")


def replace(path: Path, data: bytes) -> None:
    path.unlink()
    path.write_bytes(data)


def lines(path: Path, change: Callable[[list[Any]], object]) -> None:
    found = [json.loads(line) for line in path.read_bytes().splitlines()]
    change(found)
    replace(path, b"".join(json.dumps(row).encode() + b"\n" for row in found))


def listed(path: Path, change: Callable[[list[Any]], object]) -> None:
    found = json.loads(path.read_bytes())
    change(found)
    replace(path, json.dumps(found).encode())


def cell(path: Path, column: str, change: Callable[[Any], Any]) -> None:
    table = pq.read_table(path)
    values = table[column].to_pylist()
    values[2] = change(values[2])
    at = table.schema.get_field_index(column)
    replaced = table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))
    path.unlink()
    pq.write_table(replaced, path)


def swap(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    assert first != second
    replace(one, second)
    replace(other, first)


def first_of(folder: Path, pattern: str, count: int = 1) -> list[Path]:
    return sorted(folder.rglob(pattern))[:count]


def n1(folder: Path) -> Path:
    return first_of(folder / "internvla-n1", "episode_000000.parquet")[0]


def images_of_n1(folder: Path) -> list[Path]:
    (place,) = first_of(folder / "internvla-n1", "observation.images.rgb.125cm_30deg")
    return [place / "episode_000000_0.jpg", place / "episode_000000_4.jpg"]


def lr(folder: Path) -> Path:
    return folder / "lerobot/data/chunk-000/file-000.parquet"


def rewritten(path: Path, change: Callable[[list[pa.Table]], list[pa.Table]]) -> None:
    """Replace the row groups of a file."""
    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        groups = [file.read_row_group(group) for group in range(file.num_row_groups)]
    path.unlink()
    with pq.ParquetWriter(path, schema) as writer:
        for table in change(groups):
            writer.write_table(table)


def in_the_first_walk(column: str, change: Callable[[list[Any]], object]) -> Callable[[Path], None]:
    """A fault in one column of the first walk of a LeRobot dataset."""

    def changed(groups: list[pa.Table]) -> list[pa.Table]:
        values = groups[0][column].to_pylist()
        change(values)
        at = groups[0].schema.get_field_index(column)
        field = groups[0].schema.field(at)
        return [groups[0].set_column(at, field, pa.array(values, field.type)), *groups[1:]]

    return lambda folder: rewritten(lr(folder), changed)


def swapped(values: list[Any]) -> None:
    values[0], values[5] = values[5], values[0]


def described(name: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """A fault in a JSON document of a LeRobot dataset."""

    def changed(folder: Path) -> None:
        path = folder / "lerobot/meta" / name
        found = json.loads(path.read_bytes())
        change(found)
        replace(path, json.dumps(found).encode())

    return changed


def answered(key: str, place: int, value: Any) -> Callable[[list[Any]], object]:
    return lambda found: found[place].update({key: value})


def replied(found: list[Any]) -> None:
    found[5]["conversations"][1]["value"] += " stop"


MUTANTS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "an answer": (
        "navila",
        lambda f: lines(f / "navila/annotations.json", answered("a", 7, "Go.")),
    ),
    "a question": ("navila", lambda f: lines(f / "navila/annotations.json", answered("q", 7, "Go."))),
    "a frame": ("navila", lambda f: lines(f / "navila/annotations.json", lambda rows: rows[7]["frames"].pop(0))),
    "a row lost": ("navila", lambda f: lines(f / "navila/annotations.json", lambda rows: rows.pop())),
    "a row twice": ("navila", lambda f: lines(f / "navila/annotations.json", lambda rows: rows.append(rows[-1]))),
    "no file": ("navila", lambda f: (f / "navila/annotations.json").unlink()),
    "a reply": ("uninavid", lambda f: listed(f / "uninavid/annotations.json", replied)),
    "a video": ("uninavid", lambda f: swap(*first_of(f / "uninavid/nav_videos", "*_*.mp4", 2))),
    "a video lost": ("uninavid", lambda f: first_of(f / "uninavid/nav_videos", "*.mp4")[0].unlink()),
    "a video cut": ("uninavid", lambda f: replace(p := first_of(f / "uninavid", "*.mp4")[0], p.read_bytes()[:-99])),
    "a sample lost": ("uninavid", lambda f: listed(f / "uninavid/annotations.json", lambda rows: rows.pop(3))),
    "a choice": ("janusvln", lambda f: listed(f / "janusvln/train.json", replied)),
    "an image": ("janusvln", lambda f: listed(f / "janusvln/train.json", lambda rows: rows[5]["images"].reverse())),
    "a sample twice": ("janusvln", lambda f: listed(f / "janusvln/train.json", lambda rows: rows.append(rows[-1]))),
    "frames swapped": ("janusvln", lambda f: swap(*first_of(f / "janusvln/trajectory_data", "rgb_000[05]_*", 2))),
    "a frame lost": ("janusvln", lambda f: first_of(f / "janusvln/trajectory_data", "*.png")[0].unlink()),
    "an action": ("internvla-n1", lambda f: cell(n1(f), "action", lambda value: value % 3 + 1)),
    "a pose": ("internvla-n1", lambda f: cell(n1(f), "pose.125cm_30deg", lambda m: [*m[:3], [0, 0, 0, 2]])),
    "a goal": ("internvla-n1", lambda f: cell(n1(f), "goal.125cm_30deg", lambda goal: [goal[0] + 1, goal[1]])),
    "a goal's frame": ("internvla-n1", lambda f: cell(n1(f), "relative_goal_frame_id.125cm_30deg", lambda k: k + 1)),
    "a task": ("internvla-n1", lambda f: lines(first_of(f, "tasks.jsonl")[0], answered("task", 0, "Go."))),
    "a length": ("internvla-n1", lambda f: lines(first_of(f, "episodes.jsonl")[0], answered("length", 0, 3))),
    "a description": (
        "internvla-n1",
        lambda f: replace(p := first_of(f / "internvla-n1", "info.json")[0], p.read_bytes().replace(b"v2.1", b"v2.0")),
    ),
    "a statistic": (
        "internvla-n1",
        lambda f: lines(first_of(f, "episodes_stats.jsonl")[0], answered("stats", 0, {})),
    ),
    "images swapped": ("internvla-n1", lambda f: swap(*images_of_n1(f))),
    "an image lost": ("internvla-n1", lambda f: images_of_n1(f)[0].unlink()),
    "a frame's action": ("lerobot", in_the_first_walk("action", lambda found: found.__setitem__(2, found[2] % 3 + 1))),
    "a frame's state": ("lerobot", in_the_first_walk("observation.state", lambda found: found[2].__setitem__(3, 9.0))),
    "a frame's leaf": ("lerobot", in_the_first_walk("leaf", lambda found: found.__setitem__(2, 7))),
    "an end": ("lerobot", in_the_first_walk("next.done", lambda found: found.__setitem__(0, True))),
    "images of frames swapped": ("lerobot", in_the_first_walk("observation.images.rgb", swapped)),
    "depth of frames swapped": ("lerobot", in_the_first_walk("observation.images.depth.125cm_30deg", swapped)),
    "walks swapped": ("lerobot", lambda f: rewritten(lr(f), lambda groups: [groups[1], groups[0], *groups[2:]])),
    "a walk lost": ("lerobot", lambda f: rewritten(lr(f), lambda groups: groups[:-1])),
    "a walk twice": ("lerobot", lambda f: rewritten(lr(f), lambda groups: [*groups, groups[-1]])),
    "a file lost": ("lerobot", lambda f: lr(f).unlink()),
    "a length of time": ("lerobot", described("info.json", lambda found: found.update(fps=10))),
    "a shape": (
        "lerobot",
        described("info.json", lambda found: found["features"]["observation.images.rgb"].update(shape=[24, 32, 1])),
    ),
    "a mean": ("lerobot", described("stats.json", lambda found: found["action"].update(mean=[1.0]))),
    "a colour": (
        "lerobot",
        described("stats.json", lambda found: found["observation.images.rgb"].update(std=[[[0]], [[0]], [[0]]])),
    ),
    "an instruction": ("lerobot", lambda f: cell(f / "lerobot/meta/tasks.parquet", "task", lambda text: text + "!")),
    "an episode": (
        "lerobot",
        lambda f: cell(f / "lerobot/meta/episodes/chunk-000/file-000.parquet", "episode_id", lambda number: number + 1),
    ),
    "a scene lost": ("internvla-n1", lambda f: shutil.rmtree(min((f / "internvla-n1").iterdir()))),
}


def faults_of(folder: Path, layout: str) -> list[str]:
    """Return the faults of one layout; the record names no other, whose folders are a fault each, left out here."""
    record = json.loads((folder / "trajectories.json").read_bytes()) | {"layouts": [layout]}
    found = [what for _, what in prove_layouts(folder, record, rows(folder, "trajectories"), write_layout).faults]
    unnamed = [what for what in found if "the record does not name" in what]
    assert not any(what.startswith(layout) for what in unnamed)
    return [what for what in found if what not in unnamed]


@pytest.mark.soak
@pytest.mark.parametrize("fault", MUTANTS)
def test_a_planted_fault_is_found(fault: str, made: Path, wide: Path, tmp_path: Path) -> None:
    layout, change = MUTANTS[fault]
    copy = copied(wide if layout == "uninavid" else made, tmp_path / "copy")
    change(copy)
    found = faults_of(copy, layout)
    assert found
    assert all(what.startswith(f"{layout}: ") for what in found)


@pytest.mark.parametrize("layout", ["navila", "uninavid", "janusvln", "internvla-n1", "lerobot"])
def test_sound_layouts_have_no_fault(layout: str, made: Path, wide: Path) -> None:
    assert faults_of(wide if layout == "uninavid" else made, layout) == []


def test_a_layout_that_the_record_does_not_name_is_a_fault(copy: Path) -> None:
    """Else a damaged layout passes once its name is gone from the record."""
    record = json.loads((copy / "trajectories.json").read_bytes())
    found = prove_layouts(copy, {**record, "layouts": ["other"]}, rows(copy, "trajectories"), write_layout).faults
    assert sorted(what for _, what in found) == [
        *(
            f"{name}: the folder is there, but the record does not name this layout"
            for name in sorted({*record["layouts"]} - {"streamvln"})
        ),
        "other: the record names a layout that is not known here",
    ]


def test_a_layout_without_samples_has_no_words(copy: Path) -> None:
    replace(copy / "navila" / "annotations.json", b"")
    record = json.loads((copy / "trajectories.json").read_bytes()) | {"layouts": ["navila"]}
    proof = prove_layouts(copy, record, rows(copy, "trajectories"), write_layout)
    assert (proof.rows["navila"], proof.words["navila"]) == (0, {})
    assert ("", "navila: annotations.json is not what the walks, poses and images give") in proof.faults
