"""Hostile files of every family in one run: each costs its own scene and is named; all others are published."""

from __future__ import annotations

import gzip
import io
import json
import os
import pickle
import shutil
import socket
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from condvln.samples import make_samples
from condvln.sources.registry import open_source
from jobs.generate import run_generate
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SourceConfig

DEEP = b"[" * 10_000 + b"]" * 10_000
TEN_GIGABYTES = 10 << 30

# Spoils the files of one scene, a copy of the sound one; gives words that the message must have.
Spoil = Callable[[Path, Path], str]


class Touch:
    """Unpickled by the plain unpickler, it would make the file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


def deep(path: Path, root: Path) -> str:
    path.write_bytes(
        b'{"sceneName": "x", "axisAlignedBoundingBox": 1, "rooms": 1, "walls": 1, "objects": ' + DEEP + b"}"
    )
    return "nested more than 64 levels deep"


def deep_line(path: Path, root: Path) -> str:
    """Before a line that is sound."""
    path.write_bytes(b'{"objects": ' + DEEP + b"}\n" + path.read_bytes())
    return "lines.jsonl#0: the document is nested more than 64 levels deep"


def leaving(path: Path, root: Path) -> str:
    """The file itself is a link to one outside, by way of ``..``."""
    outside = root.parent / f"outside-{path.name}"
    shutil.move(path, outside)
    path.symlink_to(Path(os.path.relpath(root.parent, path.parent)) / outside.name)
    return "leads out of the dataset"


def cut(path: Path, root: Path) -> str:
    path.write_bytes(path.read_bytes()[:-100])
    return path.name


def far(path: Path, root: Path) -> str:
    """The first object is ten thousand million metres away."""
    document = json.loads(path.read_bytes())
    document["objects"][0]["axisAlignedBoundingBox"]["center"]["x"] = 1e10
    path.write_bytes(json.dumps(document).encode())
    return "objects[0].axisAlignedBoundingBox.center.x: the number 10000000000.0 is beyond"


def far_house(path: Path, root: Path) -> str:
    document = json.loads(path.read_bytes())
    document["objects"][0]["position"]["y"] = -1e10
    path.write_bytes(json.dumps(document).encode())
    return "objects[0].position.y: the number -10000000000.0 is beyond"


def far_building(path: Path, root: Path) -> str:
    document = json.loads(path.read_bytes())
    document["objects"][0]["size"][2] = 1e10
    path.write_bytes(json.dumps(document).encode())
    return "objects[0].size[2]: the number 10000000000.0 is beyond"


def bomb(path: Path, root: Path) -> str:
    """300 MB of blanks in 300 kB."""
    path.write_bytes(gzip.compress(b" " * (300 << 20), compresslevel=1))
    return "longer than 16777216 bytes"


def npz(array: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("output.npy", array)
    return buffer.getvalue()


def npy(data: bytes) -> bytes:
    """A numpy file of one pickled object."""
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (), }"
    header = header.ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def executing(path: Path, root: Path) -> str:
    path.write_bytes(npz(npy(pickle.dumps(np.array(Touch(root / "executed"), dtype=object)))))
    return "output.npy: the pickle is not accepted"


def zip_bomb(path: Path, root: Path) -> str:
    path.write_bytes(npz(bytes(300 << 20)))
    return "decompresses to more than 268435456 bytes"


def claiming_pickle(path: Path, root: Path) -> str:
    path.write_bytes(npz(npy(b"\x80\x04\x8e" + struct.pack("<Q", TEN_GIGABYTES) + b"abc.")))
    return "output.npy: the pickle is not accepted"


def claiming_array(path: Path, root: Path) -> str:
    array = npy(b"")
    path.write_bytes(npz(array[:6] + b"\x02\x00" + struct.pack("<I", 0xFFFF_FFFF) + array[10:]))
    return "output.npy: the array's header claims 4294967295 bytes"


def claiming_house(path: Path, root: Path) -> str:
    lines = path.read_text().split("\n")
    words = lines[1].split()
    words[8] = str(TEN_GIGABYTES)
    path.write_text("\n".join([lines[0], " ".join(words), *lines[2:]]))
    return f"the record H claims {TEN_GIGABYTES} records O"


def wrong_word(path: Path, root: Path) -> str:
    lines = path.read_text().split("\n")
    number = next(k for k, line in enumerate(lines) if line.startswith("O "))
    lines[number] = lines[number].replace(lines[number].split()[4], "here", 1)
    path.write_text("\n".join(lines))
    return f"line {number + 1}: word 4 is 'here'"


def climbing_glb(path: Path, root: Path) -> str:
    return leaving(path.parent.parent / f"{path.stem}.glb", root)


def claiming_navmesh(path: Path, root: Path) -> str:
    """2³¹ − 1 polygons in a file of 10 kB."""
    (navmesh,) = (p for p in root.rglob(f"{path.name.split('.')[0].removeprefix('3DSceneGraph_')}.navmesh"))
    data = bytearray(navmesh.read_bytes())
    at = data.index(struct.pack("<i", 0x444E4156)) + 24
    data[at : at + 4] = struct.pack("<i", 2**31 - 1)
    navmesh.write_bytes(bytes(data))
    return navmesh.name


def fifo(path: Path, root: Path) -> str:
    """Opening it waits for a writer that never comes."""
    path.unlink()
    os.mkfifo(path)
    return "it is a FIFO, not a file"


def unix_socket(path: Path, root: Path) -> str:
    path.unlink()
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))  # a socket's whole path may be too long
    return "it is a socket, not a file"


def endless(path: Path, root: Path) -> str:
    path.unlink()
    path.symlink_to("/dev/zero")
    return "leads out of the dataset"


def own_target(path: Path, root: Path) -> str:
    path.unlink()
    path.symlink_to(path.name)
    return "Too many levels of symbolic links"


def fifo_mesh(path: Path, root: Path) -> str:
    """The mesh of a building that is sound otherwise."""
    (mesh,) = (p for p in root.rglob(f"{path.name.split('.')[0]}.glb"))
    return fifo(mesh, root)


def socket_navmesh(path: Path, root: Path) -> str:
    (navmesh,) = (p for p in root.rglob(f"{path.name.split('.')[0]}.navmesh"))
    return unix_socket(navmesh, root)


def nameless(path: Path, root: Path) -> str:
    """The name begins with a byte that UTF-8 does not have."""
    path.rename(os.fsdecode(os.fsencode(path.parent) + b"/\xff" + os.fsencode(path.name)))
    return "the name is not UTF-8 text"


CASES: dict[str, dict[str, tuple[str, Spoil]]] = {
    "procthor": {
        "deep.json": ("deep", deep),
        "far.json": ("far", far_house),
        "cut.json": ("cut", cut),
        "link.json": ("link", leaving),
        "bomb.jsonl.gz": ("bomb", bomb),
        "lines.jsonl": ("lines-0", deep_line),
        "fifo.json": ("fifo", fifo),
        "fifo-lines.jsonl": ("fifo-lines", fifo),
        "socket.json": ("socket", unix_socket),
        "zero.json": ("zero", endless),
        "itself.json": ("itself", own_target),
        "latin.json": (r"\xfflatin.json", nameless),
    },
    "ithor": {
        "FloorPlan2.json": ("FloorPlan2", deep),
        "FloorPlan3.json": ("FloorPlan3", far),
        "FloorPlan4.json": ("FloorPlan4", cut),
        "FloorPlan5.json": ("FloorPlan5", fifo),
    },
    "robothor": {
        "FloorPlan_Val1_1.json": ("FloorPlan_Val1_1", deep),
        "FloorPlan_Val1_2.json": ("FloorPlan_Val1_2", far),
        "FloorPlan_Val1_3.json": ("FloorPlan_Val1_3", cut),
        "FloorPlan_Val1_4.json": ("FloorPlan_Val1_4", unix_socket),
    },
    "mp3d": {
        "claim/house_segmentations/claim.house": ("claim", claiming_house),
        "word/house_segmentations/word.house": ("word", wrong_word),
        "cut/house_segmentations/cut.house": ("cut", cut),
        "link/house_segmentations/link.house": ("link", leaving),
        "mesh/house_segmentations/mesh.house": ("mesh", climbing_glb),
        "polygons/house_segmentations/polygons.house": ("polygons", claiming_navmesh),
        "fifo/house_segmentations/fifo.house": ("fifo", fifo),
        "glb/house_segmentations/glb.house": ("glb", fifo_mesh),
        "walk/house_segmentations/walk.house": ("walk", socket_navmesh),
        "zero/house_segmentations/zero.house": ("zero", endless),
        "latin/house_segmentations/latin.house": (r"latin/house_segmentations/\xfflatin.house", nameless),
    },
    "gibson": {
        "verified/deep.scn": ("verified/deep", deep),
        "verified/far.scn": ("verified/far", far_building),
        "verified/link.scn": ("verified/link", leaving),
        "verified/polygons.scn": ("verified/polygons", claiming_navmesh),
        "verified/fifo.scn": ("verified/fifo", fifo),
        "verified/latin.scn": (r"verified/\xfflatin.scn", nameless),
        "verified/3DSceneGraph_code.npz": ("verified/code", executing),
        "verified/3DSceneGraph_bomb.npz": ("verified/bomb", zip_bomb),
        "verified/3DSceneGraph_pickle.npz": ("verified/pickle", claiming_pickle),
        "verified/3DSceneGraph_array.npz": ("verified/array", claiming_array),
    },
}
"""By family: the file of a scene that is a copy of a sound one, the scene's id, and what is done to it."""


