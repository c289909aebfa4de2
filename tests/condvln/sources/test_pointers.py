"""A dataset whose files were not downloaded: what is said, and how often."""

from __future__ import annotations

from pathlib import Path

import pytest

from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.sources.source import hash_file
from schemas.errors import ConfigError, PointerError

LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
ANNEX = "/annex/objects/SHA256E-s12345--4d7a.json\n"


def hashed_elsewhere(path: Path) -> tuple[int, str]:
    """As a cache of hashes, which doesn't look into the file."""
    return path.stat().st_size, "0" * 64


FILES = {
    "replicacad": "**/*.glb",
    "hssd": "**/*.scene_instance.json",
    "hm3d": "**/*.semantic.txt",
    "ithor": "*.json",
    "mp3d": "**/*.house",
    "gibson": "*/*",
}


@pytest.mark.parametrize("family", FILES)
@pytest.mark.parametrize(("pointer", "command"), [(LFS, "git lfs pull"), (ANNEX, "git annex get")])
def test_a_source_of_pointers_is_one_message(tmp_path: Path, family: str, pointer: str, command: str) -> None:
    make_samples(tmp_path, family=family, scenes=3, seed=1)
    files = [path for path in tmp_path.glob(FILES[family]) if path.is_file()]
    assert files
    for path in files:
        path.write_text(pointer)
    with pytest.raises(ConfigError, match=r"not downloaded, such as .*: this is a pointer of") as caught:
        open_source(family, tmp_path, hash_file=hashed_elsewhere).handles()
    assert command in caught.value.remedy


def test_some_pointers_are_one_fault_with_their_count(tmp_path: Path) -> None:
    make_samples(tmp_path, family="ithor", scenes=4, seed=1)
    pointers = sorted(tmp_path.glob("*.json"))[1:]
    for path in pointers:
        path.write_text(LFS)
    handles = open_source("ithor", tmp_path, hash_file=hash_file).handles()
    faults = [handle.fault for handle in handles if handle.fault is not None]
    assert [handle.scene_id for handle in handles if handle.fault is not None] == [path.stem for path in pointers]
    assert all(isinstance(fault, PointerError) for fault in faults)
    assert len({str(fault) for fault in faults}) == 1
    assert f"files of {len(pointers)} of {len(handles)} scenes were not downloaded, such as {pointers[0]}" in str(
        faults[0]
    )
