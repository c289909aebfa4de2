"""A changed output under an unchanged version is found, and nothing else is taken for it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pyarrow as pa
import pytest
import toys

from factory.stage import StageOutput, Unit
from schemas.errors import ProofError
from tests.fingerprint import ALL_UNITS, compare, fingerprints


@dataclass(frozen=True)
class Louder(toys.Word):
    """The word stage after a change of its code."""

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        output = super().run(unit, upstream, shared)
        loud = [text.upper() for text in output.tables["texts"]["text"].to_pylist()]
        output.tables["texts"] = pa.table({"unit": [unit.unit_id], "text": loud}, schema=toys.TEXTS)
        return output


@dataclass(frozen=True)
class OneMore(toys.Total):
    """The aggregate after a change of its code."""

    def build(self, tables: Iterator[tuple[str, Mapping[str, pa.Table]]]) -> pa.Table:
        return pa.table({"total": [1 + super().build(tables)["total"][0].as_py()]})


def test_a_changed_aggregate_without_a_new_version_is_named() -> None:
    golden = json.loads(json.dumps(fingerprints(toys.pipeline(), toys.units(3))))
    forgotten = compare(golden, fingerprints(toys.pipeline(total=OneMore()), toys.units(3)))
    assert f"{ALL_UNITS}: total" in forgotten.unbumped
    raised = compare(golden, fingerprints(toys.pipeline(total=OneMore(version=2)), toys.units(3)))
    assert f"{ALL_UNITS}: total" not in raised.unbumped
    assert f"{ALL_UNITS}: total" in raised.outdated
    followed = compare(golden, fingerprints(toys.pipeline(), toys.units(4)))
    assert f"{ALL_UNITS}: total" in followed.outdated, "other inputs, other rows"
    assert followed.unbumped == ()


def test_a_change_without_a_new_version_is_named() -> None:
    golden = json.loads(json.dumps(fingerprints(toys.pipeline(), toys.units(3))))
    again = fingerprints(toys.pipeline(), toys.units(3))
    assert compare(golden, again).unbumped == compare(golden, again).outdated == ()
    forgotten = compare(golden, fingerprints(toys.pipeline(word=Louder()), toys.units(3)))
    assert forgotten.unbumped == tuple(f"{unit.unit_id}: word" for unit in toys.units(3)[::2] + toys.units(3)[1::2])
    assert forgotten.outdated == ()
    raised = compare(golden, fingerprints(toys.pipeline(word=Louder(version=2)), toys.units(3)))
    assert raised.unbumped == ()
    assert raised.outdated == forgotten.unbumped


def test_what_follows_from_an_upstream_change_is_not_blamed_on_the_stage_behind() -> None:
    golden = fingerprints(toys.pipeline(), toys.units(3))
    found = fingerprints(toys.pipeline(square=toys.Square(power=3.0)), toys.units(3))
    assert compare(golden, found).unbumped == ()
    assert {"a/u00002: square", "a/u00002: word"} <= set(compare(golden, found).outdated)


def test_a_golden_corpus_that_fails_says_so() -> None:
    with pytest.raises(ProofError, match="a/bad failed in count"):
        fingerprints(toys.pipeline(), [toys.unit("a/bad", trouble="error")])
