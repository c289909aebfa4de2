"""Pictures of scenes without textures: shaded by the surfaces' directions; textured ones are left as they are."""

from __future__ import annotations

import numpy as np
import pytest

from condvln.sensors.renderer import Frame
from condvln.sensors.shading import UNSEEN, _normals, shaded


def frame(rgb: int, depth: np.ndarray) -> Frame:
    none = np.zeros(depth.shape, np.int32)
    return Frame(np.full((*depth.shape, 3), rgb, np.uint8), depth.astype(np.float32), none, np.ones_like(none))


def plane(normal: tuple[float, float, float], size: int = 40) -> np.ndarray:
    """Depth of a plane 3 m ahead as a camera of 90° sees it; the normal is right, down, ahead."""
    off = (np.arange(size) - (size - 1) / 2) / (size / 2)
    return 3 * normal[2] / (normal[0] * off[None, :] + normal[1] * off[:, None] + normal[2])


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, 0.0, 0.9), (0.0, 0.4, 0.9), (-0.2, 0.3, 0.8)])
def test_a_plane_has_one_normal(normal: tuple[float, float, float]) -> None:
    found = _normals(plane(normal), 90.0)
    assert found == pytest.approx(np.broadcast_to(np.array(normal) / np.linalg.norm(normal), found.shape), abs=1e-6)


def test_even_surfaces_get_the_colours_of_their_labels_and_textured_ones_keep_theirs() -> None:
    depth = plane((0.3, 0.0, 0.9))
    depth[:3] = 0
    plain = shaded(frame(255, depth), ("sofa",), 90.0)
    assert np.all(plain[:3] == UNSEEN)
    assert np.all(plain[5:] < 255)
    textured = frame(120, depth)
    textured.rgb[:] = np.random.default_rng(0).integers(0, 250, textured.rgb.shape)
    assert np.all(shaded(textured, ("sofa",), 90.0)[3:] == textured.rgb[3:])


def test_an_unnamed_surface_is_floor_wall_or_ceiling_by_its_direction() -> None:
    for normal, label in (((0.0, 0.95, 0.2), "floor"), ((0.0, 0.0, 1.0), "wall"), ((0.0, -0.95, 0.2), "ceiling")):
        shown = [frame(120, plane(normal)) for _ in range(2)]
        shown[1].label[:] = 0
        named, unnamed = (shaded(one, (label,), 90.0)[20, 20] for one in shown)
        assert np.array_equal(named, unnamed), label


def test_floor_wall_and_ceiling_are_told_apart_whatever_colour_the_mesh_has() -> None:
    depth = plane((0.0, 0.0, 1.0))
    seen = [shaded(frame(120, depth), (label,), 90.0)[20, 20].astype(int) for label in ("floor", "wall", "ceiling")]
    assert min(np.abs(a - b).max() for k, a in enumerate(seen) for b in seen[:k]) > 20
