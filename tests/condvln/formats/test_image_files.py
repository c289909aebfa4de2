"""Images in memory as files: Pillow, another implementation, decodes them to the same pixels."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from condvln.formats.image_files import jpeg, png16

DEPTHS = arrays(
    np.float32,
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    elements=st.floats(0, 100, width=32) | st.just(np.float32(np.inf)),
)


@given(DEPTHS, st.integers(0, 3))
def test_depth_is_stored_in_whole_millimetres(depth: np.ndarray, level: int) -> None:
    with Image.open(io.BytesIO(png16(depth, level))) as image:
        image.load()
        assert image.mode == "I;16"
        found = np.asarray(image)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, np.minimum(np.rint(depth * np.float32(1000)), 65535))


@pytest.mark.parametrize("quality", [30, 75, 90, 100])
def test_colours_are_as_good_as_pillow_s(quality: int) -> None:
    """Tables, sampling and size are those of Pillow, and so is the error of a smooth picture and of noise."""
    draw = np.random.default_rng(quality)
    ramp = np.linspace(0, 255, 64 * 48 * 3).reshape(48, 64, 3).astype(np.uint8)
    for picture in (ramp, draw.integers(0, 256, (48, 64, 3), dtype=np.uint8)):
        stream = io.BytesIO()
        Image.fromarray(picture).save(stream, "JPEG", quality=quality)
        with Image.open(stream) as theirs, Image.open(io.BytesIO(jpeg(picture, quality))) as ours:
            assert ours.layers == theirs.layers == 3  # type: ignore[attr-defined]
            assert [layer[1:3] for layer in ours.layer] == [layer[1:3] for layer in theirs.layer]  # type: ignore[attr-defined]
            assert ours.quantization == theirs.quantization  # type: ignore[attr-defined]
            errors = [np.square(np.asarray(image, float) - picture).mean() for image in (ours, theirs)]
        assert errors[0] == pytest.approx(errors[1], rel=0.05, abs=0.05)


def test_a_view_of_a_larger_array_is_written_like_a_copy() -> None:
    whole = np.random.default_rng(0).integers(0, 256, (20, 30, 4), dtype=np.uint8)
    assert jpeg(whole[2:18, ::2, :3], 90) == jpeg(whole[2:18, ::2, :3].copy(), 90)
    depth = np.random.default_rng(0).uniform(0, 9, (20, 30)).astype(np.float32)
    assert png16(depth[::2, 3:], 1) == png16(depth[::2, 3:].copy(), 1)
