"""``condvln demo --family``: every form it makes is a source that a configuration can name, as it says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from condvln.samples import FORMS
from jobs.command import app
from jobs.configuration import load_config
from jobs.workspace import published
from schemas.config import SourceConfig
from schemas.errors import UsageError

SCENES = 2


def ran(*words: str) -> Any:
    """The document of a command that ends well."""
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def sampled(form: str, folder: Path) -> dict[str, Any]:
    return dict(ran("demo", "--out", str(folder), "--family", form, "--scenes", str(SCENES), "--seed", "3"))


@pytest.mark.parametrize("form", sorted(FORMS))
def test_what_it_writes_is_the_source_that_it_tells(form: str, tmp_path: Path) -> None:
    made = sampled(form, tmp_path / "data")
    files = [path for path in (tmp_path / "data").rglob("*") if path.is_file()]
    assert (made["files"], made["bytes"]) == (len(files), sum(path.stat().st_size for path in files))
    assert SourceConfig(**made["source"]).family in (form, "procthor")
    config = tmp_path / "run.yaml"
    config.write_text(yaml.safe_dump({"name": "made", "store": "store", "sources": [made["source"]]}))
    (source,) = ran("sources", str(config))["sources"]
    assert source["scenes"] >= SCENES  # a room each, where the family's scenes are rooms
    assert [one for one in source["files"] if one["need"] == "required" and not one["files"]] == []
    assert (source["read"], source["unreadable"], source["skipped"]) == (source["scenes"], [], [])
    assert not (tmp_path / "store").exists()


def test_habitats_procthor_goes_the_whole_way(tmp_path: Path) -> None:
    """The rooms are the houses', so that instructions name them."""
    made = sampled("ai2thor-hab", tmp_path / "data")
    assert {path.name for path in (tmp_path / "data").iterdir()} == {"hab", "houses"}
    config = tmp_path / "run.yaml"
    document = {
        "name": "made",
        "store": "store",
        "export": "export",
        "sources": [made["source"]],
        "instructions": {"per_category": {"simple": 2, "chain": 2}, "counterfactual_groups": 0},
    }
    config.write_text(yaml.safe_dump(document))
    (surveyed,) = ran("sources", str(config))["sources"]
    assert (surveyed["family"], surveyed["scenes"], surveyed["rooms"]) == ("procthor", SCENES, made["rooms"])
    assert ran("generate", str(config), "--inline")["published"]
    rooms = published(load_config(config)).table("rooms").to_pylist()
    assert len(rooms) == made["rooms"]
    assert {(room["source"], room["annotation"]) for room in rooms} == {("procthor", "dataset")}
    manifests = [json.loads(line) for path in (tmp_path / "export/manifest").glob("*.jsonl") for line in path.open()]
    assert len(manifests) >= 2
    assert {row["scene_id"] for row in manifests} <= {f"ProcTHOR-Train-{k}" for k in range(SCENES)}
    assert ran("verify", str(config))["proven"] == len(manifests)


def test_what_it_refuses(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "x"), "--family", "scannet"])
    assert isinstance(result.exception, UsageError)
    assert f"Choose one of: {', '.join(sorted(FORMS))}" in str(result.exception)
    assert not (tmp_path / "x").exists()
    said = CliRunner().invoke(app, ["demo", "--help"], terminal_width=1000).output
    assert all(form in said for form in FORMS)
