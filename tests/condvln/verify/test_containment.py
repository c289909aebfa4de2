"""What the verifier finds shut away is what the scene says, by two programs that share no code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from condvln.scene import OrientedBox, SceneObject, round_mm
from condvln.scene.containment import with_containment
from condvln.sources.registry import open_source
from condvln.verify.containment import shut_away
from condvln.verify.words import words

LABELS = ("refrigerator", "box", "bowl", "sink", "table", "egg", "wall", "drawer", "dresser", "television stand")


@st.composite
def objects(draw: st.DrawFn) -> list[SceneObject]:
    made = []
    for k in range(draw(st.integers(1, 7))):
        low = np.array(draw(st.tuples(*[st.integers(0, 12)] * 3))) / 10
        size = np.array(draw(st.tuples(*[st.integers(0, 9)] * 3))) / 10
        box = round_mm([low, low + size])
        halves = [box.copy(), box.copy()]
        halves[0][1, 0] = halves[1][0, 2] = low[0] + size[0] / 2
        said = draw(st.none() | st.lists(st.integers(0, 7).map(lambda n: f"o{n}"), max_size=2).map(tuple))
        label = draw(st.sampled_from(LABELS))
        parts = [OrientedBox(h.mean(axis=0), (h[1] - h[0]).clip(0) / 2, np.eye(3)) for h in halves]
        made.append(
            SceneObject(
                f"o{k}",
                draw(st.sampled_from("ab")) if k else "a",
                label,
                label,
                box.mean(axis=0),
                aabb=draw(st.sampled_from([box, box, box, None])),
                parts=tuple(parts) if draw(st.booleans()) else (),
                receptacles=said,
                openness=draw(st.none() | st.sampled_from([0.0, 0.49, 0.5, 1.0])),
            )
        )
    return made


@settings(max_examples=400)
@given(objects())
def test_generator_and_verifier_agree(made: list[SceneObject]) -> None:
    hidden = {o.object_id for o in with_containment(made, "procthor") if o.hidden}
    assert shut_away(made, "procthor", lambda item: item.raw_label, words()) == hidden


def test_what_a_scanner_saw_is_not_shut_away() -> None:
    boxes = [np.array([[0, 0, 0], [1, 1, 1.0]]), np.array([[0.2, 0.2, 0.2], [0.4, 0.4, 0.4]])]
    made = [SceneObject(x, "a", x, x, b.mean(axis=0), aabb=b) for x, b in zip(("safe", "egg"), boxes, strict=True)]
    assert shut_away(made, "mp3d", lambda item: item.raw_label, words()) == frozenset()
    assert shut_away(made, "replicacad", lambda item: item.raw_label, words()) == {"egg"}


@pytest.mark.parametrize("family", ["procthor", "ithor", "replicacad"])
def test_they_agree_on_real_scenes(real_data: Path, family: str) -> None:
    source, seen = open_source(family, real_data / family), 0
    for handle in source.handles()[:12]:
        scene = source.read(handle.scene_id)
        hidden = {o.object_id for o in scene.objects if o.hidden}
        assert shut_away(scene.objects, family, lambda item: item.label, words()) == hidden
        seen += len(hidden)
    assert seen > 0
