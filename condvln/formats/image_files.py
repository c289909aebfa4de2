"""Image files in memory: colours as JPEG, 16-bit depth as PNG.

Both encoders are several times as fast as Pillow's, and what they write decodes alike
(``docs/decisions/0025-images-are-written-by-simplejpeg-and-isal.md``).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.errors import UsageError

__all__ = [
    "UP",
    "encoders",
    "filtered_rows",
    "jpeg",
    "png16",
]

UP = 2
"""PNG's filter that stores the difference to the byte above."""
MILLIMETRES = np.float32(1000)
"""Levels of a depth image for each metre."""
MOST = np.float32(65535)
"""Highest level of 16 bits."""


def filtered_rows(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the rows (h, 1 + 2 w) of a PNG file, each filtered by `UP`.

    depth : (h, w) metres; rounded to millimetres, half to even, and limited to 0 to 65.535 m
    """
    levels = np.clip(np.rint(depth * MILLIMETRES), np.float32(0), MOST).astype(">u2").view(np.uint8)
    rows = np.full((len(depth), 1 + 2 * depth.shape[1]), UP, np.uint8)
    rows[:, 1:] = levels
    rows[1:, 1:] -= levels[:-1]
    return rows


_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"


@cache
def encoders() -> Mapping[str, str]:
    """Return the encoder of each kind of image, with its version. The bytes of a file depend on both.

    Raises
    ------
    UsageError : an encoder is not installed
    """
    try:
        return {
            "jpg": f"simplejpeg {metadata.version('simplejpeg')}",
            "png": f"isal {metadata.version('isal')}",
        }
    except metadata.PackageNotFoundError as error:
        raise UsageError(
            f"{error.name} is not installed, which writes the images of trajectories",
            remedy="Install condvln[trajectories]",
        ) from error


def jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """Return an image (h, w, 3) as a JPEG file, with colours at half the resolution (4:2:0)."""
    import simplejpeg

    found: bytes = simplejpeg.encode_jpeg(np.ascontiguousarray(image), quality, "RGB", "420", fastdct=False)
    return found


def png16(depth: NDArray[np.float32], level: int) -> bytes:
    """Return depth (h, w) in metres as a PNG file with 16 bits: millimetres, 0 where nothing is seen, at most 65.535 m.

    level : of the compression, 0 to 3
    """
    from isal import isal_zlib

    height, width = depth.shape
    filtered = filtered_rows(np.ascontiguousarray(depth, np.float32))
    # Width, height, bits, grey, and the only compression, filter method and order without interlacing.
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    data: bytes = isal_zlib.compress(filtered, level)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
