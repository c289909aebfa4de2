"""Scenes are listed again when, and only when, a file of theirs may have changed."""

from __future__ import annotations

import errno
import gc
import gzip
import json
import os
import shutil
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import jobs.listing
from condvln.samples import make_samples
from condvln.sources.source import hash_file
from factory import Unit
from factory.unit_list import UnitList
from jobs.listing import _read, _write, listed_units
from jobs.pipeline import list_units, units_of
from schemas.config import AgentConfig, Config, SourceConfig, SplitsConfig


@pytest.fixture
def config(dataset: Path, configured: Callable[..., Config]) -> Config:
    settle(dataset)
    return configured(dataset)


@pytest.fixture
def listings(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """One entry for each time that the sources are really listed."""
    found: list[int] = []

    def counted(*arguments: object) -> object:
        units = units_of(*arguments)  # type: ignore[arg-type]
        found.append(len(units))
        return units

    monkeypatch.setattr(jobs.listing, "units_of", counted)
    return found


def settle(folder: Path, age: float = 60.0) -> None:
    for path in folder.rglob("*"):
        os.utime(path, (time.time() - age, time.time() - age))


def test_what_is_remembered_is_what_would_be_listed(config: Config, listings: list[int]) -> None:
    expected = list_units(config, hash_file)
    assert [[*listed_units(config)] for _ in range(3)] == [expected] * 3
    assert listings == [2]


def test_files_beyond_the_table_are_repeated_in_each_scene(
    config: Config, listings: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs.listing, "FILES", 3)
    expected = list_units(config, hash_file)
    assert len({file for unit in expected for file in unit.inputs}) > 3
    assert [[*listed_units(config)] for _ in range(2)] == [expected] * 2
    assert listings == [2]


def test_two_processes_that_write_at_once_do_not_mix_their_lists(tmp_path: Path) -> None:
    first, second = ([Unit(f"{name}{k}", "p") for k in range(4)] for name in "ab")

    class Slow(UnitList):
        def __iter__(self) -> Iterator[Unit]:
            for at, unit in enumerate(super().__iter__()):
                if at == 2:
                    _write(path, "second", UnitList(second))
                    assert [*_read(path, "second")] == second
                yield unit

    path = tmp_path / "list.json"
    (tmp_path / "list.0123.tmp").write_bytes(b"left by a process that was killed")
    _write(path, "first", Slow(first))
    assert _read(path, "first") is None, "the later writer has removed its file"
    assert [*_read(path, "second")] == second
    assert [*tmp_path.iterdir()] == [path]


def test_scenes_take_no_memory_each_while_they_are_listed(
    tmp_path: Path, configured: Callable[..., Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither when the sources are read nor when the cache is: a unit of a house takes 5 to 10 KB."""
    monkeypatch.setattr(jobs.listing, "FILES", 64)
    make_samples(tmp_path / "made", family="procthor", scenes=2, seed=3)
    houses = gzip.decompress((tmp_path / "made" / "houses.jsonl.gz").read_bytes()).splitlines(keepends=True)

    def peaks(number: int) -> list[int]:
        root = tmp_path / str(number)
        shutil.copytree(tmp_path / "made", root)
        (root / "houses.jsonl.gz").write_bytes(gzip.compress(b"".join(houses * (number // 2))))
        settle(root)
        config = configured(root, sources=(SourceConfig(family="procthor", root=root),), name=f"listed-{number}")
        found = []
        for _ in range(2):
            gc.collect()
            tracemalloc.start()
            try:
                assert len(listed_units(config)) == number
                found.append(tracemalloc.get_traced_memory()[1])
            finally:
                tracemalloc.stop()
        return found

    peaks(20)
    few, many = peaks(100), peaks(400)
    grown = [(after - before) / 300 for before, after in zip(few, many, strict=True)]
    assert max(grown) < 1000, grown


def test_a_list_that_can_not_be_kept_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "read-only")

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    _write(tmp_path / "list.json", "first", UnitList())
    assert not [*tmp_path.iterdir()]


def test_any_change_lists_again(config: Config, dataset: Path, listings: list[int]) -> None:
    scene = dataset / "configs" / "scenes" / "made_001.scene_instance.json"
    listed_units(config)
    # Other bytes of the same size, another time.
    document = json.loads(scene.read_text())
    document["object_instances"].pop()
    text = json.dumps(document)
    scene.write_text(text.ljust(scene.stat().st_size))
    os.utime(scene, (time.time() - 30, time.time() - 30))
    assert [*listed_units(config)] == list_units(config, hash_file)
    scene.rename(scene.with_suffix(".away"))
    assert len(listed_units(config)) == 1
    scene.with_suffix(".away").rename(scene)
    # The memory holds one state, and this one is not it.
    assert len(listed_units(config)) == 2
    assert listings == [2, 2, 1, 2]
    # What the units depend on counts; what they don't, does not.
    listed_units(config.model_copy(update={"splits": SplitsConfig(seed=9)}))
    assert len(listings) == 4
    listed_units(config.model_copy(update={"agent": AgentConfig(radius=0.2)}))
    assert len(listings) == 5


def test_a_file_touched_just_now_is_not_trusted(config: Config, dataset: Path, listings: list[int]) -> None:
    settle(dataset, age=0.0)
    listed_units(config)
    listed_units(config)
    assert len(listings) == 2


def test_scenes_that_can_not_be_listed_are_looked_at_every_time(
    config: Config, dataset: Path, listings: list[int]
) -> None:
    scene = dataset / "configs" / "scenes" / "made_001.scene_instance.json"
    scene.write_bytes(scene.read_bytes()[:100])
    settle(dataset)
    for _ in range(2):
        assert [unit.fault is None for unit in listed_units(config)] == [True, False]
    assert len(listings) == 2


@pytest.mark.parametrize("damage", [b"", b"{", b'{"inputs": 1}', b"null", b"\xff", "cut", "stretched"])
def test_a_damaged_memory_is_none(config: Config, listings: list[int], damage: bytes | str) -> None:
    expected = [*listed_units(config)]
    (memory,) = Path(str(config.store)).glob(".listing-*.json")
    whole = memory.read_bytes().splitlines(keepends=True)
    assert len(whole) == 3
    changed = {"cut": b"".join(whole[:2]), "stretched": b"".join([*whole, whole[2]])}
    memory.write_bytes(changed[damage] if isinstance(damage, str) else damage)
    assert [*listed_units(config)] == expected
    assert len(listings) == 2
