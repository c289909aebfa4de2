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

from condvln.formats.depth_rows import filtered_rows

__all__ = ["encoders", "encoders_of", "jpeg", "png16"]

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"


@cache
def encoders() -> Mapping[str, str]:
    """Return the encoder of each kind of image, with its version. The bytes of a file depend on both."""
    return {
        "jpg": f"simplejpeg {metadata.version('simplejpeg')}",
        "png": f"isal {metadata.version('isal')}",
    }


def encoders_of(libraries: Mapping[str, str], named: Mapping[str, str]) -> Mapping[str, str]:
    """Return the encoders of a folder of trajectories: those that its record names. Older records name none; Pillow
    wrote their images.

    libraries : versions of libraries, by name
    """
    return named or dict.fromkeys(("jpg", "png"), f"Pillow {libraries.get('pillow', '')}".strip())


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
    filtered = np.empty((height, 1 + 2 * width), np.uint8)
    filtered_rows(np.ascontiguousarray(depth, np.float32), filtered)
    # Width, height, bits, grey, and the only compression, filter method and order without interlacing.
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    data: bytes = isal_zlib.compress(filtered, level)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(kind)))
