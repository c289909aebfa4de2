"""Each kind of file in a store, damaged in each way, met by each verb: healed with the same id, or one clear error."""

from __future__ import annotations

import fcntl
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from jobs.pipeline import listed_units
from jobs.rebuild import run_rebuild
from jobs.report import Report
from schemas.config import Config
from schemas.errors import CondVLNError
from tests.jobs.conftest import made_config
from tests.jobs.damaged_store import DAMAGES, KINDS, READERS, VERBS, Built, settle, told
from tests.once import made_once

QUICK = {"plan", "status", "query"}
"""Verbs of the part that every test run has; ``generate`` beside them after a removal."""

CASES = [
    pytest.param(
        kind,
        damage,
        verb,
        id=f"{kind}-{damage}-{verb}",
        marks=()
        if damage in ("removed", "changed") and (verb in QUICK or (verb == "generate" and damage == "removed"))
        else pytest.mark.soak,
    )
    for kind in KINDS
    for damage in DAMAGES
    for verb in VERBS
]


def made_matrix(folder: Path) -> Built:
    """Two made houses whose navmeshes are built, published twice and exported."""
    config = made_config(folder, "procthor", 2, episodes={"simple": 2}, name="made", store=folder / "none")
    settle(folder / "data")
    scenes = [unit.unit_id.split("/", 1)[1] for unit in listed_units(config)]
    return Built.make(folder, config, scenes)


@pytest.fixture
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Built]:
    """The made houses, which one case at a time may damage."""
    made = made_once(tmp_path_factory, "matrix", made_matrix)
    with (made.aside.parent / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield made


def names_file_and_remedy(text: str) -> bool:
    """Whether a message names a file below the store or the export, and what to do."""
    return re.search(r"/(store|export)/\S*\w", text) is not None and "condvln" in text


def asked(verb: str, config: Config) -> tuple[Report | None, int, str]:
    """(report, exit code, what was said) of a verb; an error that is not ours would be a traceback."""
    try:
        report = VERBS[verb](config)
    except CondVLNError as error:
        return None, error.exit_code, str(error)
    return report, report.exit_code, "\n".join(report.lines)


@pytest.mark.parametrize(("kind", "damage", "verb"), CASES)
def test_damage_is_healed_or_told(built: Built, kind: str, damage: str, verb: str) -> None:
    built.restore()
    rows, exported = built.rows(), built.exported(built.aside)
    path = built.damage(kind, damage)
    wrong = path.read_bytes() if path.exists() else None
    report, exit_code, said = asked(verb, built.config)
    if report is None or exit_code != 0:
        assert exit_code != 0
        assert names_file_and_remedy(said), said
        assert built.exported() == exported, "an error leaves the export as it was"
        return
    if kind == "ref" and damage == "older" and verb in READERS:
        return  # consistent in itself: what was published then is what is read
    assert built.exported() == exported
    if verb in READERS:
        answer = told(verb, report)
        if verb == "plan" and answer != built.answers[verb]:
            assert answer["damaged"] or answer["reasons"] == {"damaged": 1} or kind == "ref", answer
            return
        assert answer == built.answers[verb]
        return
    if path.exists() and path.read_bytes() == wrong:
        # Nobody read it, and its size is as it was: nothing was lost by it, and --verify finds it.
        assert damage in ("changed", "older")
        done = run_rebuild(built.config, inline=True, verify=True)
        assert done.exit_code == 0, done.lines
    assert built.rows() == rows
    assert built.exported() == exported