def sound(family: str, root: Path) -> set[str]:
    """One sound scene; of ProcTHOR two in one file, and one behind a broken line. All else that was made is removed."""
    make_samples(root, family, 2, 3)
    if family == "procthor":
        return {"houses-0", "houses-1", "lines-1"}
    if family in ("ithor", "robothor"):
        first = sorted(root.glob("*.json"))[0]
        for path in set(root.iterdir()) - {first}:
            path.unlink()
        return {first.stem}
    for path in root.rglob("*made_001*"):
        if path.is_file():
            path.unlink()
    return {"verified/made_000" if family == "gibson" else "made_000"}


def copied(family: str, root: Path, path: str) -> Path:
    """The files of a scene of its own, the same as the sound one's."""
    target = root / path
    target.parent.mkdir(parents=True, exist_ok=True)
    name = target.name.split(".")[0].removeprefix("3DSceneGraph_")
    if family == "procthor":
        lines = gzip.decompress((root / "houses.jsonl.gz").read_bytes())
        target.write_bytes(gzip.compress(lines) if path.endswith(".gz") else lines.split(b"\n")[0])
    elif family in ("ithor", "robothor"):
        shutil.copy(sorted(root.glob("*.json"))[0], target)
    elif family == "mp3d":
        shutil.copy(root / "made_000/house_segmentations/made_000.house", target)
        for suffix in (".glb", ".navmesh"):
            shutil.copy(root / f"made_000/made_000{suffix}", root / name / f"{name}{suffix}")
    else:
        shutil.copy(root / "verified/made_000.scn", target)
        for suffix in (".glb", ".navmesh"):
            shutil.copy(root / f"made_000{suffix}", root / f"{name}{suffix}")
    return target


