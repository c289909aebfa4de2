"""Write a matplotlib figure to a file, whole or not at all."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from condvln.formats.streams import atomic_stream
from schemas.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_figure"]


def write_figure(figure: Figure, path: str | os.PathLike[str], *, dpi: int, metadata: Any = None) -> None:
    """Draw a figure in the format of the file's suffix (``.png`` if there is none), and write the file.

    Raises
    ------
    UsageError : no format has this suffix
    StoreError : the file can't be written
    """
    file = Path(path)
    form, drawn = file.suffix.removeprefix(".").lower() or "png", io.BytesIO()
    known = figure.canvas.get_supported_filetypes()
    if form not in known:
        raise UsageError(
            f"{file.suffix!r} is not a format of pictures", where=file, remedy=f"Write to .{', .'.join(sorted(known))}."
        )
    figure.savefig(drawn, format=form, dpi=dpi, metadata=metadata)
    with atomic_stream(file) as stream:
        stream.write(drawn.getvalue())
