"""Chunks of data: exact content, stable bytes, and nothing in them that a browser could read as code."""

from __future__ import annotations

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from condvln.explorer.site import chunk_bytes
from tests.site_chunks import chunk_content

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = (
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False) | TEXT
)
VALUES = st.recursive(
    PLAIN, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4), max_leaves=12
)


@given(VALUES)
def test_what_is_written_is_read(document: Any) -> None:
    data = chunk_bytes("episodes-7", document)
    assert chunk_content(data) == ("episodes-7", document)
    assert data == chunk_bytes("episodes-7", document)


@given(TEXT)
def test_no_text_ends_the_script(text: str) -> None:
    data = chunk_bytes("index", [text, "</script><script>alert(1)</script>", '"); alert(1); ("'])
    assert re.fullmatch(rb'explorer\.receive\("index", "[A-Za-z0-9+/=]+"\);\n', data)


@pytest.mark.parametrize("name", ["", "../index", "index.js", "a b", 'x"', "Index"])
def test_a_chunk_has_a_plain_name(name: str) -> None:
    with pytest.raises(ValueError, match="name of a chunk"):
        chunk_bytes(name, 1)


@pytest.mark.parametrize("data", [b"", b"alert(1)", b'explorer.receive("index", "AAAA");\nalert(1)\n'])
def test_anything_else_is_not_a_chunk(data: bytes) -> None:
    with pytest.raises(ValueError, match="not a chunk"):
        chunk_content(data)
