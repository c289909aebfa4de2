"""The textures of a scene with all their mipmap levels, packed into one byte array."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

__all__ = [
    "KTX2",
    "MAX_BYTES",
    "MAX_EDGE",
    "Texels",
    "allowed_edge",
    "decoders",
    "is_readable",
    "read_picture",
    "stored",
]

MAX_EDGE: Final = 1024
"""Largest kept size in texels of a texture's longer side. A camera of 640 columns one metre from a surface of 2 m × 2 m
resolves fewer.
"""
MAX_BYTES: Final = 3 << 28
"""Memory limit in bytes of a scene's textures; see `allowed_edge`. Scans have about sixty of 4 MB."""
SMALL_EDGE: Final = 128
"""Largest size in texels of the longer side of textures that are added when half of the limit is used."""
MAX_PICTURE: Final = 1 << 26
"""Largest number of pixels of an image that is decoded: 8,192 by 8,192."""
READABLE: Final = {"image/png": "PNG", "image/jpeg": "JPEG", "image/webp": "WEBP"}
"""Images that Pillow decodes, by media type."""
KTX2: Final = "image/ktx2"
"""Media type of images that the package opengl_basisu decodes, where it is installed (extra `ktx2`)."""

_PACKED: Final = (2, 3)
"""Supercompression schemes of KTX2 whose levels are decompressed as a whole: Zstandard and zlib."""

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False, slots=True)
class Texels:
    """The textures of a scene. The mipmap levels of a texture are stored one after the other; each level has half the
    size of the previous level.

    data : (t,) red, green and blue of each texel, row by row from the top
    first_level, levels : (k,) index of the first level, and number of levels, of each texture
    offsets, widths, heights : (l,) start in `data` and size of each level
    """

    data: Bytes
    first_level: NDArray[np.int32]
    levels: NDArray[np.int32]
    offsets: NDArray[np.int64]
    widths: NDArray[np.int32]
    heights: NDArray[np.int32]


def allowed_edge(used: int) -> int:
    """Return the allowed size in texels of the next texture's longer side, given the bytes used so far.

    A file of a few megabytes may hold thousands of large images of a single colour, so the last ones become single
    texels.
    """
    return MAX_EDGE if used < MAX_BYTES // 2 else SMALL_EDGE if used < MAX_BYTES else 1


def is_readable(mime: str) -> bool:
    """Return whether a decoder for images of a media type is installed."""
    return mime in READABLE or (mime == KTX2 and find_spec("opengl_basisu") is not None)


@cache
def decoders() -> Mapping[str, str]:
    """Return the decoder of each kind of texture, with its version; ``none`` where it is not installed. The colours of
    a scene depend on both.
    """
    found = {"jpeg, png, webp": f"Pillow {metadata.version('pillow')}", "ktx2": "none"}
    if is_readable(KTX2):
        found["ktx2"] = f"opengl_basisu {metadata.version('opengl-basisu')}"
    return found


def read_picture(data: bytes, mime: str, edge: int = MAX_EDGE) -> list[Bytes] | None:
    """Return the mipmap levels (h, w, 3) of an encoded image, the largest first; None if it can't be decoded.

    edge : limit in texels of the longer side of the largest level
    """
    from PIL import Image

    if not is_readable(mime):
        return None
    if mime == KTX2:
        return _transcoded(data, edge)
    try:
        with Image.open(io.BytesIO(data), formats=(READABLE[mime],)) as picture:
            if picture.width * picture.height > MAX_PICTURE:
                return None
            picture.draft("RGB", (edge, edge))
            return list(_levels(picture.convert("RGB"), edge))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def _transcoded(data: bytes, edge: int) -> list[Bytes] | None:
    import opengl_basisu
    from PIL import Image

    try:
        texture = opengl_basisu.open(data)
        if texture.width * texture.height > MAX_PICTURE:
            return None
        # The largest of the file's own mipmap levels that is kept, or else the smallest.
        fits = [level for level in range(texture.levels) if max(texture.level_size(level)) <= edge]
        kept = fits[0] if fits else texture.levels - 1
        if not _is_plausible(data, kept, texture.level_size(kept)):
            return None
        pixels = texture.transcode("rgba8", kept).data
        return list(_levels(Image.fromarray(pixels[..., :3]), edge))
    except (ValueError, struct.error):
        return None


def _is_plausible(data: bytes, level: int, size: tuple[int, int]) -> bool:
    """Return whether a KTX2 file holds one image, and its header claims at most 16 bytes of a level for each block of
    4 × 4 texels. The decoder allocates what the header claims before it decompresses the level.

    size : width and height of the level in texels

    Raises
    ------
    struct.error : the header is cut off
    """
    layers, faces, _, compression = struct.unpack_from("<4I", data, 32)
    _, _, claimed = struct.unpack_from("<3Q", data, 80 + 24 * level)
    width, height = size
    most = 16 * -(-width // 4) * -(-height // 4)
    return layers <= 1 and faces == 1 and (compression not in _PACKED or claimed <= most)


def _levels(picture: Picture, edge: int) -> Iterator[Bytes]:
    from PIL import Image

    scale = min(1.0, edge / max(picture.size))
    size = max(1, round(picture.width * scale)), max(1, round(picture.height * scale))
    while True:
        if picture.size != size:
            picture = picture.resize(size, Image.Resampling.BOX)
        yield np.asarray(picture)
        if max(size) == 1:
            return
        size = max(1, size[0] // 2), max(1, size[1] // 2)


def stored(pictures: Sequence[list[Bytes]]) -> Texels:
    """Pack textures, each given by its mipmap levels, into one array."""
    flat = [level for levels in pictures for level in levels]
    counts = np.array([len(levels) for levels in pictures], dtype=np.int32)
    ends = np.cumsum([0, *(level.size for level in flat)])

    def numbers(values: ArrayLike) -> NDArray[np.int32]:
        return np.array(values, dtype=np.int32).reshape(-1)

    return Texels(
        data=np.concatenate([np.zeros(0, np.uint8), *(level.reshape(-1) for level in flat)]),
        first_level=numbers(np.cumsum([0, *counts])[:-1]),
        levels=counts,
        offsets=ends[:-1].astype(np.int64),
        widths=numbers([level.shape[1] for level in flat]),
        heights=numbers([level.shape[0] for level in flat]),
    )
