"""Python's garbage collector: off during a unit, run after it."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator

import pytest

from factory.garbage import MANY, collected_between_units


class Cyclic:
    """An object that refers to itself, so that only a collection frees it."""

    def __init__(self) -> None:
        self.own = self


@pytest.fixture(autouse=True)
def _no_freeze(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(gc, "freeze", lambda: None)
    assert gc.isenabled()
    yield
    assert gc.isenabled()


def test_a_cycle_lives_during_the_unit_and_is_freed_after_it() -> None:
    with collected_between_units():
        seen = weakref.ref(Cyclic())
        made = [[] for _ in range(2 * MANY)]
        assert not gc.isenabled()
        assert seen() is not None
    assert seen() is None
    assert len(made) == 2 * MANY


def test_a_unit_of_few_objects_is_not_followed_by_a_collection() -> None:
    gc.collect()
    with collected_between_units():
        seen = weakref.ref(Cyclic())
    assert seen() is not None


def test_it_is_on_again_after_an_error() -> None:
    with pytest.raises(KeyError), collected_between_units():
        raise KeyError


def test_it_stays_off_where_the_caller_switched_it_off() -> None:
    gc.disable()
    try:
        with collected_between_units():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_it_is_on_again_after_a_signal_during_the_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    def ended() -> None:
        raise SystemExit

    monkeypatch.setattr(gc, "collect", ended)
    with pytest.raises(SystemExit), collected_between_units():
        made = [[] for _ in range(2 * MANY)]
    assert len(made) == 2 * MANY
    assert gc.isenabled()
