"""The error tree: one message form, exit codes, and a safe crossing of process borders."""

from __future__ import annotations

import pickle

import pytest

from schemas import errors
from schemas.errors import CondVLNError, FormatError, shown_path

KINDS = [kind for name in errors.__all__ if isinstance(kind := getattr(errors, name), type)]


@pytest.mark.parametrize("kind", KINDS)
def test_pickles_whole(kind: type[CondVLNError]) -> None:
    error = kind("what is wrong", where="a/b.json", place="rooms[3].label", remedy="Do this.")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error) == "a/b.json: rooms[3].label: what is wrong. Do this."
    assert again.exit_code == error.exit_code


@pytest.mark.parametrize(
    ("kind", "code"),
    [("UsageError", 1), ("StoreError", 1), ("InputError", 3), ("ProofError", 3), ("FailureBudgetError", 4)],
)
def test_exit_codes_are_those_of_the_command(kind: str, code: int) -> None:
    family = [k for k in KINDS if issubclass(k, getattr(errors, kind))]
    assert {k.exit_code for k in family} == {code}


def test_message_without_a_place() -> None:
    assert str(FormatError("odd")) == "odd"


def test_all_is_sorted_and_whole() -> None:
    defined = {n for n, v in vars(errors).items() if isinstance(v, type) and issubclass(v, CondVLNError)}
    assert sorted(defined | {"shown_path"}) == list(errors.__all__)
    for name in defined:
        assert name in (errors.__doc__ or "")


def test_a_name_that_is_not_utf_8_is_shown_by_its_bytes() -> None:
    assert shown_path("a/ü.json") == "a/ü.json"
    assert shown_path("a/\udcff.json") == r"a/\xff.json"
    assert shown_path("\ud800") == r"\ud800"
    assert str(FormatError("not JSON", where="a/\udcff.json")) == r"a/\xff.json: not JSON"
