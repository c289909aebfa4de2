"""Files that anybody may hand in: whatever stands in them, the linter finds it and other readers raise one error."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.export.twin import rewrite_split
from condvln.export.validation import CODES, validate
from condvln.export.validation.folder import EpisodeNavmeshes
from condvln.manifest import read_manifest
from schemas.errors import CondVLNError
from tests.broken_bytes import ANYTHING, spoiled
from tests.strict_loader import read


@pytest.fixture(scope="module")
def documents(exported: Path) -> dict[str, Any]:
    """A small file of each format, by its name."""
    ansr = read(exported / "ansr" / "test" / "test.json.gz")
    guide = read(exported / "rxr" / "test" / "test_guide.json.gz")
    truths = read(exported / "ansr" / "test" / "test_gt.json.gz")
    words = ansr["instruction_vocab"]["word_list"][:4]
    few = {
        "episodes": ansr["episodes"][:2],
        "instruction_vocab": {"word_list": words, "stoi": {}, "num_vocab": len(words)},
    }
    for episode in few["episodes"]:
        episode["instruction"]["instruction_tokens"] = [2, 3, 0]
    names = [str(episode["episode_id"]) for episode in few["episodes"]]
    item = {"scan": "s", "path_id": 1, "path": ["0", "1"], "heading": 1.0, "instructions": ["Go."], "distance": 4.0}
    return {
        "test.json": few,
        "test_guide.json": {"episodes": guide["episodes"][:2]},
        "test_gt.json": {name: {**truths[name], "locations": truths[name]["locations"][:3]} for name in names},
        "R2R_test.json": [item],
    }


FUZZED = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@FUZZED
@given(st.data())
def test_the_linter_never_falls_over(documents: dict[str, Any], tmp_path: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(documents)))
    for other, document in documents.items():
        (tmp_path / other).write_text(json.dumps(document))
    (tmp_path / name).write_text(json.dumps(spoiled(documents[name], data)))
    for finding in validate(tmp_path):
        assert finding.code in CODES
        assert finding.file in documents
        assert "\n" not in finding.line()


@FUZZED
@given(st.data())
def test_the_twin_is_one_error_or_a_file_of_as_many_episodes(
    documents: dict[str, Any], exported: Path, tmp_path: Path, data: st.DataObject
) -> None:
    manifest = {str(row.episode_id): row for row in read_manifest(exported / "manifest" / "test.jsonl")}
    document = spoiled(documents[data.draw(st.sampled_from(["test.json", "test_guide.json"]))], data)
    source, out = tmp_path / "x.json", tmp_path / "twin.json"
    out.unlink(missing_ok=True)
    source.write_text(json.dumps(document))
    with suppress(CondVLNError):
        report = rewrite_split(source, manifest, out, lambda row: "Go there.")
        assert len(json.loads(out.read_text())["episodes"]) == report.episodes == len(document["episodes"])
        return
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.json"]


@FUZZED
@given(ANYTHING, ANYTHING)
def test_no_episode_leads_to_a_navmesh_outside(tmp_path: Path, scene: Any, info: Any) -> None:
    (tmp_path / "manifest").mkdir(exist_ok=True)
    (tmp_path / "manifest" / "test.jsonl").write_text('{"navmesh_sha256": "1", "navmesh": "../../etc/passwd"}\n[]\n{')
    navmeshes = EpisodeNavmeshes(tmp_path, (tmp_path,))
    assert navmeshes({"scene_id": scene, "info": info}) is None
    assert navmeshes({"scene_id": scene, "info": {"navmesh_sha256": "1"}}) is None
    assert len(navmeshes.lacking) == 1
