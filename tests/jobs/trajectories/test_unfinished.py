"""What killed runs leave unfinished in a folder of trajectories goes; all else stays, in the folder and outside."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from condvln.trajectories.images import clear_parts
from condvln.trajectories.layouts import HUBS
from jobs.trajectories import LAYOUTS, RECIPE, WRITTEN, Request, make_trajectories
from schemas.errors import UsageError
from tests.jobs.trajectories.made import content
from tests.jobs.trajectories.test_recipe import again, recipe

__all__ = ["recipe"]


def put(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"kept")
    return path


def test_whatever_a_run_writes_under_another_name_is_removed(
    asked: Request, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    moved: set[Path] = set()

    def noted(real: Any) -> Any:
        def wrapper(source: Any, *args: Any, **kwargs: Any) -> Any:
            path = Path(source)
            if out in path.parents and ".condvln" not in path.parts:
                moved.add(path)
            return real(source, *args, **kwargs)

        return wrapper

    with monkeypatch.context() as patch:
        for name in ("replace", "rename"):
            patch.setattr(os, name, noted(getattr(os, name)))
        make_trajectories(again(asked, recipe, out))
    finished = {path for path in out.rglob("*") if ".condvln" not in path.parts}
    # The layouts' own files lie in their unfinished folders and go with them.
    names = {path.relative_to(out).parts[0] for path in moved}
    assert {".annotations.json.part", ".poses.parquet.part", ".recipe.part", ".lerobot.part", "images"} <= names
    for path in moved:
        put(path if path.suffix == ".part" and "." in path.stem[1:] else path / "rgb" / "001.jpg")
    assert {path for path in out.rglob("*") if ".condvln" not in path.parts} > finished
    clear_parts(out, WRITTEN)
    assert {path for path in out.rglob("*") if ".condvln" not in path.parts} == finished


def test_files_of_other_names_stay(tmp_path: Path) -> None:
    out = tmp_path / "out"
    kept = [
        put(out / name)
        for name in (
            "mine/.thesis.part",
            "mine/.annotations.json.part",
            ".thesis.part/chapter",
            "lerobot/.mine.part",
            "images/.part-mine/001.jpg",
            "images/.f.part",
            ".condvln/.lerobot.part",
        )
    ]
    gone = [put(out / name) for name in (".lerobot.part/data/x", "navila/.annotations.json.part")]
    gone.append(put(out / "images" / ".part-123-w" / "rgb" / "001.jpg"))
    clear_parts(out, WRITTEN)
    assert [path for path in kept if not path.exists()] == []
    assert [path for path in gone if path.exists()] == []


def test_nothing_outside_of_the_folder_is_removed(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    kept = [
        put(elsewhere / name)
        for name in (".f.part", ".keep.part/x", ".part-1-w/rgb/001.jpg", ".annotations.json.part", "whole/x")
    ]
    out.mkdir()
    for name in ("images", "navila", ".lerobot.part"):
        (out / name).symlink_to(elsewhere)
    (out / ".poses.parquet.part").symlink_to(kept[0])
    clear_parts(out, WRITTEN)
    assert [path for path in kept if not path.exists()] == []
    assert not (out / ".lerobot.part").is_symlink(), "the link has a name of ours, its target has not"
    assert not (out / ".poses.parquet.part").is_symlink()
    own = tmp_path / "own" / "images"
    own.mkdir(parents=True)
    (own / ".part-1-w").symlink_to(elsewhere)
    clear_parts(own.parent, WRITTEN)
    assert [path for path in kept if not path.exists()] == []


@pytest.mark.parametrize("name", ["images", RECIPE, *(name for name in LAYOUTS if name not in HUBS)])
def test_a_linked_folder_is_refused_before_anything_changes(
    asked: Request, recipe: Path, tmp_path: Path, name: str
) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    kept = put(elsewhere / "holiday" / "001.jpg")
    (out / ".condvln").mkdir(parents=True)
    (out / name).symlink_to(elsewhere)
    with pytest.raises(UsageError, match="is a link") as caught:
        make_trajectories(again(asked, recipe, out))
    assert caught.value.where == str(out / name)
    assert [path for path in elsewhere.rglob("*") if path.is_file()] == [kept]
    assert (out / name).is_symlink()
    assert not any((out / ".condvln").iterdir())


def test_a_linked_walk_is_replaced_and_what_it_leads_to_stays(asked: Request, recipe: Path, tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    make_trajectories(again(asked, recipe, out))
    made = content(out)
    (walk,) = (out / "images").iterdir()
    kept = put(elsewhere / "rgb" / "001.jpg")
    # A walk that the folder does not have, and one that must be made again.
    (out / "images" / "stray").symlink_to(elsewhere)
    walk.rename(tmp_path / "walk")
    walk.symlink_to(elsewhere)
    assert make_trajectories(again(asked, recipe, out)).exit_code == 0
    assert kept.read_bytes() == b"kept"
    assert [path for path in elsewhere.rglob("*") if path.is_file()] == [kept]
    assert not [path for path in out.rglob("*") if path.is_symlink()]
    assert content(out) == made
