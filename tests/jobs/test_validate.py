"""The linter's command: a line a finding, records for scripts, exit code 3 on errors only."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from condvln.formats.json_entries import read_unpacked
from condvln.navigation.graph_pathfinder import read_connectivity
from condvln.samples import make_samples
from jobs.command import app
from jobs.export import run_export
from jobs.report import Report
from jobs.validate import validate_files
from jobs.verify import verify_export
from schemas.config import Config
from schemas.errors import UsageError

runner = CliRunner()


def split_of(export: Path) -> Path:
    """The largest split's stock file."""
    found = [path for path in (export / "vlnce").glob("*/*.json.gz") if not path.name.endswith("_gt.json.gz")]
    return max(found, key=lambda path: path.stat().st_size)


def spoiled(export: Path, path: Path, change: Any) -> Path:
    document = json.loads(read_unpacked(split_of(export)))
    change(document["episodes"][0])
    path.write_bytes(gzip.compress(json.dumps(document).encode(), mtime=0))
    return path


def test_our_export_has_no_error_and_stands_on_its_navmeshes(export: Path, made_dataset: Path) -> None:
    report = validate_files(export, (made_dataset,))
    assert {finding.code for finding in report.findings} <= {"no-episodes"}  # two scenes fill no four splits
    assert report.exit_code == 0
    assert report.navmeshes.checked
    assert report.navmeshes.lacking == {}
    # a single file knows its export, so that the manifest's navmeshes are found
    alone = validate_files(split_of(export), (made_dataset,))
    assert (alone.findings, alone.navmeshes.lacking) == ((), {})
    assert alone.navmeshes.checked <= report.navmeshes.checked


def test_a_start_beside_the_navmesh_is_named_where_the_navmesh_is_known(
    export: Path, made_dataset: Path, tmp_path: Path
) -> None:
    def lift(episode: dict[str, Any]) -> None:
        for point in (episode["start_position"], episode["reference_path"][0]):
            point[1] += 3.0

    path = spoiled(export, export / "vlnce" / "lifted.json.gz", lift)
    try:
        assert "start-off-mesh" in {f.code for f in validate_files(path, (made_dataset,)).findings}
        without = validate_files(path)
        assert "start-off-mesh" not in {f.code for f in without.findings}
        assert without.navmeshes.lacking
        assert "not, such as replicacad/" in without.as_text()
    finally:
        path.unlink()


def test_a_strangers_navmesh_stands_beside_the_mesh(export: Path, made_dataset: Path, tmp_path: Path) -> None:
    def strange(episode: dict[str, Any]) -> None:
        episode["scene_id"] = "data/scene_datasets/mp3d/abc/abc.glb"
        del episode["info"]["navmesh_sha256"]

    path = spoiled(export, tmp_path / "theirs.json.gz", strange)
    (tmp_path / "scenes" / "mp3d" / "abc").mkdir(parents=True)
    source = json.loads((export / "manifest" / f"{split_of(export).parent.name}.jsonl").read_text().splitlines()[0])
    data = (made_dataset / source["navmesh"]).read_bytes()
    (tmp_path / "scenes" / "mp3d" / "abc" / "abc.navmesh").write_bytes(data)
    for root in (tmp_path / "scenes", tmp_path / "scenes" / "mp3d"):
        report = validate_files(path, (root,))
        assert "data/scene_datasets/mp3d/abc/abc.glb" in report.navmeshes.checked
        assert {finding.code for finding in report.findings} == {"scene-prefix"}
    (tmp_path / "scenes" / "mp3d" / "abc" / "abc.navmesh").write_bytes(data[:100])
    assert "data/scene_datasets/mp3d/abc/abc.glb" in validate_files(path, (tmp_path / "scenes",)).navmeshes.lacking


@pytest.mark.parametrize("scene", ["../../etc/a.glb", "/etc/a.glb", "", "a"])
def test_a_scene_path_leads_to_no_file_outside(export: Path, tmp_path: Path, scene: str) -> None:
    def astray(episode: dict[str, Any]) -> None:
        episode["scene_id"] = scene
        episode["info"]["navmesh_sha256"] = "unknown"

    path = spoiled(export, tmp_path / "astray.json.gz", astray)
    assert scene in validate_files(path, (tmp_path,)).navmeshes.lacking


