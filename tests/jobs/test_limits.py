"""One scene too large for the limits is quarantined alone, with a message that names the limit; the others go on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from condvln.samples import make_samples
from jobs.generate import run_generate
from schemas.config import Config, LimitsConfig, SourceConfig
from tests.huge_house import add_huge_house

HUGE = 1200
"""Objects in the room of the large house."""


@pytest.fixture(scope="module")
def houses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two made houses and a large one."""
    root = tmp_path_factory.mktemp("houses")
    make_samples(root, "procthor", 2, 5)
    add_huge_house(root, "huge", HUGE)
    return root


def test_a_room_beyond_the_limit_costs_its_own_scene_only(houses: Path, configured: Callable[..., Config]) -> None:
    config = configured(houses, sources=(SourceConfig(family="procthor", root=houses),))
    report = run_generate(config, inline=True)
    (entry,) = report.document["quarantined"]
    limit = LimitsConfig().objects_per_room
    assert entry["unit"] == "procthor/huge"
    assert entry["stage"] == "scene"
    assert f"room 'room|2': {HUGE} objects, and limits.objects_per_room is {limit}" in entry["message"]
    assert "Raise limits.objects_per_room" in entry["message"]
    assert report.exit_code == 3
    assert report.document["counts"]["ok"] == 2
    assert report.document["published"]


def test_another_limit_tries_the_scene_again_and_changes_no_other(
    houses: Path, configured: Callable[..., Config]
) -> None:
    """The limits are part of what the first stage is keyed on; what it makes of the other scenes is the same."""
    limits = LimitsConfig(objects_per_room=3)
    config = configured(houses, sources=(SourceConfig(family="procthor", root=houses, scenes=("houses-*",)),))
    assert run_generate(config.model_copy(update={"limits": limits}), inline=True).exit_code == 4
    first = run_generate(config, inline=True)
    assert (first.exit_code, first.document["counts"]["ok"]) == (0, 2)
    wider = LimitsConfig(objects_per_room=LimitsConfig().objects_per_room - 1)
    second = run_generate(config.model_copy(update={"limits": wider}), inline=True)
    assert second.document["snapshot_id"] == first.document["snapshot_id"]
    assert second.document["stages"] == {"scene": 2}
