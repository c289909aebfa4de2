"""One scene too large for the limits is quarantined alone, with a message that names the limit; the others go on."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from condvln.samples import make_samples
from factory import machine
from jobs.generate import run_generate
from jobs.workspace import published
from schemas.config import Config, LimitsConfig, RayConfig, SourceConfig
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


class Peaks(threading.Thread):
    """Watches this process and all below it; the most memory that any one of them held, in bytes, by process id."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.of: dict[int, int] = {}
        self._ended = threading.Event()

    def run(self) -> None:
        own = psutil.Process()
        while not self._ended.wait(0.05):
            for process in (own, *own.children(recursive=True)):
                with contextlib.suppress(psutil.Error):
                    self.of[process.pid] = max(self.of.get(process.pid, 0), process.memory_info().rss)

    def __enter__(self) -> Peaks:
        machine.reset_peak_rss()
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self.join()
        # Between two looks this process may have held more; the system counts without a gap.
        self.of[os.getpid()] = max(self.of.get(os.getpid(), 0), machine.peak_rss())


def corpus(root: Path, small: int, *huge: int) -> Path:
    """Made houses, and one house for each number of `huge` whose only room has so many objects."""
    make_samples(root, "procthor", small, 5)
    for objects in huge:
        add_huge_house(root, f"huge{objects}", objects)
    return root


@pytest.mark.soak
@pytest.mark.parametrize("workers", [0, 2])
def test_rooms_of_ten_and_fifty_thousand_objects_leave_the_others_published(
    tmp_path: Path, configured: Callable[..., Config], workers: int
) -> None:
    root = corpus(tmp_path / "houses", 18, 10_000, 50_000)
    ray = RayConfig(workers=max(workers, 1))
    config = configured(root, sources=(SourceConfig(family="procthor", root=root),), ray=ray)
    with Peaks() as peaks:
        report = run_generate(config, inline=not workers)
    counts = report.document["counts"]
    assert (counts["ok"], counts["quarantined"], report.exit_code, report.document["published"]) == (18, 2, 3, True)
    messages = {entry["unit"]: entry["message"] for entry in report.document["quarantined"]}
    limits = LimitsConfig()
    assert f"10000 objects, and limits.objects_per_room is {limits.objects_per_room}" in messages["procthor/huge10000"]
    assert (
        f"50000 objects, and limits.objects_per_scene is {limits.objects_per_scene}" in messages["procthor/huge50000"]
    )
    print(f"largest processes, MiB: {sorted((peak >> 20 for peak in peaks.of.values()), reverse=True)[:4]}")
    assert max(peaks.of.values()) <= 2 << 30
    assert len(peaks.of) > workers
    scenes = published(config).table("scenes")["scene_id"].to_pylist()
    assert len(scenes) == 18
