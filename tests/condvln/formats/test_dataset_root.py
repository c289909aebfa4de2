"""No path found in a file leads out of the dataset."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats.dataset_root import DatasetRoot
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
