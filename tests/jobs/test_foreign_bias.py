"""``condvln bias`` on files and folders."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from jobs.bias import report_bias
from schemas.errors import UsageError

STAY = "If there is a {} in the hall, stop where you are; otherwise, walk to the sofa."


def written(path: Path, text: str, stays: list[bool]) -> Path:
    episodes = [
        {
            "episode_id": k,
            "scene_id": f"mp3d/s{k % 12}/s{k % 12}.glb",
            "start_position": [0, 0, 0],
            "goals": [{"position": [0 if stay else 6, 0, 0]}],
            "instruction": {"instruction_text": text.format(("lamp", "snowmobile")[stay])},
        }
        for k, stay in enumerate(stays)
    ]
    path.write_text(json.dumps({"episodes": episodes}))
    return path


def test_a_leak_gives_exit_code_3_and_names_the_guesser(tmp_path: Path) -> None:
    report = report_bias([written(tmp_path / "leaky.json", STAY, [k % 5 < 2 for k in range(240)])])
    assert report.exit_code == 3
    assert "what is asked" in report.lines[0]
    assert [section.title for section in report.sections] == ["Files", "Guesses that see no scene"]
    assert report.as_json()["files"][str(tmp_path / "leaky.json")]["decided"] == 240
    assert report.as_json()["passed"] is False


def test_a_folder_is_judged_alone(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="together with other files"):
        report_bias([tmp_path, written(tmp_path / "few.json", STAY, [True])])


def test_a_configuration_is_told_to_be_one(tmp_path: Path) -> None:
    (tmp_path / "run.yaml").write_text("name: run")
    with pytest.raises(UsageError, match="that is a configuration"):
        report_bias([tmp_path / "run.yaml"])
