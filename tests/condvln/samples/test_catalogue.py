"""The catalogue's rows and shapes keep the promises that layouts and writers build on."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.labels import vocabulary
from condvln.samples.catalogue import catalogue
from condvln.samples.models import part_boxes, shapes


@pytest.mark.parametrize("family", ["replicacad", "procthor", "gibson", "mp3d"])
def test_every_label_is_known_and_fit_for_text(family: str) -> None:
    for kind in catalogue().values():
        assert vocabulary.is_mapped(kind.label, family), kind.label
        assert vocabulary.fit_for_text(vocabulary.canonical(kind.label, family)), kind.label


@pytest.mark.parametrize("shape", sorted(shapes()))
def test_a_shape_fills_its_box_and_no_more(shape: str) -> None:
    size = (0.8, 1.5, 0.5)
    boxes = part_boxes(shape, size)
    assert (boxes[:, 0] < boxes[:, 1]).all()
    np.testing.assert_allclose(boxes[:, 0].min(axis=0), -np.array(size) / 2, atol=1e-12)
    np.testing.assert_allclose(boxes[:, 1].max(axis=0), np.array(size) / 2, atol=1e-12)
