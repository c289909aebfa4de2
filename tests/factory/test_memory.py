"""A unit that outgrows the memory ceiling is quarantined alone; the limit is as before afterwards."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory import machine
from factory.commits import Commits
from factory.run import run
from factory.store import LocalStore

pytestmark = pytest.mark.skipif(not machine.rss(), reason="the system does not say how much memory a process holds")

MIB = 1 << 20


def state() -> tuple[int, int]:
    return resource.getrlimit(resource.RLIMIT_DATA)


@pytest.mark.parametrize("trouble", ["hog", "request"])
def test_a_unit_beyond_the_ceiling_costs_its_own_result_only(store: LocalStore, trouble: str) -> None:
    """``hog`` grows step by step without end, ``request`` asks for 128 TiB at once."""
    before = state()
    units = [toys.unit("a/bad", 4, trouble=trouble), *toys.units(3)]
    ceiling = machine.rss() + 300 * MIB
    report = run(toys.pipeline(), units, store, memory=ceiling)
    assert (report.exit_code, report.counts["ok"], report.published) == (3, 3, True)
    ((name, failure),) = report.failures
    assert (name, failure.cause, failure.exception, failure.attempts) == ("a/bad", "memory", "MemoryCeilingError", 1)
    assert f"the ceiling of {ceiling / 2**30:.2f} GiB" in failure.message
    assert "ray.memory_gib" in failure.message
    record = Commits(store).quarantine_record(failure.stage, failure.key.hex())
    assert "in misbehave" in record.traceback
    assert 0 < record.peak_rss < ceiling + 64 * MIB
    assert state() == before


def test_what_the_unit_held_is_given_back(store: LocalStore) -> None:
    held = machine.rss()
    run(toys.pipeline(), [toys.unit("a/bad", 4, trouble="hog")], store, memory=held + 300 * MIB)
    assert machine.rss() < held + 150 * MIB


def test_a_higher_ceiling_and_a_retry_let_it_through(store: LocalStore, tmp_path: Path) -> None:
    units = [toys.unit("a/greedy", 4, trouble=f"memory-once:{tmp_path / 'once'}"), *toys.units(2)]
    assert run(toys.pipeline(), units, store).counts["quarantined"] == 1
    assert run(toys.pipeline(), units, store).counts["quarantined"] == 1
    assert run(toys.pipeline(), units, store, retry_quarantined=True).exit_code == 0


@given(total=st.integers(1, 1 << 45), free=st.floats(0, 1), held=st.integers(0, 1 << 33), slots=st.integers(1, 256))
def test_all_workers_together_fit_the_machine(total: int, free: float, held: int, slots: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "memory_total", lambda: total)
        patch.setattr(machine, "memory_available", lambda: int(total * free))
        patch.setattr(machine, "rss", lambda: held)
        found = machine.share(slots)
    assert found is not None
    assert found == machine.LEAST or found * slots <= 0.8 * total
    assert found == machine.LEAST or (found - held) * slots <= 0.8 * int(total * free)


def test_a_system_that_does_not_say_has_no_ceiling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "memory_total", lambda: 0)
    assert machine.share(1) is None


@pytest.mark.parametrize(
    ("line", "folder", "limit_file", "used_file"),
    [
        ("0::/jobs/one", "jobs", "memory.max", "memory.current"),
        ("7:memory:/jobs/one", "memory/jobs", "memory.limit_in_bytes", "memory.usage_in_bytes"),
    ],
)
def test_limits_of_containers_are_seen(tmp_path: Path, line: str, folder: str, limit_file: str, used_file: str) -> None:
    """Of every group around the process; a group without limit says so with a word."""
    (tmp_path / "cgroup").write_text(f"3:cpu:/elsewhere\n{line}\n")
    group = tmp_path / "mounted" / folder
    (group / "one").mkdir(parents=True)
    for place, limit in ((group, "5000"), (group / "one", "max")):
        (place / limit_file).write_text(f"{limit}\n")
        (place / used_file).write_text("1200\n")
    assert [*machine.container_limits(tmp_path / "cgroup", tmp_path / "mounted")] == [(5000, 1200)]
