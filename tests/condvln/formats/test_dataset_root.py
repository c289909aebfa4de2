"""No path found in a file leads out of the dataset."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats.dataset_root import DatasetRoot, list_files
from schemas.errors import FormatError, InputError, MissingFileError, PathEscapeError


@pytest.fixture
def root(tmp_path: Path) -> DatasetRoot:
    folder = tmp_path / "data"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "f").write_bytes(b"12345")
    (tmp_path / "secret").write_bytes(b"secret")
    return DatasetRoot(folder)


@pytest.mark.parametrize(
    "path", ["../secret", "a/../../secret", "../../../etc/passwd", "..", "/etc/passwd", "C:\\x", "\\x", "..\\secret"]
)
def test_ways_out_are_refused(root: DatasetRoot, path: str) -> None:
    with pytest.raises(PathEscapeError) as caught:
        root.join("", path, where="f.json", place="key")
    assert caught.value.where == "f.json"
    assert caught.value.place == "key"


def test_ways_inside_are_normalised(root: DatasetRoot) -> None:
    assert root.join("configs/objects", "../../objects/x.glb") == "objects/x.glb"
    assert root.join("", "./a//f") == "a/f"
    assert root.read("a/f", 5) == b"12345"


@given(base=st.sampled_from(["", "a", "a/b"]), path=st.text("./a\\:\0 ~", max_size=12))
def test_whatever_is_joined_stays_below_the_root(base: str, path: str) -> None:
    try:
        joined = DatasetRoot(Path("root")).join(base, path)
    except InputError:
        return
    assert not os.path.isabs(joined)
    assert ".." not in joined.split("/")


def test_a_symlink_out_is_refused_and_one_inside_is_not(root: DatasetRoot) -> None:
    (root.folder / "out").symlink_to(root.folder.parent / "secret")
    (root.folder / "up").symlink_to(root.folder.parent)
    (root.folder / "in").symlink_to(root.folder / "a" / "f")
    for path in ("out", "up/secret"):
        with pytest.raises(PathEscapeError, match="symbolic link"):
            root.read(path, 100)
    assert root.read("in", 5) == b"12345"


def test_a_root_that_is_itself_a_symlink_serves(root: DatasetRoot) -> None:
    link = root.folder.parent / "link"
    link.symlink_to(root.folder)
    assert DatasetRoot(link).read("a/f", 5) == b"12345"


def test_what_can_not_be_read_is_told_apart(root: DatasetRoot) -> None:
    with pytest.raises(MissingFileError, match="not there"):
        root.read("a/none", 5)
    with pytest.raises(MissingFileError, match="can't be opened"):
        root.read("a", 5)
    with pytest.raises(FormatError, match="larger than 4 bytes"):
        root.read("a/f", 4)
    with pytest.raises(MissingFileError):
        root.read("x" * 5000, 5)
    assert not root.has("x" * 5000)
    with pytest.raises(FormatError, match="not a path"):
        root.join("", "a\0b")


@pytest.mark.parametrize(
    ("cache", "root"),
    [
        ("hub/datasets--a--b/blobs/3f2a", "hub/datasets--a--b/snapshots/9c1d"),
        ("hub/datasets--a--b/blobs/3f2a", "hub/datasets--a--b/snapshots/9c1d/scenes"),
        ("repo/.dvc/cache/files/md5/ab/cd12", "repo/data"),
        ("repo/.git/annex/objects/x1/y2/SHA256E-s5--ab.json/SHA256E-s5--ab.json", "repo/data/scenes"),
        ("repo/.git/annex/objects/x1/y2/SHA256E-s5--ab.json/SHA256E-s5--ab.json", "repo"),
    ],
)
@pytest.mark.parametrize("relative", [True, False])
def test_links_to_a_cache_beside_the_root_are_followed(tmp_path: Path, cache: str, root: str, relative: bool) -> None:
    folder, content = tmp_path / root, tmp_path / cache
    folder.mkdir(parents=True)
    content.parent.mkdir(parents=True)
    content.write_bytes(b"12345")
    (folder / "f").symlink_to(os.path.relpath(content, folder) if relative else content)
    (folder / "same").symlink_to(content)
    files = DatasetRoot(folder)
    assert files.has("f")
    assert files.read("f", 5) == b"12345"
    # Equal content is one file of the cache, but two files of the dataset.
    assert list_files(files, ["*"]).paths == ["f", "same"]
    # A path that a file states does not lead to the cache, even if a link does.
    with pytest.raises(PathEscapeError):
        files.join("", "../" * 12 + cache)


@pytest.mark.parametrize(
    "target",
    [
        "blobs",  # a folder
        "blobs/fifo",
        "blobs/out",  # a link in the cache that leads out of it
        "refs/main",
        "snapshots/other/f",
        "blobs2/f",
        "../.dvc/cache",
    ],
)
def test_links_to_anything_else_beside_the_root_are_refused(tmp_path: Path, target: str) -> None:
    hub = tmp_path / "hub"
    for name in ("blobs", "blobs2", "refs", "snapshots/other", "snapshots/own"):
        (hub / name).mkdir(parents=True)
    for name in ("blobs2/f", "refs/main", "snapshots/other/f"):
        (hub / name).write_bytes(b"12345")
    os.mkfifo(hub / "blobs/fifo")
    (hub / "blobs/out").symlink_to(hub / "refs/main")
    (tmp_path / ".dvc/cache").mkdir(parents=True)
    folder = hub / "snapshots/own"
    (folder / "f").symlink_to(f"../../{target}")
    with pytest.raises(PathEscapeError, match="symbolic link"):
        DatasetRoot(folder).read("f", 100)


def test_a_link_whose_content_was_not_downloaded_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "f").symlink_to("../.git/annex/objects/a/b/c")
    with pytest.raises(MissingFileError, match=r"not in the cache.*git annex get"):
        DatasetRoot(folder).read("f", 5)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n", "git lfs pull"),
        ("/annex/objects/SHA256E-s12345--4d7a.json\n", "git annex get"),
    ],
)
def test_a_pointer_to_a_file_that_was_not_downloaded_is_named(root: DatasetRoot, text: str, remedy: str) -> None:
    (root.folder / "f.json").write_text(text)
    with pytest.raises(MissingFileError, match=f"pointer of .*{remedy}") as caught:
        root.read("f.json", 1000)
    assert caught.value.where == str(root.folder / "f.json")
