"""An export takes its place at once: whatever the moment of a kill, the folder holds the old export or the new one."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from condvln.export import staging
from condvln.export.contents import INDEX
from condvln.export.staging import check_place, recover, staged
from condvln.formats import streams
from schemas.errors import StoreError

DRIVER = Path(__file__).with_name("killed_exports.py")


def files(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def write(folder: Path, names: dict[str, str]) -> None:
    """An export of our own files, with its record."""
    listed = ",".join(f'"{name}":{{"sha256":"{text}"}}' for name, text in names.items())
    for name, text in names.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / INDEX).write_text(f'{{"files":{{{listed}}}}}')


@pytest.fixture(params=["exchanged", "renamed twice"])
def exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "renamed twice":
        monkeypatch.setattr(staging, "_exchange", lambda one, other: False)
    return str(request.param)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "place" / "out"
    folder.mkdir(parents=True)
    write(folder, {"manifest/a.jsonl": "old", "gone/b": "old"})
    return folder


def test_the_users_files_outlive_an_export_and_its_own_do_not(out: Path, exchange: str) -> None:
    (out / "notes.txt").write_text("mine")
    (out / "gone" / "mine").mkdir(parents=True)
    (out / "link").symlink_to("notes.txt")
    (out / "plots" / "empty").mkdir(parents=True)
    inode = (out / "notes.txt").stat().st_ino
    with staged(out) as new:
        write(new, {"manifest/a.jsonl": "new"})
    assert (out / "manifest" / "a.jsonl").read_text() == "new"
    assert not (out / "gone" / "b").exists()
    assert (out / "notes.txt").stat().st_ino == inode
    assert os.readlink(out / "link") == "notes.txt"
    assert (out / "plots" / "empty").is_dir()
    assert (out / "gone" / "mine").is_dir()
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_what_the_user_adds_while_an_export_is_written_is_kept(
    out: Path, exchange: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = staging._take_place

    def add_first(place: staging._Place) -> None:
        (out / "late.txt").write_text("mine")
        take(place)

    monkeypatch.setattr(staging, "_take_place", add_first)
    with staged(out) as new:
        write(new, {"manifest/a.jsonl": "new"})
    assert (out / "late.txt").read_text() == "mine"
    assert (out / "manifest" / "a.jsonl").read_text() == "new"


def test_an_error_leaves_the_export_in_place_and_nothing_beside_it(out: Path, exchange: str) -> None:
    before = files(out)

    def stop() -> None:
        with staged(out) as new:
            (new / "manifest").mkdir()
            (new / "manifest").mkdir()

    with pytest.raises(FileExistsError):
        stop()
    assert files(out) == before
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_a_link_stays_a_link_and_its_target_is_replaced(out: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(out)
    with staged(link) as new:
        assert new.parent == out.parent
        write(new, {"manifest/a.jsonl": "new"})
    assert link.is_symlink()
    assert (out / "manifest" / "a.jsonl").read_text() == "new"


def test_a_mount_point_and_a_parent_that_cannot_be_written_are_refused_before_any_work(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(os.path, "ismount", lambda path: Path(path) == out)
        with pytest.raises(StoreError, match=f"is a mount point.*such as {out}/export"):
            check_place(out)
    with monkeypatch.context() as patch:
        patch.setattr(os.path, "ismount", lambda path: Path(path) == out / "gone")
        with pytest.raises(StoreError, match=f"holds, at {out}/gone, a mount point"):
            check_place(out)
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda path, mode: Path(path) != out.parent)
        with pytest.raises(StoreError, match="parent of the export folder is not writable"):
            check_place(out)


def test_the_mode_of_the_folder_is_kept(out: Path) -> None:
    out.chmod(0o2775)
    with staged(out) as new:
        write(new, {"a": "new"})
    assert out.stat().st_mode & 0o7777 == 0o2775


def test_all_bytes_and_names_are_on_the_disk_before_the_exchange(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a power cut could leave the new names with empty files."""
    synced: set[int] = set()
    real, take = os.fsync, staging._take_place

    def noted(opened: int) -> None:
        synced.add(os.fstat(opened).st_ino)
        real(opened)

    def check_first(place: staging._Place) -> None:
        inodes = {path.stat().st_ino for path in [place.ready, *place.ready.rglob("*")]}
        assert inodes <= synced
        take(place)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(staging, "_take_place", check_first)
    with staged(out) as new:
        for name in ("manifest/a.jsonl", "vlnce/a/a.json.gz"):
            with streams.atomic_stream(new / name) as stream:
                stream.write(b"x")
        streams.atomic_copy(new / "vlnce/a/a.json.gz", new / "ansr/a/a.json.gz")
    assert out.parent.stat().st_ino in synced


def test_what_a_killed_export_left_is_removed_and_an_export_between_two_renames_is_put_back(out: Path) -> None:
    before = files(out)
    for state in ("new", "ready"):
        out.with_name(f".out.{state}").mkdir()
        write(out.with_name(f".out.{state}"), {"manifest/a.jsonl": "half"})
    recover(out)
    assert files(out) == before
    os.rename(out, out.with_name(".out.old"))
    out.with_name(".out.ready").mkdir()
    write(out.with_name(".out.ready"), {"manifest/a.jsonl": "new"})
    recover(out)
    assert files(out) == before
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_a_half_removed_old_export_leaves_nothing_in_the_new_one(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its files are not taken for the user's when its record is gone already."""

    def half(folder: Path) -> None:
        (folder / INDEX).unlink(missing_ok=True)

    with monkeypatch.context() as patch:
        patch.setattr(staging, "_remove", half)
        with staged(out) as new:
            write(new, {"manifest/a.jsonl": "new"})
    assert out.with_name(".out.new").exists()
    recover(out)
    assert sorted(files(out)) == [INDEX, "manifest/a.jsonl"]
    assert [path.name for path in out.parent.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("way", "former", "step"),
    [
        ("exchange", "none", 10),  # where there was no export, none is exchanged
        ("exchange", "other", 10),
        ("rename", "other", 10),
        pytest.param("exchange", "none", 1, marks=pytest.mark.soak),
        *(
            pytest.param(way, former, 1, marks=pytest.mark.soak)
            for way in ("exchange", "rename")
            for former in ("other", "same")
        ),
    ],
)
def test_killed_at_every_so_many_changes_of_the_disk(tmp_path: Path, way: str, former: str, step: int) -> None:
    words = [sys.executable, str(DRIVER), str(tmp_path), way, former, str(step)]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    points = int(run.stdout.split()[0])
    assert points > 60
