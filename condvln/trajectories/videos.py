"""Short videos in MP4 files without an encoder: a track of JPEG images, one a second."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

__all__ = ["mp4_of_jpegs"]

_SCALE: Final = 1000
"""Time units a second; a frame lasts one second."""
_MATRIX: Final = struct.pack(">9i", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)


def mp4_of_jpegs(frames: Sequence[bytes], width: int, height: int) -> bytes:
    """Return an MP4 file with one JPEG image a second (ISO/IEC 14496-12; the images as QuickTime's ``jpeg`` track).

    Equal images give equal bytes: the file has no dates.
    """
    start = _box(b"ftyp", b"qt  \x00\x00\x02\x00qt  ")
    data = b"".join(frames)
    media = _box(b"mdat", data)
    first = len(start) + 8
    duration = len(frames) * _SCALE
    entry = struct.pack(">6xH16xHHIIIH", 1, width, height, 0x480000, 0x480000, 0, 1)
    entry += b"\x04JPEG" + bytes(27) + struct.pack(">Hh", 24, -1)
    samples = _box(
        b"stbl",
        _full(b"stsd", struct.pack(">I", 1) + _box(b"jpeg", entry)),
        _full(b"stts", struct.pack(">III", 1, len(frames), _SCALE)),
        _full(b"stsc", struct.pack(">IIII", 1, 1, len(frames), 1)),
        _full(b"stsz", struct.pack(f">II{len(frames)}I", 0, len(frames), *map(len, frames))),
        _full(b"stco", struct.pack(">II", 1, first)),
    )
    information = _box(
        b"minf",
        _full(b"vmhd", bytes(8), flags=1),
        _box(b"dinf", _full(b"dref", struct.pack(">I", 1) + _full(b"url ", b"", flags=1))),
        samples,
    )
    handler = _full(b"hdlr", struct.pack(">4s4s12x", b"mhlr", b"vide") + b"\x00")
    track = _box(
        b"trak",
        _full(
            b"tkhd",
            struct.pack(">IIIII8xhhhH", 0, 0, 1, 0, duration, 0, 0, 0, 0)
            + _MATRIX
            + struct.pack(">II", width << 16, height << 16),
            flags=7,
        ),
        _box(
            b"mdia",
            _full(b"mdhd", struct.pack(">IIIIHH", 0, 0, _SCALE, duration, 0x55C4, 0)),
            handler,
            information,
        ),
    )
    movie = struct.pack(">IIIIIH10x", 0, 0, _SCALE, duration, 0x10000, 0x100) + _MATRIX + bytes(24)
    return start + media + _box(b"moov", _full(b"mvhd", movie + struct.pack(">I", 2)), track)


def _box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", len(body) + 8) + kind + body


def _full(kind: bytes, body: bytes, flags: int = 0) -> bytes:
    return _box(kind, struct.pack(">I", flags), body)
