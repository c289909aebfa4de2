"""Pictures of scenes without textures: shaded by the surfaces' directions; textured ones are left as they are."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.explorer.views import UNSEEN, _light, shaded
from condvln.sensors.renderer import Frame


def frame(rgb: int, depth: np.ndarray) -> Frame:
    none = np.zeros(depth.shape, np.int32)
    return Frame(np.full((*depth.shape, 3), rgb, np.uint8), depth.astype(np.float32), none, np.ones_like(none))


def plane(normal: tuple[float, float, float], size: int = 40) -> np.ndarray:
    """Depth of a plane 3 m ahead as a camera of 90° sees it; the normal is right, down, ahead."""
    off = (np.arange(size) - (size - 1) / 2) / (size / 2)
    return 3 * normal[2] / (normal[0] * off[None, :] + normal[1] * off[:, None] + normal[2])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, 0.0, 0.9), (0.0, 0.4, 0.9), (-0.2, 0.3, 0.8)])
def test_a_plane_has_one_brightness_that_follows_from_its_normal(normal: tuple[float, float, float]) -> None:
    light = _light(plane(normal), 90.0)
    unit = np.array(normal) / np.linalg.norm(normal)
    assert light == pytest.approx(0.55 + 0.45 * abs(unit @ [0.35, -0.75, 0.56]), abs=1e-6)


def test_white_surfaces_get_colour_and_others_keep_theirs() -> None:
    depth = plane((0.3, 0.0, 0.9))
    depth[:3] = 0
    plain = shaded(frame(255, depth), ("sofa",), 90.0)
    assert np.all(plain[:3] == UNSEEN)
    assert np.all(plain[5:] < 255)
    textured = shaded(frame(120, depth), ("sofa",), 90.0)
    assert np.all(textured[3:] == 120)
