"""A benchmark as one file: it repeats, unpacks to the same export whatever a user's copies are called, and refuses what
is hostile; boards are ranked and tested.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.evaluation.split import split_tasks
from condvln.export.contents import document_digest
from condvln.export.pack import RECORD, open_pack, packed_files, write_pack
from condvln.export.selection import VERSION
from condvln.export.splits import scene_group
from condvln.samples import make_samples
from condvln.sources.scene_source import SceneChoice
from jobs.benchmark import pack_benchmark, prove_benchmark, read_record, unpack_benchmark
from jobs.configuration import load_config
from jobs.evaluate import walk_split
from jobs.leaderboard import REFERENCES, score_benchmark
from jobs.stages import EpisodeStage, SceneStage, TextStage
from schemas.benchmark import BenchmarkPack
from schemas.errors import CondVLNError, FormatError, MissingFileError, UsageError
from tests.broken_bytes import spoiled
from tests.ending import kill_driver
from tests.once import made_once

FAMILIES = ("mp3d", "procthor", "replicacad")


class Packed(NamedTuple):
    """A pack, and what it was made of; read only."""

    pack: Path
    run: Path
    data: Path

    @property
    def export(self) -> Path:
        return self.run.parent / "export"

    @property
    def roots(self) -> list[Path]:
        """Folders of navmeshes that a dataset ships."""
        return [self.data / "replicacad"]

    def scenes(self, *families: str) -> list[str]:
        return [f"{family}={self.data / family}" for family in families or FAMILIES]


def written(folder: Path, data: Path, **changes: Any) -> Path:
    """The configuration of a run over the datasets below `data`; its store and export are in `folder`."""
    folder.mkdir(exist_ok=True)
    run = {
        "name": "small",
        "store": "store",
        "export": "export",
        "sources": [{"family": family, "root": str(data / family)} for family in FAMILIES],
        "instructions": {"per_category": {"simple": 6}, "counterfactual_groups": 0},
        "splits": {"scenes": {"val_unseen": ["replicacad/*"], "train": ["procthor/*", "mp3d/*"]}, "bias": "off"},
        **changes,
    }
    (folder / "run.yaml").write_text(yaml.safe_dump(run))
    return folder / "run.yaml"


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Packed:
    """A pack of made scenes: a scan whose navmesh had to be built, four houses in one file, two apartments."""

    def make(folder: Path) -> Packed:
        for family, scenes in zip(FAMILIES, (1, 4, 2), strict=True):
            make_samples(folder / "data" / family, family=family, scenes=scenes, seed=5)
        for path in (folder / "data" / "mp3d").rglob("*.navmesh"):
            path.unlink()
        run = written(folder / "run", folder / "data")
        report = pack_benchmark(run, folder / "small.tar.zst", name="small", version="v0-draft", inline=True)
        assert report.exit_code == 0, report.lines
        return Packed(folder / "small.tar.zst", run, folder / "data")

    return made_once(tmp_path_factory, "packed", make)


@pytest.fixture(scope="module")
def unpacked(packed: Packed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export that is unpacked with all scenes; read only."""
    out = tmp_path_factory.mktemp("unpacked") / "out"
    assert unpack_benchmark(packed.pack, out, packed.scenes()).exit_code == 0
    return out


def files_of(export: Path) -> dict[str, bytes]:
    """The files of an export, by path; those that tell of the folder, and the index of the pack, are left out."""
    found = {path.relative_to(export).as_posix(): path.read_bytes() for path in export.rglob("*") if path.is_file()}
    return {name: data for name, data in found.items() if name not in (RECORD, "CHANGELOG.md")}


