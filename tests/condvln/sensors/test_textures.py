"""Materials of GLB files: what a camera straight before a textured square sees is the image itself."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from condvln.formats.glb_part import read_part
from condvln.scene import MeshPart, Scene
from condvln.sensors.assembly import drawn_file, scene_surfaces
from condvln.sensors.renderer import Renderer
from condvln.sensors.surfaces import SurfaceBuilder
from condvln.sensors.textures import MAX_BYTES, allowed_edge, read_picture
from schemas.config import CameraConfig
from tests.condvln.sensors.glb_pictures import encoded, square_glb
from tests.condvln.sensors.ktx2_pictures import ETC1S_64, UASTC_16

Bytes = NDArray[np.uint8]


# Red grows to the right, green downwards, blue marks the upper left quarter.
def pattern(size: int) -> Bytes:
    image = np.zeros((size, size, 3), np.uint8)
    image[..., 0] = 256 // size * np.arange(size)
    image[..., 1] = 256 // size * np.arange(size)[:, None]
    image[: size // 2, : size // 2, 2] = 200
    return image


IMAGE: Bytes = pattern(64)


def seen(glb: bytes, size: int = 64, distance: float = 1.0) -> Bytes:
    """What a camera on the +Z axis sees of it; at distance 1 the square fills the image."""
    builder = SurfaceBuilder()
    file = drawn_file(read_part(glb, "square.glb"), builder)
    file.place(builder, 0, np.eye(4))
    camera = CameraConfig(width=size, height=size, hfov=90.0, eye_height=0.0)
    return Renderer(builder.surfaces()).look(camera, [0, 0, distance]).rgb


@pytest.mark.parametrize(("kind", "mime"), [("PNG", "image/png"), ("WEBP", "image/webp")])
def test_the_image_is_seen_as_it_is(kind: str, mime: str) -> None:
    image = encoded(IMAGE, kind)
    texture = {"extensions": {"EXT_texture_webp": {"source": 0}}} if kind == "WEBP" else None
    np.testing.assert_array_equal(seen(square_glb(image, mime, texture=texture)), IMAGE)
    np.testing.assert_array_equal(seen(square_glb(image, mime, texture=texture, strip=True)), IMAGE)


@pytest.mark.parametrize(
    ("image", "size", "mean", "most"), [(UASTC_16, 16, 0.5, 2), (ETC1S_64, 64, 3.0, 15)], ids=["uastc", "etc1s"]
)
def test_a_ktx2_image_is_seen_about_as_it_is(image: bytes, size: int, mean: float, most: int) -> None:
    pytest.importorskip("opengl_basisu", reason="the extra ktx2 is absent")
    glb = square_glb(image, "image/ktx2", texture={"extensions": {"KHR_texture_basisu": {"source": 0}}})
    difference = np.abs(seen(glb, size).astype(int) - pattern(size))
    assert difference.mean() < mean
    assert difference.max() <= most
    levels = read_picture(image, "image/ktx2", size // 2)
    assert levels[0].shape == (size // 2, size // 2, 3)


def packed(claimed: int) -> bytes:
    """The image UASTC_16 with its level compressed by Zstandard; the header claims a size for the level."""
    offset, length, _ = struct.unpack_from("<3Q", UASTC_16, 80)
    level: bytes = pa.compress(UASTC_16[offset : offset + length], codec="zstd", asbytes=True)
    data = bytearray(UASTC_16[:offset] + level)
    struct.pack_into("<I", data, 44, 2)
    struct.pack_into("<3Q", data, 80, offset, len(level), claimed)
    return bytes(data)


def with_word(place: int, value: int) -> bytes:
    return UASTC_16[:place] + struct.pack("<I", value) + UASTC_16[place + 4 :]


def test_a_ktx2_header_cant_ask_for_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    basisu = pytest.importorskip("opengl_basisu", reason="the extra ktx2 is absent")
    sound, plain = read_picture(packed(256), "image/ktx2"), read_picture(UASTC_16, "image/ktx2")
    np.testing.assert_array_equal(sound[0], plain[0])

    class Opened:
        """What the decoder finds in the sound image; decoding it is a failure of the test."""

        width, height, levels = 16, 16, 1

        def level_size(self, level: int) -> tuple[int, int]:
            return 16, 16

        def transcode(self, target: str, level: int) -> Any:
            raise AssertionError("the level is decoded")

    monkeypatch.setattr(basisu, "open", lambda data: Opened())
    with pytest.raises(AssertionError, match="is decoded"):
        read_picture(packed(256), "image/ktx2")
    layers, faces = with_word(32, 2), with_word(36, 6)
    for image in (packed(257), packed(1 << 30), layers, faces, UASTC_16[:100]):
        assert read_picture(image, "image/ktx2") is None


def test_without_the_extra_a_note_names_the_file_and_what_reads_ktx2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("condvln.sensors.textures.find_spec", lambda name: None)
    glb = square_glb(UASTC_16, "image/ktx2", factor=[1.0, 0.0, 0.0, 1.0])
    assert (seen(glb) == [255, 0, 0]).all()
    (tmp_path / "square.glb").write_bytes(glb)
    part = MeshPart("square.glb", np.eye(4))
    scene = Scene(family="made", scene_id="one", root=tmp_path, rooms=(), objects=(), stage=(part,))
    notes = scene_surfaces(scene, None).notes
    assert any("in square.glb" in note for note in notes)
    assert any("'ktx2'" in note for note in notes)


def test_a_jpeg_is_seen_about_as_it_is() -> None:
    smooth = IMAGE.copy()
    smooth[..., 2] = 0
    difference = seen(square_glb(encoded(smooth, "JPEG"), "image/jpeg")).astype(int) - smooth
    assert np.abs(difference).mean() < 3


def test_factor_and_vertex_colours_multiply_the_image() -> None:
    factor = [0.5, 1.0, 0.25, 1.0]
    np.testing.assert_allclose(seen(square_glb(encoded(IMAGE), factor=factor)), IMAGE * factor[:3], atol=0.51)
    tint = np.array([[255, 0, 128, 255]] * 4, np.uint8)
    expected = IMAGE * (np.array(factor[:3]) * tint[0, :3] / 255)
    np.testing.assert_allclose(seen(square_glb(encoded(IMAGE), factor=factor, colours=tint)), expected, atol=0.51)
    # Without an image the two remain, and colours run linearly between vertices.
    ramp = np.array([[0, 0, 1], [1, 0, 1], [0, 0, 1], [1, 0, 1]], np.float32)
    plain = seen(square_glb(factor=factor, colours=ramp))
    np.testing.assert_allclose(plain[..., 0], np.tile(127.5 * (np.arange(64) + 0.5) / 64, (64, 1)), atol=0.6)
    assert (plain[..., 1] == 0).all()
    np.testing.assert_allclose(plain[..., 2], 64, atol=0.5)


def rolled(**transform: Any) -> Bytes:
    slot = {"extensions": {"KHR_texture_transform": transform}}
    return seen(square_glb(encoded(IMAGE), slot=slot))


def test_texture_transforms() -> None:
    """Scaled, then turned, then moved; a rotation counter-clockwise turns the image clockwise."""
    np.testing.assert_array_equal(rolled(offset=[0.25, 0.0]), np.roll(IMAGE, -16, axis=1))
    np.testing.assert_array_equal(rolled(offset=[0.0, 0.5]), np.roll(IMAGE, -32, axis=0))
    flipped = rolled(scale=[-1.0, 1.0])
    np.testing.assert_array_equal(flipped, IMAGE[:, ::-1])
    quarter = rolled(rotation=math.pi / 2, offset=[0.0, 1.0])
    np.testing.assert_array_equal(quarter, np.rot90(IMAGE, k=-1))
    both = rolled(rotation=math.pi / 2, offset=[0.0, 1.0], scale=[-1.0, 1.0])
    np.testing.assert_array_equal(both, np.rot90(IMAGE, k=-1)[:, ::-1])


def test_wrapping() -> None:
    """The coordinates run from −1 to 2: the image is in the middle third."""
    places = np.array([[-1, 2], [2, 2], [-1, -1], [2, -1]], np.float32)

    def wrapped(mode: int) -> Bytes:
        sampler = {"wrapS": mode, "wrapT": mode}
        return seen(square_glb(encoded(IMAGE), sampler=sampler, places=places), size=192)

    np.testing.assert_array_equal(wrapped(10497), np.tile(IMAGE, (3, 3, 1)))
    np.testing.assert_array_equal(wrapped(33071), np.pad(IMAGE, ((64, 64), (64, 64), (0, 0)), mode="edge"))
    np.testing.assert_array_equal(wrapped(33648), np.pad(IMAGE, ((64, 64), (64, 64), (0, 0)), mode="symmetric"))


def test_far_textures_are_averaged() -> None:
    """A chessboard of single texels is grey from afar, not a pattern of its own."""
    chess = np.zeros((256, 256, 3), np.uint8)
    chess[np.indices((256, 256)).sum(axis=0) % 2 == 0] = 255
    far = seen(square_glb(encoded(chess)), size=32, distance=2.0)
    inner = far[10:22, 10:22]
    assert np.abs(inner.astype(int) - 127).max() <= 2


def test_large_images_are_reduced() -> None:
    levels = read_picture(encoded(np.zeros((300, 600, 3), np.uint8)), "image/png", edge=100)
    assert [level.shape[:2] for level in levels] == [(50, 100), (25, 50), (12, 25), (6, 12), (3, 6), (1, 3), (1, 1)]


def test_memory_of_textures_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many images a file holds: half of the memory goes to large ones, then they are small, then one texel."""
    assert [allowed_edge(used) for used in (0, MAX_BYTES // 2 - 1, MAX_BYTES // 2, MAX_BYTES)] == [1024, 1024, 128, 1]
    builder = SurfaceBuilder()
    builder.texture_bytes = MAX_BYTES
    drawn_file(read_part(square_glb(encoded(IMAGE)), "x"), builder)
    assert builder.texture_bytes == MAX_BYTES + 3
    # The one texel is the image's mean.
    found = builder.surfaces().texels
    np.testing.assert_allclose(found.data, IMAGE.reshape(-1, 3).mean(axis=0), atol=1)
    monkeypatch.setattr("condvln.sensors.textures.MAX_PICTURE", 64 * 64 - 1)
    assert read_picture(encoded(IMAGE), "image/png") is None


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["PNG", "JPEG", "WEBP", "KTX2"]), st.integers(0), st.integers(0, 255), st.integers(1))
def test_no_image_breaks_the_reader(kind: str, place: int, value: int, length: int) -> None:
    data = bytearray(ETC1S_64 if kind == "KTX2" else encoded(IMAGE, kind))
    data[place % len(data)] = value
    levels = read_picture(bytes(data[: 1 + length % len(data)]), f"image/{kind.lower()}")
    assert levels is None or levels[-1].shape == (1, 1, 3)


@pytest.mark.parametrize(
    ("image", "mime"),
    [
        (b"nothing", "image/png"),
        (encoded(IMAGE)[:100], "image/png"),
        (encoded(IMAGE), "image/jpeg"),
        (b"KTX", "image/ktx2"),
    ],
)
def test_what_cant_be_read_leaves_the_colour_of_the_material(image: bytes, mime: str) -> None:
    glb = square_glb(image, mime, factor=[1.0, 0.0, 0.0, 1.0])
    assert (seen(glb) == [255, 0, 0]).all()
    assert drawn_file(read_part(glb, "x"), SurfaceBuilder()).unread == 1


def test_a_mirroring_node_keeps_its_front() -> None:
    mirrored = seen(square_glb(encoded(IMAGE), node={"scale": [-1.0, 1.0, 1.0]}))
    np.testing.assert_array_equal(mirrored, IMAGE[:, ::-1])
    turned = seen(square_glb(encoded(IMAGE), node={"rotation": [0.0, 1.0, 0.0, 0.0]}))
    assert not turned.any(), "the square is seen from behind"
