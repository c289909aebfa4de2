"""Integer ids made from hashes, and what becomes of a collision."""

from __future__ import annotations

import hashlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from condvln.episodes.identity import colliding, content_hash, numeric_id

HASHES = st.text("0123456789abcdef", min_size=2, max_size=2)


@given(st.text("0123456789abcdef", min_size=16, max_size=16))
def test_ids_are_whole_numbers_that_every_reader_keeps(name: str) -> None:
    number = numeric_id(name)
    assert 0 <= number < 2**53
    assert number == int(hashlib.sha256(name.encode()).hexdigest()[:13], 16)
    assert int(float(number)) == number


def test_an_id_follows_from_scene_instruction_and_pose_alone() -> None:
    start = np.array([1.0, 0.0, -2.0])
    one = content_hash("a", "i", start, 0.5)
    assert one == content_hash("a", "i", start + 1e-5, 0.5 + 1e-8), "positions are told to the millimetre"
    others = {
        content_hash("b", "i", start, 0.5),
        content_hash("a", "j", start, 0.5),
        content_hash("a", "i", start + 0.001, 0.5),
        content_hash("a", "i", start, 0.6),
    }
    assert len(others | {one}) == 5


@given(st.lists(st.tuples(st.integers(0, 5), HASHES), max_size=30))
def test_of_each_id_the_smallest_hash_stays(rows: list[tuple[int, str]]) -> None:
    ids, hashes = [row[0] for row in rows], [row[1] for row in rows]
    lost = colliding(ids, hashes)
    assert lost == [k for k, (number, name) in enumerate(rows) if name > min(h for i, h in rows if i == number)]
