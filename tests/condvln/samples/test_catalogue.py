"""The catalogue's rows and shapes keep the promises that layouts and writers build on."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.labels import vocabulary
from condvln.samples.catalogue import VARIANTS, catalogue
from condvln.samples.furnishing import ROW, recipes
from condvln.samples.shapes import SHAPES, part_boxes
from condvln.samples.spots import SPOTS


def test_half_sizes_are_whole_millimetres_and_turned_ones_multiples_of_25() -> None:
    for kind in catalogue().values():
        assert len(kind.sizes) == VARIANTS
        for size in kind.sizes:
            assert all(v > 0 and v % 2 == 0 for v in size), kind
            assert not kind.turns or (size[0] % 50 == 0 and size[2] % 50 == 0), kind


@pytest.mark.parametrize("family", ["replicacad", "procthor", "gibson", "mp3d"])
def test_every_label_is_known_and_fit_for_text(family: str) -> None:
    for kind in catalogue().values():
        assert vocabulary.is_mapped(kind.label, family), kind.label
        assert vocabulary.fit_for_text(vocabulary.canonical(kind.label, family)), kind.label


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_a_shape_fills_its_box_and_no_more(shape: str) -> None:
    size = (0.8, 1.5, 0.5)
    boxes = part_boxes(shape, size)
    assert (boxes[:, 0] < boxes[:, 1]).all()
    np.testing.assert_allclose(boxes[:, 0].min(axis=0), -np.array(size) / 2, atol=1e-12)
    np.testing.assert_allclose(boxes[:, 1].max(axis=0), np.array(size) / 2, atol=1e-12)


def test_pieces_that_turn_have_a_part_as_wide_as_their_box() -> None:
    """So the box of the turned mesh is the box of the turned box."""
    for kind in catalogue().values():
        if kind.turns:
            assert any((p.x0, p.x1, p.z0, p.z1) == (0, 1, 0, 1) for p in SHAPES[kind.shape]), kind


def test_recipes_use_the_whole_catalogue_and_name_nothing_else() -> None:
    steps = [step for recipe in recipes().values() for step in (*recipe.first, *recipe.then)]
    assert {kind for step in steps for kind in step.kinds} == set(catalogue())
    assert {kind for step in steps for kind in (*step.anchor, *step.unless)} <= set(catalogue())
    assert {step.at for step in steps} == {*SPOTS, ROW}
    for step in steps:
        hung = {catalogue()[kind].hang is not None for kind in step.kinds}
        assert hung == {step.at in ("hung", "above")}, step
        assert 1 <= step.count[0] <= step.count[1]
        assert 0 < step.chance <= 1