def test_a_pack_repeats_and_holds_no_scene_and_no_path_of_the_machine(packed: Packed, tmp_path: Path) -> None:
    os.utime(packed.export / "manifest" / "train.jsonl", (1, 1))
    for k in range(2):
        pack_benchmark(packed.export, tmp_path / f"{k}.tar.zst", name="small", version="v0-draft")
        assert (tmp_path / f"{k}.tar.zst").read_bytes() == packed.pack.read_bytes()
    content = pa.CompressedInputStream(pa.OSFile(str(packed.pack)), "zstd").read()
    assert str(packed.data).encode() not in content
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        members = archive.getmembers()
    names = [one.name for one in members]
    assert names[0] == RECORD
    assert not [name for name in names if name.endswith((".glb", ".house", ".gz")) or name.startswith("navmeshes/mp3d")]
    assert {(one.mtime, one.uid, one.gid, one.uname, one.mode) for one in members} == {(0, 0, 0, "", 0o644)}
    files = files_of(packed.export)
    pictures = sum(len(data) for name, data in files.items() if name.startswith("pictures/"))
    assert packed.pack.stat().st_size - pictures < (sum(map(len, files.values())) - pictures) / 3


def test_another_store_and_order_of_the_sources_give_the_same_pack(packed: Packed, tmp_path: Path) -> None:
    sources = [{"family": family, "root": str(packed.data / family)} for family in reversed(FAMILIES)]
    run = written(tmp_path / "again", packed.data, sources=sources)
    pack_benchmark(run, tmp_path / "a.tar.zst", name="small", version="v0-draft", inline=True)
    assert (tmp_path / "a.tar.zst").read_bytes() == packed.pack.read_bytes()


def test_unpacking_gives_the_same_export(packed: Packed, unpacked: Path) -> None:
    assert files_of(unpacked) == files_of(packed.export)
    record = read_record(unpacked)
    assert (record.benchmark, record.version, record.draft) == ("small", "v0-draft", True)
    exported = json.loads((packed.export / "export.json").read_text())
    assert {f"{f}/{scene}" for f, one in record.sources.items() for scene in one.scenes} == {
        scene for scenes in exported["scenes"].values() for scene in scenes
    }
    for one in record.sources.values():
        assert all(places for places in one.scenes.values()), "each scene rests on some files"


def test_texts_and_results_need_no_scenes(packed: Packed, tmp_path: Path) -> None:
    report = unpack_benchmark(packed.pack, tmp_path / "out")
    assert report.exit_code == 0
    assert sum("none looked for" in line for line in report.lines) == len(FAMILIES)
    here, there = files_of(tmp_path / "out"), files_of(packed.export)
    assert here == {name: data for name, data in there.items() if not name.startswith("navmeshes/mp3d/")}
    rows = (tmp_path / "out" / "manifest" / "val_unseen.jsonl").read_text().splitlines()
    results = {str(json.loads(row)["episode_id"]): {"success": 1.0} for row in rows}
    (tmp_path / "mine.json").write_text(json.dumps(results))
    board = score_benchmark(tmp_path / "out", "val_unseen", [tmp_path / "mine.json"], references=False)
    assert board.document["rows"][0]["measures"]["success"]["mean"] == 1.0


def renamed(data: Path, folder: Path) -> list[str]:
    """Copies of the datasets: houses in another order, in two folders; files and folders of the others renamed."""
    houses = gzip.decompress((data / "procthor" / "houses.jsonl.gz").read_bytes()).splitlines()
    for name, lines in (("a", houses[:1:-1]), ("b", houses[:2])):
        part = folder / name
        part.mkdir(parents=True)
        (part / "mine.jsonl").write_bytes(b"\n".join(lines) + b"\n")
        shutil.copy(data / "procthor" / "asset-database.json", part)
    shutil.copytree(data / "mp3d", folder / "scans")
    (scan,) = (path for path in (folder / "scans").iterdir() if path.is_dir() and path.name != "connectivity")
    scan.rename(folder / "scans" / "renamed")
    shutil.copytree(data / "replicacad", folder / "apartments")
    for path in (folder / "apartments" / "configs" / "scenes").iterdir():
        path.rename(path.with_name(f"my_{path.name}"))
    (folder / "more").mkdir()
    (folder / "apartments" / "objects").rename(folder / "more" / "things")
    named = {"procthor": ("a", "b"), "mp3d": ("scans",), "replicacad": ("more", "apartments")}
    return [f"{family}={folder / part}" for family, parts in named.items() for part in parts]


