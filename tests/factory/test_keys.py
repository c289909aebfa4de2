"""A key changes if and only if something it covers changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pyarrow as pa
import pytest
import toys
from hypothesis import given
from hypothesis import strategies as st

from factory.chain import Keyer
from factory.pipeline import Pipeline, TableSpec
from factory.stage import InputFile, Unit
from schemas.canonical import canonical_json, digest
from schemas.errors import UsageError

names = st.text(st.characters(codec="utf-8", exclude_characters="/\0"), min_size=1, max_size=8)
files = st.builds(InputFile, names, st.integers(0, 2**40), st.text("0123456789abcdef", min_size=64, max_size=64))
inputs = st.lists(files, max_size=4, unique_by=lambda file: file.path).map(tuple)
units = st.builds(
    Unit,
    unit_id=names,
    partition=st.sampled_from(["a", "b"]),
    inputs=inputs,
    payload=st.dictionaries(names, st.integers(), max_size=2),
    costs=st.just({"count": 1.0}),
    memory=st.integers(0, 2**32),
)
hashes = st.text("0123456789abcdef", min_size=32, max_size=32)
json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)


def keyed(unit: Unit) -> Any:
    """All of a unit that its keys may depend on."""
    return unit.unit_id, sorted((file.path, file.size, file.sha256) for file in unit.inputs)


@given(units, units)
def test_the_first_key_changes_iff_an_input_does(one: Unit, two: Unit) -> None:
    keyer = Keyer(toys.pipeline())
    equal = keyer.key(one, 0, {}, None).key == keyer.key(two, 0, {}, None).key
    assert equal == (keyed(one) == keyed(two))


@given(units, st.randoms())
def test_order_of_files_payload_cost_and_memory_are_not_keyed(unit: Unit, random: Any) -> None:
    shuffled = list(unit.inputs)
    random.shuffle(shuffled)
    other = replace(unit, inputs=tuple(shuffled), payload={"else": 1}, costs={"count": 3.0}, memory=5, partition="c")
    keyer = Keyer(toys.pipeline())
    assert keyer.key(unit, 0, {}, None) == keyer.key(other, 0, {}, None)


@given(units, st.sampled_from(["path", "size", "sha256"]), st.data())
def test_every_field_of_an_input_counts(unit: Unit, field: str, data: st.DataObject) -> None:
    if not unit.inputs:
        return
    at = data.draw(st.integers(0, len(unit.inputs) - 1))
    old = unit.inputs[at]
    new = replace(old, **{field: getattr(old, field) + (1 if field == "size" else "0")})
    changed = replace(unit, inputs=(*unit.inputs[:at], new, *unit.inputs[at + 1 :]))
    keyer = Keyer(toys.pipeline())
    before, after = keyer.key(unit, 0, {}, None), keyer.key(changed, 0, {}, None)
    assert before.key != after.key
    assert (before.code, before.parameters, before.dependencies) == (after.code, after.parameters, after.dependencies)
    assert before.inputs != after.inputs
    assert keyer.fingerprint(unit, {}) != keyer.fingerprint(changed, {})


@given(hashes, hashes, json, json)
def test_a_later_key_changes_iff_its_rows_or_dependencies_do(one: str, two: str, this: Any, that: Any) -> None:
    keyer, unit = Keyer(toys.pipeline()), toys.unit("a/x")
    first = keyer.key(unit, 1, {"numbers": one}, this)
    second = keyer.key(unit, 1, {"numbers": two}, that)
    same_depends = canonical_json(this) == canonical_json(that)
    assert (first.key == second.key) == (one == two and same_depends)
    assert (first.inputs == second.inputs) == (one == two)
    assert (first.dependencies == second.dependencies) == same_depends


def test_files_are_not_keyed_behind_the_first_stage_unless_it_reads_them() -> None:
    one, two = toys.unit("a/x", 3), toys.unit("a/x", 4)
    keyer = Keyer(toys.pipeline())
    assert keyer.key(one, 1, {"numbers": "0" * 32}, None) == keyer.key(two, 1, {"numbers": "0" * 32}, None)

    class Reading(toys.Square):
        reads_inputs = True

    reading = Keyer(toys.pipeline(square=Reading()))
    assert reading.key(one, 1, {"numbers": "0" * 32}, None) != reading.key(two, 1, {"numbers": "0" * 32}, None)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (toys.pipeline(count=toys.Count(version=2)), "code"),
        (toys.pipeline(count=toys.Count(modulus=7)), "parameters"),
        (replace(toys.pipeline(), schema_version="2.0"), "code"),
    ],
)
def test_the_part_that_changed_is_named(change: Pipeline, part: str) -> None:
    before = Keyer(toys.pipeline()).key(toys.unit("a/x"), 0, {}, None)
    after = Keyer(change).key(toys.unit("a/x"), 0, {}, None)
    differing = [p for p in ("code", "inputs", "parameters", "dependencies") if getattr(before, p) != getattr(after, p)]
    assert differing == [part]
    assert before.key != after.key


def test_a_changed_schema_is_changed_code_and_a_minor_version_is_not() -> None:
    pipeline = toys.pipeline()
    before = Keyer(pipeline).key(toys.unit("a/x"), 0, {}, None)
    assert Keyer(replace(pipeline, schema_version="1.7")).key(toys.unit("a/x"), 0, {}, None) == before
    wider = TableSpec(toys.NUMBERS.append(pa.field("extra", pa.int8())), ("unit", "n"))
    after = Keyer(replace(pipeline, tables={**pipeline.tables, "numbers": wider})).key(toys.unit("a/x"), 0, {}, None)
    assert before.code != after.code


@given(json, json)
def test_canonical_json_is_equal_iff_the_values_are(one: Any, two: Any) -> None:
    def typed(value: Any) -> Any:
        # In Python 1 == 1.0 == True and 0.0 == -0.0; in a key they are not.
        if isinstance(value, list):
            return [typed(item) for item in value]
        if isinstance(value, dict):
            return {name: typed(item) for name, item in value.items()}
        return (type(value).__name__, repr(value))

    assert (canonical_json(one) == canonical_json(two)) == (typed(one) == typed(two))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), [1, float("-inf")]])
def test_what_is_not_json_is_refused(value: Any) -> None:
    with pytest.raises(ValueError):
        canonical_json(value)
    with pytest.raises(TypeError, match="keys"):
        canonical_json({1: "a"})  # type: ignore[dict-item]
    assert digest({"b": 1, "a": (1, 2)}) == digest({"a": [1, 2], "b": 1})


@pytest.mark.parametrize(
    ("build", "what"),
    [
        (lambda: toys.pipeline(count=toys.Count(name="square")), "two stages"),
        (lambda: toys.pipeline(count=toys.Count(name="../x")), "plain file name"),
        (lambda: toys.pipeline(total=toys.Total(after="word")), "no earlier stage or aggregate provides"),
        (lambda: toys.pipeline(total=toys.Total(after="nothing")), "follows a stage that is not in this pipeline"),
        (lambda: toys.pipeline(word=toys.Word(reads=("squared",))), "no earlier stage writes"),
        (lambda: replace(toys.pipeline(), stages=()), "no stage"),
        (lambda: replace(toys.pipeline(), tables={"poems": TableSpec(toys.TEXTS, ("unit",))}), "no stage writes"),
        (lambda: replace(toys.pipeline(), tables={"texts": TableSpec(toys.TEXTS, ("id",))}), "sort keys"),
    ],
)
def test_a_pipeline_that_does_not_fit_together_is_refused(build: Any, what: str) -> None:
    with pytest.raises(UsageError, match=what):
        build()
