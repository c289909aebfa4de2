"""Bad input costs its own scene only: one clear error, and a rerun after the correction repairs just that scene."""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jobs.generate import run_generate
from jobs.report import Report
from jobs.workspace import published
from schemas.config import Config

BROKEN = "made_001"
SOUND = ("made_000",)
SOAK = pytest.mark.soak


def scene_file(root: Path) -> Path:
    return root / "configs" / "scenes" / f"{BROKEN}.scene_instance.json"


def change_scene(root: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    path = scene_file(root)
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return path


def own_object(root: Path) -> str:
    """An object model that only the broken scene uses."""
    uses = {
        path.name.split(".")[0]: {
            o["template_name"].split("/")[-1] for o in json.loads(path.read_text())["object_instances"]
        }
        for path in sorted((root / "configs" / "scenes").glob("*.json"))
    }
    own = sorted(uses[BROKEN] - uses[SOUND[0]])
    return next(name for name in own if (root / "objects" / f"{name}.glb").is_file())


def truncated_glb(root: Path) -> Path:
    path = root / "objects" / f"{own_object(root)}.glb"
    path.write_bytes(path.read_bytes()[:-200])
    return path


def climbing_asset(root: Path, target: str) -> Path:
    path = root / "configs" / "objects" / f"{own_object(root)}.object_config.json"
    document = json.loads(path.read_text())
    document["render_asset"] = target
    path.write_text(json.dumps(document))
    return path


def navmesh(root: Path) -> Path:
    return root / "navmeshes_default" / f"{BROKEN}.navmesh"


def patch(path: Path, offset: int, data: bytes) -> Path:
    whole = bytearray(path.read_bytes())
    whole[offset : offset + len(data)] = data
    path.write_bytes(bytes(whole))
    return path


def cut(path: Path, keep: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    return path


def first(document: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = document["object_instances"][0]
    return found


CASES: dict[str, tuple[Callable[[Path], Path], str]] = {
    "truncated GLB": (truncated_glb, ""),
    "wrong type": (lambda r: change_scene(r, lambda d: first(d).update(translation="here")), "translation"),
    "not JSON": (lambda r: cut(scene_file(r), 0.7), ""),
    "infinite coordinate": (lambda r: change_scene(r, lambda d: first(d)["translation"].__setitem__(1, 1e999)), ""),
    "two objects with one id": (
        lambda r: change_scene(r, lambda d: [o.update(id="twin") for o in d["object_instances"][:2]]),
        "twin",
    ),
    "path that climbs out of the root": (lambda r: climbing_asset(r, "../../../../../../etc/passwd"), "passwd"),
    "navmesh cut in its tile": (lambda r: cut(navmesh(r), 0.6), ""),
    "navmesh claiming 2^31 - 1 polygons": (lambda r: patch(navmesh(r), 96 + 8 + 24, struct.pack("<i", 2**31 - 1)), ""),
}


def quarantined(report: Report) -> dict[str, str]:
    return {entry["unit"]: entry["message"] for entry in report.document["quarantined"]}


@pytest.fixture
def config(dataset: Path, configured: Callable[..., Config], made_run: tuple[Config, Report]) -> Config:
    """A configuration over the copied dataset, whose store holds the clean run, so that only what changes is made."""
    found = configured(dataset)
    shutil.copytree(made_run[0].store, found.store)
    return found


PLAIN = ("truncated GLB", "not JSON", "navmesh cut in its tile")
"""One case of each kind of file; the others run in soak."""


@pytest.mark.parametrize("case", [case if case in PLAIN else pytest.param(case, marks=SOAK) for case in sorted(CASES)])
def test_only_the_broken_scene_is_lost_and_only_it_is_repaired(
    case: str, dataset: Path, made_dataset: Path, config: Config
) -> None:
    spoil, named = CASES[case]
    spoiled = spoil(dataset)
    report = run_generate(config, inline=True)
    assert report.exit_code == 3
    found = quarantined(report)
    assert set(found) == {f"replicacad/{BROKEN}"}
    message = found[f"replicacad/{BROKEN}"]
    assert spoiled.name in message
    assert named in message
    assert ". " in message, "a remedy follows the fault"
    assert {row["scene_id"] for row in published(config).table("scenes").to_pylist()} == set(SOUND)
    # Mended, just that scene is made, and the snapshot is that of a run that was never broken.
    shutil.copy(made_dataset / spoiled.relative_to(dataset), spoiled)
    again = run_generate(config, inline=True)
    assert again.exit_code == 0
    assert again.document["counts"]["fresh"] == len(SOUND)
    assert again.document["counts"]["ok"] == len(SOUND) + 1


def test_a_sound_scene_with_no_or_one_object_is_skipped(dataset: Path, configured: Callable[..., Config]) -> None:
    for keep, words in ((1, "only one object"), (0, "no object")):

        def thin(document: dict[str, Any], keep: int = keep) -> None:
            document["object_instances"] = document["object_instances"][:keep]
            document["articulated_object_instances"] = []

        change_scene(dataset, thin)
        config = configured(dataset)
        report = run_generate(config, inline=True)
        assert report.exit_code == 0
        assert report.document["counts"]["skipped"] == 1
        (row,) = [r for r in published(config).table("scenes").to_pylist() if r["scene_id"] == BROKEN]
        assert (row["status"], words in row["reason"]) == ("skipped", True), row


def test_scenes_that_yield_nothing_export_nothing_and_say_so(
    dataset: Path, tmp_path: Path, configured: Callable[..., Config]
) -> None:
    for path in sorted((dataset / "configs" / "scenes").glob("*.json")):
        document = json.loads(path.read_text())
        document.update(object_instances=[], articulated_object_instances=[])
        path.write_text(json.dumps(document))
    report = run_generate(configured(dataset, export=tmp_path / "export"), inline=True)
    assert report.exit_code == 0
    assert any("no episodes on a navmesh to export" in line for line in report.lines)
    assert [scene["why"] for scene in report.document["funnel"]["scenes"]] == [
        "no object: nothing to relate or to choose between"
    ] * 2
    assert not (tmp_path / "export").exists()


@pytest.mark.parametrize(
    ("of", "kind"),
    [
        ("scene", "FIFO"),
        pytest.param("own object", "socket", marks=SOAK),
        ("own mesh", "link to /dev/zero"),
        pytest.param("navmesh", "link to itself", marks=SOAK),
    ],
)
def test_what_is_no_file_costs_its_scene_only(
    of: str, kind: str, dataset: Path, config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(dataset)
    path = {
        "scene": scene_file,
        "own object": lambda root: root / "configs" / "objects" / f"{own_object(root)}.object_config.json",
        "own mesh": lambda root: root / "objects" / f"{own_object(root)}.glb",
        "navmesh": navmesh,
    }[of](dataset)
    path.unlink()
    if kind == "FIFO":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(os.path.relpath(path))  # a socket's whole path may be too long
    else:
        path.symlink_to("/dev/zero" if kind == "link to /dev/zero" else path.name)
    report = run_generate(config, inline=True)
    assert report.exit_code == 3
    (unit,) = quarantined(report)
    assert unit == f"replicacad/{BROKEN}"
    assert path.name in quarantined(report)[unit]


@pytest.mark.parametrize("of", ["scene", "object nobody names"])
def test_a_name_that_is_not_utf_8_costs_nothing_else(
    of: str, dataset: Path, configured: Callable[..., Config], made_run: tuple[Config, Report]
) -> None:
    """Its message can be printed, stored and read as JSON; all scenes with sound names are made."""
    kind, suffix = ("scenes", "scene_instance") if of == "scene" else ("objects", "object_config")
    folder = dataset / "configs" / kind
    shutil.copy(min(folder.iterdir()), os.fsdecode(os.fsencode(folder) + f"/\xff.{suffix}.json".encode("latin-1")))
    report = run_generate(configured(dataset), inline=True)
    assert report.exit_code == 3
    assert report.document["counts"]["ok"] == len(SOUND) + 1
    name = rf"configs/{kind}/\xff.{suffix}.json"
    ((unit, message),) = quarantined(report).items()
    assert unit == f"replicacad/{name}"
    assert f"{name}: the name is not UTF-8 text" in message
    json.dumps(report.as_json(), ensure_ascii=False).encode()