def test_what_was_checked_is_said_and_what_is_not_there(export: Path, tmp_path: Path) -> None:
    """An export of texts alone holds its record and no episode; a folder of somebody else's is refused."""
    said = validate_files(export).as_text()
    # VLN-CE has direct paths, looking paths and the oracle twin; ANSR-v1 the first two.
    stock = [json.loads(read_unpacked(path)) for path in export.glob("[vo]*/*/*.json.gz") if "_gt." not in path.name]
    count = sum(len(one["episodes"]) for one in stock)
    assert f" files with {count:,} episodes of VLN-CE, {count * 2 // 3:,} of ANSR-v1, " in said
    (tmp_path / "origin.json").write_text("{}")
    report = validate_files(tmp_path)
    assert report.exit_code == 0
    assert "checked: nothing, as the export has no file of episodes or paths" in report.as_text()
    assert "texts without an episode, which are in the store alone" in report.as_text()
    (tmp_path / "origin.json").unlink()
    with pytest.raises(UsageError, match="no VLN-CE"):
        validate_files(tmp_path)


def test_command_prints_a_line_a_finding_and_ends_with_three(export: Path, tmp_path: Path) -> None:
    names = []

    def extend(episode: dict[str, Any]) -> None:
        names.append(str(episode["episode_id"]))
        episode["gold_leaf"] = 1
        del episode["trajectory_id"]

    path = spoiled(export, tmp_path / "theirs.json.gz", extend)
    result = runner.invoke(app, ["verify", str(path), "--lint"])
    assert result.exit_code == 3
    lines = result.stdout.splitlines()
    assert f"theirs.json.gz: episode {names[0]}.gold_leaf: error [unknown-key] unknown key 'gold_leaf'" in lines
    assert "2 errors, 0 warnings" in lines
    records = runner.invoke(app, ["verify", str(path), "--lint", "--json"])
    assert records.exit_code == 3
    document = json.loads(records.stdout)
    assert document["exit_code"] == 3
    assert {(f["file"], f["episode"], f["code"]) for f in document["findings"]} == {
        ("theirs.json.gz", names[0], "unknown-key"),
        ("theirs.json.gz", names[0], "missing-key"),
    }
    assert all(f["remedy"] and f["message"] for f in document["findings"])


def test_command_passes_what_is_sound(real_data: Path) -> None:
    result = runner.invoke(app, ["verify", str(real_data / "vlnce"), "--lint"])
    assert result.exit_code == 0
    assert "0 errors, 1 warnings" in result.stdout
    r2r = ["verify", str(real_data / "mp3d" / "R2R_sample.json"), "--lint"]
    assert runner.invoke(app, [*r2r, "--connectivity", str(real_data / "mp3d" / "connectivity")]).exit_code == 0


def test_nothing_checked_is_no_success(tmp_path: Path) -> None:
    for words in (["verify", str(tmp_path), "--lint"], ["verify", str(tmp_path / "no"), "--lint"], ["export"]):
        result = runner.invoke(app, words)
        assert result.exit_code != 0


def test_certificates_beside_the_episodes_are_no_episodes(
    made_run: tuple[Config, Report], tmp_path: Path, made_dataset: Path
) -> None:
    config, _ = made_run
    run_export(config.model_copy(update={"export": tmp_path}))
    before = validate_files(tmp_path, [made_dataset])
    assert verify_export(config, tmp_path).exit_code == 0
    assert (tmp_path / "certificates" / "summary.json").is_file()
    assert validate_files(tmp_path, [made_dataset]).as_json() == before.as_json()


def test_how_many_paths_were_checked_along_a_graph_is_said(tmp_path: Path) -> None:
    """R2R's own files: a scan without a graph is no silent pass, and a path off the edges is an error."""
    make_samples(tmp_path / "mp3d", family="mp3d", scenes=1, seed=3)
    (file,) = (tmp_path / "mp3d").rglob("*_connectivity.json")
    graph = read_connectivity(file)
    one, other = (graph.ids[k] for k in graph.edges[0])
    item = {"scan": file.name.removesuffix("_connectivity.json"), "heading": 1.0, "instructions": ["Go."]}
    item |= {"path_id": 1, "path": [one, other], "distance": round(float(graph.lengths[0]), 2)}
    path = tmp_path / "R2R_theirs.json"
    path.write_text(json.dumps([item, item | {"path_id": 2, "scan": "elsewhere"}]))
    report = validate_files(path, graphs=[file.parent])
    assert report.exit_code == 0
    assert "1 paths of 1 scans checked along their scan's graph" in report.as_text()
    assert "1 paths of 1 scans not checked along a graph, such as elsewhere" in report.as_text()
    assert report.as_json()["graphs"] == {"checked": {item["scan"]: 1}, "lacking": {"elsewhere": 1}}
    assert "2 paths of 2 scans not checked" in validate_files(path).as_text()
    path.write_text(json.dumps([item | {"distance": item["distance"] + 0.1}]))
    assert validate_files(path, graphs=[file.parent]).exit_code == 3
