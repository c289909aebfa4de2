"""Hostile files of every family in one run: each costs its own scene and is named; all others are published."""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from condvln.samples import make_samples
from condvln.sources.registry import open_source
from jobs.generate import run_generate
from jobs.workspace import published
from schemas.config import Config, InstructionsConfig, SamplingConfig, SourceConfig

DEEP = b"[" * 10_000 + b"]" * 10_000

# Spoils the files of one scene, a copy of the sound one; gives words that the message must have.
Spoil = Callable[[Path, Path], str]


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


def far(*keys: str | int) -> Spoil:
    """A number of the first object is ten thousand million metres."""

    def spoil(path: Path, root: Path) -> str:
        document = json.loads(path.read_bytes())
        at = document["objects"][0]
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = 1e10
        path.write_bytes(json.dumps(document).encode())
        place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
        return f"objects[0]{place}: the number 10000000000.0 is beyond"

    return spoil


def npz(array: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("output.npy", array)
    return buffer.getvalue()


def zip_bomb(path: Path, root: Path) -> str:
    path.write_bytes(npz(bytes(300 << 20)))
    return "decompresses to more than 268435456 bytes"


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


def fifo_mesh(path: Path, root: Path) -> str:
    """The mesh of a building that is sound otherwise."""
    (mesh,) = (p for p in root.rglob(f"{path.name.split('.')[0]}.glb"))
    return fifo(mesh, root)


def nameless(path: Path, root: Path) -> str:
    """The name begins with a byte that UTF-8 does not have."""
    path.rename(os.fsdecode(os.fsencode(path.parent) + b"/\xff" + os.fsencode(path.name)))
    return "the name is not UTF-8 text"


CASES: dict[str, dict[str, tuple[str, Spoil]]] = {
    "procthor": {
        "deep.json": ("deep", deep),
        "far.json": ("far", far("position", "y")),
        "cut.json": ("cut", cut),
        "link.json": ("link", leaving),
        "lines.jsonl": ("lines-0", deep_line),
        "fifo.json": ("fifo", fifo),
        "fifo-lines.jsonl": ("fifo-lines", fifo),
        "latin.json": (r"\xfflatin.json", nameless),
    },
    "ithor": {
        "FloorPlan2.json": ("FloorPlan2", deep),
        "FloorPlan3.json": ("FloorPlan3", far("axisAlignedBoundingBox", "center", "x")),
        "FloorPlan4.json": ("FloorPlan4", cut),
        "FloorPlan5.json": ("FloorPlan5", fifo),
    },
    "robothor": {
        "FloorPlan_Val1_1.json": ("FloorPlan_Val1_1", deep),
        "FloorPlan_Val1_2.json": ("FloorPlan_Val1_2", far("axisAlignedBoundingBox", "center", "x")),
        "FloorPlan_Val1_3.json": ("FloorPlan_Val1_3", cut),
    },
    "mp3d": {
        "cut/house_segmentations/cut.house": ("cut", cut),
        "link/house_segmentations/link.house": ("link", leaving),
        "mesh/house_segmentations/mesh.house": ("mesh", climbing_glb),
        "polygons/house_segmentations/polygons.house": ("polygons", claiming_navmesh),
        "fifo/house_segmentations/fifo.house": ("fifo", fifo),
        "glb/house_segmentations/glb.house": ("glb", fifo_mesh),
        "latin/house_segmentations/latin.house": (r"latin/house_segmentations/\xfflatin.house", nameless),
    },
    "gibson": {
        "verified/deep.scn": ("verified/deep", deep),
        "verified/far.scn": ("verified/far", far("size", 2)),
        "verified/link.scn": ("verified/link", leaving),
        "verified/polygons.scn": ("verified/polygons", claiming_navmesh),
        "verified/fifo.scn": ("verified/fifo", fifo),
        "verified/latin.scn": (r"verified/\xfflatin.scn", nameless),
        "verified/3DSceneGraph_bomb.npz": ("verified/bomb", zip_bomb),
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
        instructions=InstructionsConfig(per_category={"simple": 4}),
        sampling=SamplingConfig(usual_places=False),
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


def test_the_only_file_of_a_dataset_is_named_where_its_name_is_not_utf_8(tmp_path: Path) -> None:
    make_samples(tmp_path, "procthor", 1, 3)
    nameless(tmp_path / "houses.jsonl.gz", tmp_path)
    faults = {handle.scene_id: str(handle.fault) for handle in open_source("procthor", tmp_path).handles()}
    assert r"\xffhouses.jsonl.gz: the name is not UTF-8 text" in faults[r"\xffhouses.jsonl.gz"]
