"""JSON from outside: what is refused, and that nothing else than our error comes out."""

from __future__ import annotations

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.formats.json_document import MAX_DEPTH, JsonNode, nesting_depth, parse_json
from schemas.errors import FormatError

documents = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**50), 2**50)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(blacklist_categories=("Cs",))),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text('abc"\\{[', max_size=4), inner, max_size=4),
    max_leaves=20,
)


@given(documents)
def test_a_sound_document_is_read_as_it_is(document: object) -> None:
    assert parse_json(json.dumps(document).encode(), "f").value == document


@given(st.binary(max_size=60) | st.text('{}[]",:\\0123456789eE+-.NaInfitydu \n', max_size=60).map(str.encode))
def test_any_bytes_give_a_node_or_our_error(data: bytes) -> None:
    with suppress(FormatError):
        assert isinstance(parse_json(data, "f"), JsonNode)


@pytest.mark.parametrize("depth", [10_000, 1_000_000])
@pytest.mark.parametrize(("opening", "closing"), [(b"[", b"]"), (b'{"a":', b"}")])
def test_deep_nesting_is_refused(depth: int, opening: bytes, closing: bytes) -> None:
    for data in (opening * depth + b"1" + closing * depth, opening * depth):
        with pytest.raises(FormatError, match=f"nested more than {MAX_DEPTH} levels deep"):
            parse_json(data, "deep.json")


def test_nesting_is_counted_outside_of_strings_only() -> None:
    text = "[" * 1000 + '"' + "\\" + "{" * 1000
    assert parse_json(json.dumps([text] * 3).encode(), "f").value == [text] * 3
    assert parse_json(b"[" * MAX_DEPTH + b"]" * MAX_DEPTH, "f").value is not None
    with pytest.raises(FormatError, match="levels deep"):
        parse_json(b"[" * (MAX_DEPTH + 1) + b"]" * (MAX_DEPTH + 1), "f")


@given(documents)
def test_depth_is_that_of_a_recursive_count(document: object) -> None:
    def depth(value: object) -> int:
        inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
        return 0 if inside is None else 1 + max(map(depth, inside), default=0)

    assert nesting_depth(document) == depth(document)


def test_an_unclosed_string_of_escapes_is_refused_in_linear_time() -> None:
    with pytest.raises(FormatError):
        parse_json(b"[" * 70 + b'"\\' * 2_000_000, "f")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b'{"a": 1, "a": 1}', "'a' occurs twice"),
        (b'{"x": {"a": 1, "b": 2, "a": 3}}', "'a' occurs twice"),
        (b"[NaN]", r"\[0\]: the number NaN is not finite"),
        (b'{"a": -Infinity}', "a: the number -Infinity is not finite"),
        (b'{"a": ', "line 1 column"),
        (b"", "not JSON"),
        (b"\xff\xfe", "not UTF-8"),
        (b'["\\ud800"]', "surrogate"),
        (b"[" + b"9" * 5000 + b"]", "invalid JSON"),
    ],
)
def test_what_is_refused_and_how(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        parse_json(data, "folder/f.json")
    assert caught.value.where == "folder/f.json"
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("data", "place"),
    [
        (b"1e999", "top level"),
        (b"1" * 230 + b"e99", "top level"),
        (b"1" * 400 + b".0", "top level"),
        (b'{"a": {"b": [1, -1e400]}}', r"a\.b\[1\]"),
    ],
)
def test_a_number_that_is_not_finite_is_refused(data: bytes, place: str) -> None:
    with pytest.raises(FormatError, match=f"f.json: {place}: the number .* is not finite"):
        parse_json(data, "f.json")


def test_errors_name_the_place() -> None:
    node = parse_json(b'{"objects": [{"t": [1, 2]}, {"t": [1, 2, "x"]}, {"t": [1e9, 0, 0]}, {"t": [true, 0, 0]}]}', "s")
    second = node["objects"].elements()[1]
    for i, what in ((0, r"objects\[0\].t: 3 numbers are expected, not 2"), (1, r"objects\[1\].t\[2\]: a number")):
        with pytest.raises(FormatError, match=what):
            node["objects"].elements()[i]["t"].vector(3)
    for i in (2, 3):
        with pytest.raises(FormatError, match=rf"objects\[{i}\].t\[0\]"):
            node["objects"].elements()[i]["t"].vector(3)
    with pytest.raises(FormatError, match=r"objects\[1\]: the key 'name' is missing"):
        second["name"]


@pytest.mark.parametrize(
    ("text", "ask"),
    [
        ("1", "text"),
        ("null", "text"),
        ("[]", "object"),
        ("{}", "elements"),
        ('"1"', "integer"),
        ("1.5", "integer"),
        ("true", "integer"),
        ("1e300", "integer"),
        ("true", "number"),
        ("1e6", "number"),
        ("1", "boolean"),
    ],
)
def test_a_wrong_type_is_refused(text: str, ask: str) -> None:
    node = parse_json(text.encode(), "f")
    with pytest.raises(FormatError, match="top level"):
        getattr(node, ask)()


def test_an_index_is_among_what_it_counts() -> None:
    node = parse_json(b'{"at": [0, 2, 3, -1]}', "f")
    first, second, *outside = node.array("at")
    assert (first.index(3), second.index(3)) == (0, 2)
    for wrong in outside:
        with pytest.raises(FormatError, match=f"at.*the index {wrong.value} is out of range: there are 3 entries"):
            wrong.index(3)


def test_null_counts_as_absent_for_optional_members_only() -> None:
    node = parse_json(b'{"a": null}', "f")
    assert node.get("a") is None
    assert node.get("b") is None
    assert node.array("a") == node.array("b") == []
    with pytest.raises(FormatError, match="a: text is expected, not null"):
        node["a"].text()