@pytest.mark.parametrize("family", sorted(CASES))
def test_hostile_files_cost_their_own_scenes_only(family: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    root = tmp_path / "data"
    whole = sound(family, root)
    expected = {}
    for path, (scene_id, spoil) in CASES[family].items():
        file = copied(family, root, path)
        expected[f"{family}/{scene_id}"] = (file.name.split(".")[0], spoil(file, root))
    config = Config(
        name=family,
        store=tmp_path / "store",
        sources=(SourceConfig(family=family, root=root),),  # type: ignore[arg-type]
        instructions=InstructionsConfig(per_category={"simple": 1}),
    )
    config = config.model_copy(update={"ray": config.ray.model_copy(update={"max_failures": 1.0})})
    report = run_generate(config, inline=True, console=Console(file=io.StringIO()))
    found = {entry["unit"]: entry["message"] for entry in report.document["quarantined"]}
    assert set(found) == set(expected), found
    assert report.exit_code == 3
    for unit, (name, words) in expected.items():
        assert name in found[unit]
        assert words in found[unit]
        assert ". " in found[unit], "a remedy follows the fault"
    assert {row["scene_id"] for row in published(config).table("scenes").to_pylist()} == whole
    assert published(config).table("episodes").num_rows > 0
    assert not (root / "executed").exists()


def test_the_only_file_of_a_dataset_is_named_where_its_name_is_not_utf_8(tmp_path: Path) -> None:
    make_samples(tmp_path, "procthor", 1, 3)
    nameless(tmp_path / "houses.jsonl.gz", tmp_path)
    faults = {handle.scene_id: str(handle.fault) for handle in open_source("procthor", tmp_path).handles()}
    assert r"\xffhouses.jsonl.gz: the name is not UTF-8 text" in faults[r"\xffhouses.jsonl.gz"]
