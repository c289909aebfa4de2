"""A changed output under an unchanged version is found, and nothing else is taken for it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import pyarrow as pa
import toys

from factory.stage import StageOutput, Unit
from tests.fingerprint import compare, fingerprints


@dataclass(frozen=True)
class Louder(toys.Word):
    """The word stage after a change of its code."""

    def run(self, unit: Unit, upstream: Mapping[str, pa.Table], shared: Mapping[str, pa.Table]) -> StageOutput:
        output = super().run(unit, upstream, shared)
        loud = [text.upper() for text in output.tables["texts"]["text"].to_pylist()]
        output.tables["texts"] = pa.table({"unit": [unit.unit_id], "text": loud}, schema=toys.TEXTS)
        return output


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