def test_scenes_are_found_by_content(packed: Packed, unpacked: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report = unpack_benchmark(packed.pack, out, renamed(packed.data, tmp_path / "mine"))
    assert report.exit_code == 0, (report.lines, report.sections)
    assert files_of(out) == files_of(packed.export)
    laid_out = json.loads((tmp_path / ".out.data.json").read_text())["data"]
    assert str(tmp_path / ".out.scenes") in laid_out[0]
    for scenes in ([], laid_out):
        proof = prove_benchmark(out, scenes)
        assert proof.exit_code == 0, proof.lines
        assert proof.document["episodes"] == proof.document["proven"] > 0


def test_what_a_link_leads_to_is_not_replaced(packed: Packed, tmp_path: Path) -> None:
    data = shutil.copytree(packed.data, tmp_path / "data")
    (tmp_path / ".out.scenes").symlink_to(data)
    with pytest.raises(UsageError, match="a link is where"):
        unpack_benchmark(packed.pack, tmp_path / "out", renamed(packed.data, tmp_path / "mine"))
    assert sum(1 for _ in data.rglob("*")) == sum(1 for _ in packed.data.rglob("*"))


def test_a_scene_with_another_byte_is_named_and_the_others_are_proven(packed: Packed, tmp_path: Path) -> None:
    data = shutil.copytree(packed.data, tmp_path / "data")
    houses = gzip.decompress((data / "procthor" / "houses.jsonl.gz").read_bytes()).splitlines()
    record = read_record_of(packed)
    bad = sorted(record.sources["procthor"].scenes)[0]
    number = int(bad.rpartition("-")[2])
    houses[number] = houses[number].replace(b":", b": ", 1)
    (data / "procthor" / "houses.jsonl.gz").write_bytes(gzip.compress(b"\n".join(houses) + b"\n"))
    (apartment, *_) = sorted(record.sources["replicacad"].scenes)
    with (data / "replicacad" / "configs" / "scenes" / f"{apartment}.scene_instance.json").open("ab") as file:
        file.write(b" ")
    out, scenes = tmp_path / "out", [f"{family}={data / family}" for family in FAMILIES]
    report = unpack_benchmark(packed.pack, out, scenes)
    assert report.exit_code == 3
    named = {scene: what for section in report.sections for scene, what in section.rows}
    assert named.keys() == {f"procthor/{bad}", f"replicacad/{apartment}"}
    assert all(what.startswith("differs, 1 of ") for what in named.values())
    assert files_of(out) == files_of(packed.export)
    proof = prove_benchmark(out, scenes)
    assert proof.exit_code == 3
    rows = [json.loads(row) for path in (out / "certificates").glob("*.jsonl") for row in path.open()]
    assert {f"{row['source']}/{row['scene_id']}" for row in rows if not row["proven"]} <= named.keys()
    assert all(row["proven"] for row in rows if f"{row['source']}/{row['scene_id']}" not in named)
    assert any(row["proven"] for row in rows)


def read_record_of(packed: Packed) -> Any:
    """The index of a pack."""
    out = packed.pack.parent / "index"
    unpack_benchmark(packed.pack, out)
    return read_record(out)


def test_missing_scenes_are_named(packed: Packed, tmp_path: Path) -> None:
    data = shutil.copytree(packed.data / "replicacad", tmp_path / "data")
    gone = sorted(read_record_of(packed).sources["replicacad"].scenes)[0]
    (data / "configs" / "scenes" / f"{gone}.scene_instance.json").unlink()
    report = unpack_benchmark(packed.pack, tmp_path / "out", [f"replicacad={data}"])
    assert report.exit_code == 3
    assert [(scene, what.partition(",")[0]) for scene, what in report.sections[0].rows] == [
        (f"replicacad/{gone}", "missing")
    ]
    board = score_benchmark(tmp_path / "out", "val_unseen", [], scenes=[f"replicacad={data}"])
    assert {row["agent"] for row in board.document["rows"]} == {*REFERENCES}
    assert any("no row looker" in line for line in board.lines)
    seen = board.document["rows"][0]["measures"]["justified"]["n"]
    assert 0 < seen < board.document["rows"][0]["episodes"], "justified is known where the scene is"
    for text, what in (("hssd=x", "has no scenes of hssd"), ("replicacad=/no", "no such folder"), ("x", "not FAMILY")):
        with pytest.raises(UsageError, match=what):
            unpack_benchmark(packed.pack, tmp_path / "other", [text])
        assert not (tmp_path / "other").exists()


def test_a_pack_is_proven_without_unpacking_it_first(packed: Packed) -> None:
    report = prove_benchmark(packed.pack, packed.scenes())
    assert report.exit_code == 0
    assert report.document["proven"] == sum(read_record_of(packed).episodes.values())


def test_scores_are_those_of_the_original(packed: Packed, unpacked: Path) -> None:
    boards = [
        score_benchmark(export, "val_unseen", [], roots=packed.roots).document for export in (packed.export, unpacked)
    ]
    assert boards[0]["rows"] == boards[1]["rows"]
    success = {row["agent"]: row["measures"]["success"]["mean"] for row in boards[1]["rows"]}
    assert success["oracle"] == success["looking"] == 1.0


def test_a_later_release_scores_and_proves_the_same(
    packed: Packed, unpacked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing but the format of the pack is asked for, neither versions of stages nor the sampler's seed."""
    before = score_benchmark(unpacked, "val_unseen", [], roots=packed.roots).document
    for stage in (SceneStage, EpisodeStage, TextStage):
        monkeypatch.setattr(stage, "version", stage.version + 1)
    monkeypatch.setattr("jobs.pipeline.VERSION", VERSION + 1)
    monkeypatch.setenv("CONDVLN_SEED", "77")
    out = tmp_path / "out"
    assert unpack_benchmark(packed.pack, out, packed.scenes()).exit_code == 0
    assert files_of(out) == files_of(packed.export)
    assert score_benchmark(out, "val_unseen", [], roots=packed.roots).document == before
    assert prove_benchmark(out).exit_code == 0
    assert files_of(out) == files_of(packed.export), "the certificates are the same too"


def test_an_export_with_keys_of_another_release_is_proven_and_scored(
    packed: Packed, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    unpack_benchmark(packed.pack, out, packed.scenes())
    origin = json.loads((out / "origin.json").read_text())
    origin["configuration"] |= {"sampling.former_key": 3, "former_section.key": [1], "places.former.inner": True}
    origin["digest"] = document_digest(origin)
    (out / "origin.json").write_text(json.dumps(origin))
    assert prove_benchmark(out).exit_code == 0
    assert "a key of another release is not read: sampling former_key" in capfd.readouterr().err
    score_benchmark(out, "val_unseen", [], references=False, scenes=packed.scenes("replicacad"))


def test_an_export_that_is_damaged_or_of_other_scenes_is_not_packed(packed: Packed, tmp_path: Path) -> None:
    export = shutil.copytree(packed.export, tmp_path / "export")
    data = shutil.copytree(packed.data, tmp_path / "data")
    scenes = [f"{family}={data / family}" for family in FAMILIES]
    (data / "mp3d").rename(tmp_path / "gone")
    with pytest.raises(UsageError, match="mp3d/"):
        pack_benchmark(export, tmp_path / "a", scenes[1:])
    (tmp_path / "gone").rename(data / "mp3d")
    house = next((data / "mp3d").rglob("*.house"))
    house.write_bytes(house.read_bytes() + b"\n")
    with pytest.raises(UsageError, match="not those that the export was made from"):
        pack_benchmark(export, tmp_path / "a", scenes)
    with (export / "manifest" / "train.jsonl").open("ab") as file:
        file.write(b"\n")
    with pytest.raises(UsageError, match="no whole export is here"):
        pack_benchmark(export, tmp_path / "a", packed.scenes())
    assert not (tmp_path / "a").exists()


def test_an_export_without_certificates_is_proven_first(packed: Packed, tmp_path: Path) -> None:
    export = shutil.copytree(packed.export, tmp_path / "export")
    shutil.rmtree(export / "certificates")
    pack_benchmark(export, tmp_path / "a.tar.zst", packed.scenes(), name="small", version="v0-draft")
    assert (tmp_path / "a.tar.zst").read_bytes() == packed.pack.read_bytes()


def tar_of(*members: tuple[tarfile.TarInfo | str, bytes]) -> bytes:
    """A tar archive in zstd of the given members, by name or header."""
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for member, data in members:
            info = tarfile.TarInfo(member) if isinstance(member, str) else member
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return zstd(made.getvalue())


def zstd(data: bytes) -> bytes:
    return bytes(pa.Codec("zstd").compress(data, asbytes=True))


def header(name: str, size: int) -> bytes:
    info = tarfile.TarInfo(name)
    info.size = size
    return info.tobuf(tarfile.GNU_FORMAT)


def index_of(path: str = "README.md", data: bytes = b"text", **changes: Any) -> bytes:
    """The index of a pack of one file."""
    import hashlib

    file = {"path": path, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()} | changes
    named = {"format": 1, "benchmark": "b", "version": "1", "draft": False, "snapshot_id": "0" * 32, "episodes": {}}
    return json.dumps({**named, "sources": {}, "files": [file]}).encode()


def test_names_of_any_length_and_files_that_are_alike_come_back(tmp_path: Path) -> None:
    long = f"navmeshes/boxes/{'%C3%A9' * 30}.navmesh"
    files = {"a/b.json.gz": gzip.compress(b"{}" * 99), "a/c.json.gz": gzip.compress(b"{}" * 99), long: b"x" * 600}
    for name, data in files.items():
        (tmp_path / "export" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "export" / name).write_bytes(data)
    (tmp_path / "export" / "export.json").write_text(json.dumps({"files": {name: {} for name in files}}))
    index = BenchmarkPack.model_validate_json(index_of())
    index = index.model_copy(update={"files": packed_files(tmp_path / "export", ())})
    write_pack(tmp_path / "a.tar.zst", tmp_path / "export", index)
    (tmp_path / "out").mkdir()
    with open_pack(tmp_path / "a.tar.zst") as pack:
        assert pack.extract(tmp_path / "out") == []
    assert files_of(tmp_path / "out") == files_of(tmp_path / "export")


def link(name: str, target: str) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = tarfile.SYMTYPE, target
    return info


HOSTILE: dict[str, tuple[bytes, str]] = {
    "not zstd": (b"PK\3\4" * 100, "can't be decompressed"),
    "empty": (b"", "ends early"),
    "not a tar": (zstd(b"x" * 5000), "no tar archive"),
    "no index": (tar_of(("README.md", b"text")), "where 'benchmark.json' should be"),
    "an index that is none": (tar_of((RECORD, b"{}")), "its index can't be read"),
    "an index nested too deeply": (tar_of((RECORD, b"[" * 100_000)), "its index can't be read"),
    "a newer format": (tar_of((RECORD, index_of().replace(b'"format": 1', b'"format": 2'))), "format"),
    "a path that climbs": (tar_of((RECORD, index_of("../evil")), ("../evil", b"text")), "not a plain path"),
    "an absolute path": (tar_of((RECORD, index_of("/tmp/evil")), ("/tmp/evil", b"text")), "not a plain path"),
    "a member that climbs": (tar_of((RECORD, index_of()), ("../evil", b"text")), "where 'README.md' should be"),
    "a symbolic link": (tar_of((RECORD, index_of()), (link("README.md", "/etc/passwd"), b"")), "where 'README.md'"),
    "another content": (tar_of((RECORD, index_of()), ("README.md", b"tent")), "differs from its hash"),
    "another size": (tar_of((RECORD, index_of()), ("README.md", b"t")), "another size"),
    "a larger member": (tar_of((RECORD, index_of()), ("README.md", b"text" * 9)), "of at most 4"),
    "a huge index": (zstd(header(RECORD, 1 << 40)), "is said to have 1,099,511,627,776 bytes"),
    "a huge file": (tar_of((RECORD, index_of(bytes=1 << 50))), "more than"),
    "a huge content": (tar_of((RECORD, index_of("a.gz", level=2, content=[1 << 50, "0" * 64]))), "more than"),
    "a missing member": (tar_of((RECORD, index_of())), "no tar archive"),
    "a scene without its input": (
        tar_of(
            (
                RECORD,
                index_of().replace(
                    b'"sources": {}', b'"sources": {"mp3d": {"inputs": [], "shared": [], "scenes": {"a": [1]}}}'
                ),
            )
        ),
        "rests on an input that is not listed",
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_pack_is_one_clean_error(kind: str, tmp_path: Path) -> None:
    data, what = HOSTILE[kind]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.tar.zst").write_bytes(data)
    with pytest.raises(FormatError, match=what) as found:
        unpack_benchmark(tmp_path / "in" / "bad.tar.zst", tmp_path / "out")
    assert "\n" not in str(found.value)
    assert "bad.tar.zst" in str(found.value)
    assert [path.name for path in tmp_path.iterdir()] == ["in"], "nothing is left"


@given(data=st.data())
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_spoiled_index_gives_an_export_or_one_clean_error(
    packed: Packed, tmp_path: Path, data: st.DataObject
) -> None:
    content = pa.CompressedInputStream(pa.OSFile(str(packed.pack)), "zstd").read()
    size = tarfile.TarInfo.frombuf(content[:512], "utf-8", "strict").size
    index = spoiled(json.loads(content[512 : 512 + size]), data)
    folder = tmp_path / "spoiled"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    text = json.dumps(index).encode()
    rest = content[512 + size + -size % 512 :]
    (folder / "bad").write_bytes(zstd(header(RECORD, len(text)) + text + bytes(-len(text) % 512) + rest))
    said = ""
    try:
        unpack_benchmark(folder / "bad", folder / "out", packed.scenes())
    except CondVLNError as error:
        said = str(error)
    assert "\n" not in said
    assert (folder / "out").exists() == (not said)
    assert {path.name for path in tmp_path.iterdir()} == {"spoiled"}


def test_a_truncated_pack_is_an_error_wherever_it_ends(packed: Packed, tmp_path: Path) -> None:
    whole = packed.pack.read_bytes()
    out = tmp_path / "out"
    for share in (0.001, 0.01, 0.3, 0.9, 0.999):
        (tmp_path / "cut.tar.zst").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FormatError, match="not a sound pack"):
            unpack_benchmark(tmp_path / "cut.tar.zst", out)
        assert not out.exists()
    with pytest.raises(MissingFileError):
        unpack_benchmark(tmp_path / "none.tar.zst", out)


def test_a_broken_pack_leaves_the_export_in_place(packed: Packed, unpacked: Path, tmp_path: Path) -> None:
    out = shutil.copytree(unpacked, tmp_path / "out")
    bad = bytearray(packed.pack.read_bytes())
    bad[len(bad) // 2] ^= 255
    (tmp_path / "bad.tar.zst").write_bytes(bad)
    with pytest.raises(FormatError):
        unpack_benchmark(tmp_path / "bad.tar.zst", out)
    assert files_of(out) == files_of(unpacked)


def test_another_zlib_gives_the_same_content(packed: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import zlib

    real: Callable[..., Any] = zlib.compressobj
    monkeypatch.setattr("condvln.formats.streams.zlib.compressobj", lambda level, *rest: real(9, *rest))
    out = tmp_path / "out"
    report = unpack_benchmark(packed.pack, out, packed.scenes())
    assert any("compressed by another zlib" in line for line in report.lines)
    monkeypatch.undo()
    name = "vlnce/train/train.json.gz"
    here, there = (gzip.decompress((folder / name).read_bytes()) for folder in (out, packed.export))
    assert here == there
    assert (out / name).read_bytes() != (packed.export / name).read_bytes()
    assert prove_benchmark(out).exit_code == 0, "the export's list has the hashes of its files"


def test_a_board_ranks_references_and_submissions(packed: Packed, unpacked: Path, tmp_path: Path) -> None:
    export = unpacked
    walk_split(export, "val_unseen", "coin-flip", tmp_path / "mine.json", packed.roots, seed=2)
    mine = [tmp_path / "mine.json"]
    report = score_benchmark(export, "val_unseen", mine, out=tmp_path / "board.json", roots=packed.roots)
    board = json.loads((tmp_path / "board.json").read_text())
    assert board == report.document
    rows = board["rows"]
    assert {row["agent"] for row in rows} == {*REFERENCES, "mine"}
    assert rows[0]["agent"] == "oracle"
    success = [row["measures"]["success"]["mean"] for row in rows]
    assert success == sorted(success, reverse=True)
    assert success[0] == 1.0
    assert rows[0]["against_above"] is None
    for above, row in pairwise(rows):
        against = row["against_above"]
        assert against["above"] == above["agent"]
        assert against["difference"] == pytest.approx(
            row["measures"]["success"]["mean"] - above["measures"]["success"]["mean"], abs=2e-6
        )
        assert 0 < against["p_value"] <= 1
    (mine,) = [row for row in rows if row["agent"] == "mine"]
    assert (mine["kind"], mine["missing"]) == ("submission", 0)
    assert len(mine["predictions_sha256"]) == 64
    assert board["draft"]
    assert any("no row looker" in line for line in report.lines)
    assert any("this version is a draft" in line for line in report.lines)


def test_results_by_episode_need_no_navmesh_without_references(unpacked: Path, tmp_path: Path) -> None:
    """What such results don't have is undefined, and nothing is said about agents that nobody asked for."""
    export = unpacked
    lines = (export / "manifest" / "val_unseen.jsonl").read_text().splitlines()
    ids = [str(json.loads(line)["episode_id"]) for line in lines]
    results = {name: {"success": float(k % 2), "spl": 0.5} for k, name in enumerate(ids)}
    (tmp_path / "theirs.json").write_text(json.dumps(results))
    report = score_benchmark(export, "val_unseen", [tmp_path / "theirs.json"], references=False)
    assert f"split val_unseen, {len(ids)} episodes, snapshot " in report.lines[0]
    assert not any("looker" in line for line in report.lines)
    (row,) = report.document["rows"]
    assert row["measures"]["success"]["mean"] == pytest.approx((len(ids) // 2) / len(ids), abs=1e-6)
    assert row["notes"] == [f"spl was set to 0, as a failure has it, in {-(-len(ids) // 2)} of {len(ids)} results"]
    assert any(row["notes"][0] in line for line in report.lines)
    for name in ("spl_route", "csr_all", "bsa_all", "leaf_correct", "ndtw"):
        assert row["measures"][name]["mean"] is None


def test_a_board_needs_the_export_of_its_record(unpacked: Path, tmp_path: Path) -> None:
    export = shutil.copytree(unpacked, tmp_path / "export")
    index = json.loads((export / "export.json").read_text())
    (export / "export.json").write_text(json.dumps({**index, "snapshot": "0" * 32}))
    with pytest.raises(UsageError, match="another than the one that was unpacked"):
        score_benchmark(export, "val_unseen", [], references=False)


@pytest.mark.parametrize("kind", ["gap", "off the navmesh"])
def test_a_board_refuses_walks_that_no_agent_can_have_made(
    packed: Packed, unpacked: Path, tmp_path: Path, kind: str
) -> None:
    export = unpacked
    walk_split(export, "val_unseen", "oracle", tmp_path / "mine.json", packed.roots, seed=0)
    walks = json.loads((tmp_path / "mine.json").read_text())
    poses = next(iter(walks.values()))
    if kind == "gap":
        poses[1:-1] = []
    else:
        for pose in poses[1:]:
            pose["position"][1] += 0.6
    (tmp_path / "mine.json").write_text(json.dumps(walks))
    with pytest.raises(FormatError, match=r"1 of .*no single action can make.*--forward-step"):
        score_benchmark(export, "val_unseen", [tmp_path / "mine.json"], references=False, roots=packed.roots)
    short = dict(list(json.loads((tmp_path / "mine.json").read_text()).items())[1:])
    (tmp_path / "mine.json").write_text(json.dumps(short))
    board = score_benchmark(export, "val_unseen", [tmp_path / "mine.json"], references=False, roots=packed.roots)
    assert board.document["rows"][0]["missing"] == 1


def test_a_submission_may_not_be_called_looker(packed: Packed, unpacked: Path, tmp_path: Path) -> None:
    export = unpacked
    walk_split(export, "val_unseen", "stop-at-start", tmp_path / "looker.json", packed.roots, seed=0)
    with pytest.raises(UsageError, match="'looker' is the name of a reference agent"):
        score_benchmark(export, "val_unseen", [tmp_path / "looker.json"], references=False, roots=packed.roots)


@pytest.mark.soak
def test_a_board_with_scenes_has_a_row_of_looker(tmp_path: Path) -> None:
    """Its row is the score of its own walks. It takes the right branch more often than guessers do, or luck allows."""
    data = tmp_path / "data"
    make_samples(data, family="replicacad", scenes=4, seed=5)
    run = {"sources": [{"family": "replicacad", "root": str(data)}]}
    pack_benchmark(written(tmp_path / "run", data, **run), tmp_path / "a.tar.zst", inline=True)
    export, scenes = tmp_path / "export", [f"replicacad={data}"]
    unpack_benchmark(tmp_path / "a.tar.zst", export, scenes)
    report = score_benchmark(export, "val_unseen", [], scenes=scenes)
    rows = {row["agent"]: row for row in report.document["rows"]}
    assert rows.keys() == {*REFERENCES, "looker"}
    assert not any("no row looker" in line for line in report.lines)

    walk_split(export, "val_unseen", "looker", tmp_path / "again.json", [], seed=0, datasets=scenes)
    (again,) = score_benchmark(
        export, "val_unseen", [tmp_path / "again.json"], references=False, roots=[data]
    ).document["rows"]
    assert (rows["looker"]["kind"], rows["looker"]["predictions_sha256"]) == ("reference", None)
    # Without the scenes it is unknown what was recognised.
    assert again["measures"].pop("justified")["n"] == 0 < rows["looker"]["measures"].pop("justified")["n"]
    for key in ("episodes", "missing", "measures"):
        assert rows["looker"][key] == again[key]

    right = {name: row["measures"]["leaf_correct"]["mean"] for name, row in rows.items()}
    assert right["looker"] > max(right[name] for name in REFERENCES if name not in ("oracle", "looking"))
    # How often an agent that draws a leaf at random would be right as often, over all its draws.
    leaves = [task.n_leaves for task in split_tasks(export, "val_unseen")]
    assert len(leaves) == rows["looker"]["episodes"] >= 24
    odds = np.ones(1)
    for count in leaves:
        odds = np.convolve(odds, [1 - 1 / count, 1 / count])
    assert odds[round(right["looker"] * len(leaves)) :].sum() < 1e-4
    assert right["looker"] >= 0.9


def test_of_procthor_10k_a_run_of_all_families_takes_some_houses_of_each_official_split(
    pytestconfig: pytest.Config,
) -> None:
    config = load_config(pytestconfig.rootpath / "configs" / "all-families.yaml", check_roots=False)
    (source,) = [one for one in config.sources if one.family == "procthor"]
    choice = SceneChoice(source.scenes, source.exclude)
    taken: Counter[tuple[str, str]] = Counter()
    for file, houses in (("train", 10_000), ("val", 1_000), ("test", 1_000)):
        for name in (f"{file}-{k}" for k in range(houses)):
            if choice.wanted(name):
                taken[file, scene_group("procthor", name, config.splits)] += 1
    assert taken == {("train", "train"): 100, ("val", "val_unseen"): 30, ("test", "test"): 30}


@pytest.mark.ray
@pytest.mark.soak
def test_one_and_two_workers_and_a_killed_run_give_one_pack(packed: Packed, tmp_path: Path) -> None:
    packs = [packed.pack.read_bytes()]
    named = {"name": "small", "version": "v0-draft"}
    for workers in (1, 2):
        run = written(tmp_path / f"workers-{workers}", packed.data, ray={"workers": workers})
        assert pack_benchmark(run, tmp_path / f"{workers}.tar.zst", **named).exit_code == 0
        packs.append((tmp_path / f"{workers}.tar.zst").read_bytes())
    run, out = written(tmp_path / "killed", packed.data), tmp_path / "killed.tar.zst"
    code = "from jobs.command import main; main()"
    command = [sys.executable, "-c", code, "benchmark", "pack", str(run), "--out", str(out), "--inline"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as driver:
        deadline = time.monotonic() + 120
        while not [*tmp_path.glob("killed/store/units/scene/*/*/unit.json")] and time.monotonic() < deadline:
            time.sleep(0.005)
        kill_driver(driver)
    assert not out.exists()
    assert pack_benchmark(run, out, inline=True, **named).exit_code == 0
    packs.append(out.read_bytes())
    assert len(set(packs)) == 1
