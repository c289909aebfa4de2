"""Broken bytes anywhere in a scene dataset: a scene or one of our errors, naming a file of the dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from condvln.scene.tables import scene_tables
from schemas.errors import CondVLNError, ConfigError, InputError

TOKENS = [
    b"-1",
    b"1e999",
    b"null",
    b"true",
    b"{}",
    b"[]",
    b'""',
    b'"../../x"',
    b"NaN",
    b"0",
    b"9" * 30,
    b"\\ud800",
    b"\0",
]


@pytest.fixture
def files(made: Any) -> dict[Path, bytes]:
    made.lexicon(
        [("table", 1), ("chair", 2)],
        region_annotations=[
            {"name": "a", "label": "kitchen", "poly_loop": [[0, 0, 0], [6, 0, 0], [6, 0, 4], [0, 0, 4]]},
        ],
    )
    return {path: path.read_bytes() for path in sorted(made.root.rglob("*")) if path.is_file()}


def _mutated(data: st.DataObject, sound: bytes) -> bytes:
    bad = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(len(bad) - 1, 0)))
        size = data.draw(st.integers(0, 6))
        bad[at : at + size] = data.draw(st.sampled_from(TOKENS) | st.binary(max_size=4))
    return bytes(bad[: data.draw(st.sampled_from([len(bad)] * 4 + [len(bad) // 2]))])


def _check(made: Any, files: dict[Path, bytes], data: st.DataObject) -> None:
    victim = data.draw(st.sampled_from(sorted(files)))
    victim.write_bytes(_mutated(data, files[victim]))
    refused: CondVLNError | None = None
    try:
        for handle in made.source().handles():
            scene = made.source().read(handle.scene_id)
            assert all(np.isfinite(o.center).all() for o in scene.objects)
            scene_tables(scene)
    except (InputError, ConfigError) as error:
        refused = error
    finally:
        victim.write_bytes(files[victim])
    if refused is not None:
        assert str(made.root) in refused.where
        assert refused.remedy


@pytest.mark.costly
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_scene_or_our_error(made: Any, files: dict[Path, bytes], data: st.DataObject) -> None:
    _check(made, files, data)


@pytest.mark.soak
@settings(max_examples=5000, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_broken_bytes_at_full_count(made: Any, files: dict[Path, bytes], data: st.DataObject) -> None:
    _check(made, files, data)
