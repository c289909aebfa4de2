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
from tests.broken_bytes import broken

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


@pytest.mark.rounds(10)
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_broken_bytes_give_a_scene_or_our_error(made: Any, files: dict[Path, bytes], data: st.DataObject) -> None:
    victim = data.draw(st.sampled_from(sorted(files)))
    bad = broken(data, files[victim], TOKENS)
    victim.write_bytes(bad[: data.draw(st.sampled_from([len(bad)] * 4 + [len(bad) // 2]))])
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
