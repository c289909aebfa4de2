"""Images as files: single frames, contact sheets and clips."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["clip_gif", "coloured_depth", "coloured_instances", "contact_sheet", "png"]

Bytes = npt.NDArray[np.uint8]

TILE: Final = 320
"""Largest number of columns of a contact sheet."""
CAPTION: Final = 16
"""Height in pixels of a caption, and of each line of the heading."""
FRAME_MS: Final = 250
"""Milliseconds per frame of a clip: four actions a second."""
DARK: Final = (24, 24, 24)
LIGHT: Final = (230, 230, 230)


def png(image: npt.NDArray[np.generic]) -> bytes:
    """Return an image as a PNG file. An image (h, w, 3) uint8 is stored in colour; depths (h, w) in metres and integers
    (h, w) are stored with 16 bits.

    Depths are stored in millimetres; values are clipped at 65535.
    """
    from PIL import Image

    values = np.asarray(image)
    if values.dtype.kind == "f":
        values = np.round(values * 1000)
    if values.ndim == 2:
        values = np.clip(values, 0, 65535).astype(np.uint16)
    stream = io.BytesIO()
    Image.fromarray(values).save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def coloured_depth(depth: npt.NDArray[np.floating], farthest: float = 6.0) -> Bytes:
    """Return depth (h, w) in metres as a grey image (h, w, 3): near surfaces are dark, those at `farthest` or beyond
    are white, and pixels where nothing is seen are black.
    """
    grey = np.clip(depth / farthest, 0, 1) * 255
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=-1)


def coloured_instances(instance: npt.NDArray[np.integer]) -> Bytes:
    """Return an image (h, w, 3) in which each number in `instance` (h, w) has its own colour. The number 0 is black."""
    steps = np.array([97, 151, 211])  # odd, so that 256 consecutive numbers get different colours
    coloured: Bytes = ((instance[..., None].astype(np.int64) * steps + 64) % 256).astype(np.uint8)
    coloured[instance == 0] = 0
    return coloured


def contact_sheet(
    pictures: Sequence[Bytes], captions: Sequence[str], columns: int = 4, heading: Sequence[str] = ()
) -> bytes:
    """Return a PNG file that shows pictures (h, w, 3) of equal size in rows, each picture with its caption. The lines
    of `heading` are at the top.
    """
    from PIL import Image, ImageDraw

    height, width = pictures[0].shape[:2]
    wide = min(width, TILE)
    high = round(height * wide / width)
    rows = -(-len(pictures) // columns)
    top = CAPTION * len(heading) + (CAPTION // 2 if heading else 0)
    sheet = Image.new("RGB", (columns * wide, top + rows * (high + CAPTION)), DARK)
    draw = ImageDraw.Draw(sheet)
    for number, line in enumerate(heading):
        draw.text((4, 2 + number * CAPTION), line, fill=LIGHT)
    for number, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        place = number % columns * wide, top + number // columns * (high + CAPTION)
        tile = Image.fromarray(picture)
        sheet.paste(tile if tile.size == (wide, high) else tile.resize((wide, high), Image.Resampling.BOX), place)
        draw.text((place[0] + 4, place[1] + high + 1), caption, fill=LIGHT)
    stream = io.BytesIO()
    sheet.save(stream, "PNG")
    return stream.getvalue()


def clip_gif(pictures: Sequence[Bytes]) -> bytes:
    """Return a GIF file that shows pictures (h, w, 3) of equal size one after the other."""
    from PIL import Image

    frames = [Image.fromarray(picture) for picture in pictures]
    stream = io.BytesIO()
    frames[0].save(stream, "GIF", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0)
    return stream.getvalue()
