"""Listing a dataset: every scene once, whatever links are in its folder, and what is left out is said."""

from __future__ import annotations

import gzip
import hashlib
import os
from pathlib import Path

import pytest

from condvln.formats.dataset_root import DatasetRoot, list_files
from condvln.samples import FAMILIES, make_samples
from condvln.scene.tables import scene_tables
from condvln.sources.registry import open_source
from condvln.sources.scene_source import Source
from schemas.errors import CondVLNError, ConfigError, MissingFileError, PathEscapeError


def names(source: Source) -> list[str]:
    return [handle.scene_id for handle in source.handles()]


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_links_into_the_dataset_double_no_scene(tmp_path: Path, family: str) -> None:
    root = tmp_path / "data"
    make_samples(root, family=family, scenes=2, seed=1)
    before = names(open_source(family, root))
    (root / "again").symlink_to(".")
    folders = [path for path in sorted(root.iterdir()) if path.is_dir() and not path.is_symlink()]
    for folder in folders:
        (folder / "up").symlink_to("..")
        (root / f"{folder.name}_2").symlink_to(folder.name)
    (root / "self").symlink_to("self")
    source = open_source(family, root)
    assert names(source) == before
    assert all(handle.fault is None for handle in source.handles())
    source.read(before[0])


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_a_download_whose_content_is_in_a_cache_is_the_same_dataset(tmp_path: Path, family: str) -> None:
    """As the Hugging Face Hub keeps it; equal files are one blob."""
    plain, root = tmp_path / "plain", tmp_path / "hub/datasets--a--b/snapshots/0f3c"
    make_samples(plain, family=family, scenes=2, seed=1)
    blobs = root.parents[1] / "blobs"
    blobs.mkdir(parents=True)
    for file in sorted(path for path in plain.rglob("*") if path.is_file()):
        link = root / file.relative_to(plain)
        link.parent.mkdir(parents=True, exist_ok=True)
        blob = blobs / hashlib.sha256(file.read_bytes()).hexdigest()
        blob.write_bytes(file.read_bytes())
        link.symlink_to(os.path.relpath(blob, link.parent))
    linked, expected = open_source(family, root).handles(), open_source(family, plain).handles()
    assert [(h.scene_id, h.inputs, h.fault) for h in linked] == [(h.scene_id, h.inputs, h.fault) for h in expected]
    scene, other = (open_source(family, folder).read(expected[0].scene_id) for folder in (root, plain))
    assert scene_tables(scene)["objects"].equals(scene_tables(other)["objects"])
    # Content that was not downloaded is named, and costs only the scenes that need it.
    for blob in blobs.iterdir():
        blob.unlink()
    try:
        faults = [handle.fault for handle in open_source(family, root).handles()]
    except CondVLNError as error:
        faults = [error]
    assert all("not in the cache" in str(fault) for fault in faults)


def test_each_real_file_once_and_its_other_names_are_said(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "x.json").write_text("1")
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "y.json").symlink_to("b/x.json")
    (tmp_path / "loop").symlink_to(".")
    listing = list_files(DatasetRoot(tmp_path), ["*.json", "*/*.json", "*/*/*.json"])
    assert listing.paths == ["b/x.json"]
    assert set(listing.passed_over) == {"a", "loop", "y.json"}
    assert "a symbolic link to 'b'" in listing.passed_over["a"]
    assert not listing.faults


def test_a_link_whose_file_is_listed_nowhere_else_is_kept(tmp_path: Path) -> None:
    deep = tmp_path / "one" / "two" / "three"
    deep.mkdir(parents=True)
    (deep / "x.json").write_text("1")
    (tmp_path / "x.json").symlink_to("one/two/three/x.json")
    assert list_files(DatasetRoot(tmp_path), ["*.json", "*/*.json"]).paths == ["x.json"]


def test_a_folder_outside_of_the_root_is_one_fault(tmp_path: Path) -> None:
    root, outside = tmp_path / "data", tmp_path / "outside"
    make_samples(root, family="ithor", scenes=2, seed=1)
    make_samples(outside, family="ithor", scenes=3, seed=2)
    before = names(open_source("ithor", root))
    (root / "more").symlink_to(outside)
    source = open_source("ithor", root)
    faults = {handle.scene_id: handle.fault for handle in source.handles() if handle.fault is not None}
    assert list(faults) == ["more"]
    assert isinstance(faults["more"], PathEscapeError)
    assert names(source) == sorted([*before, "more"])
    left_out = open_source("ithor", root, exclude=["more"])
    assert names(left_out) == before
    assert [path for path, _ in left_out.passed_over()] == ["more"]
    assert names(open_source("ithor", root, scenes=before[:1])) == before[:1]


def test_a_folder_that_cannot_be_listed_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "closed").mkdir()
    scandir = os.scandir

    def refusing(path: Path) -> object:
        if Path(path).name == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    closed = "closed"
    listing = list_files(DatasetRoot(tmp_path), ["*/*.json"])
    assert isinstance(listing.faults["closed"], MissingFileError)
    assert "can't be listed (Permission denied)" in str(listing.faults["closed"])
    closed = tmp_path.name
    with pytest.raises(ConfigError, match=r"the folder can't be listed \(Permission denied\)"):
        list_files(DatasetRoot(tmp_path), ["*/*.json"])


def test_a_stray_file_of_lines_is_one_finding(tmp_path: Path) -> None:
    make_samples(tmp_path, family="procthor", scenes=2, seed=1)
    before = names(open_source("procthor", tmp_path))
    (tmp_path / "log.jsonl").write_text('{"a": 1}\n\n' * 3000)
    source = open_source("procthor", tmp_path)
    assert names(source) == before
    assert ("log.jsonl", "none of its 3000 lines is a house") in source.passed_over()
    (tmp_path / "broken.jsonl").write_text("<html>\n" * 3000)
    faults = [handle for handle in source.handles() if handle.fault is not None]
    assert [handle.scene_id for handle in faults] == ["broken"]
    assert "broken.jsonl#0" in str(faults[0].fault)


def test_broken_lines_before_a_house_stay_their_own_faults(tmp_path: Path) -> None:
    make_samples(tmp_path, family="procthor", scenes=2, seed=1)
    (file,) = (path for path in tmp_path.iterdir() if ".jsonl" in path.name)
    file.write_bytes(gzip.compress(b"{\n" + gzip.decompress(file.read_bytes())))
    handles = open_source("procthor", tmp_path).handles()
    assert [handle.scene_id.rsplit("-", 1)[1] for handle in handles if handle.fault is not None] == ["0"]


def test_a_pattern_that_fits_nothing_is_one_fault(tmp_path: Path) -> None:
    make_samples(tmp_path, family="ithor", scenes=2, seed=1)
    source = open_source("ithor", tmp_path, scenes=["*", "Flor*"], exclude=["Nothing*"])
    (lost,) = (handle for handle in source.handles() if handle.fault is not None)
    assert lost.scene_id == "Flor*"
    assert "no scene of the dataset fits the pattern 'Flor*'" in str(lost.fault)
    assert source.passed_over() == [("exclude: Nothing*", "no scene fits it")]
