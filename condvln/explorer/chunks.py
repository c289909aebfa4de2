"""Chunks of data as classic scripts: a browser loads no JSON from ``file://``, but it loads scripts.

A chunk is ``explorer.receive("<name>", "<base64 of gzip of JSON>");``. The base64 alphabet holds no quote and no ``<``,
so nothing in the data can end the script.
"""

from __future__ import annotations

import base64
import gzip
import re
from pathlib import Path
from typing import Any, Final

import orjson

from condvln.formats.streams import atomic_stream

__all__ = ["chunk_bytes", "chunk_content", "write_chunk"]

_LEVEL: Final = 6
_NAME: Final = re.compile(r"[a-z]+(-\d+)?")
_PARTS: Final = re.compile(rb'explorer\.receive\("([a-z]+(?:-\d+)?)", "([A-Za-z0-9+/=]*)"\);\n')


def chunk_bytes(name: str, document: Any, level: int = _LEVEL) -> bytes:
    """Return the bytes of the script that holds a chunk; equal documents give equal bytes."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of a chunk")
    packed = gzip.compress(orjson.dumps(document, option=orjson.OPT_SERIALIZE_NUMPY), level, mtime=0)
    return b'explorer.receive("%s", "%s");\n' % (name.encode(), base64.b64encode(packed))


def chunk_content(data: bytes) -> tuple[str, Any]:
    """Return the name and the document of a chunk; the inverse of :func:`chunk_bytes`."""
    found = _PARTS.fullmatch(data)
    if found is None:
        raise ValueError("not a chunk")
    return found[1].decode(), orjson.loads(gzip.decompress(base64.b64decode(found[2])))


def write_chunk(folder: Path, name: str, document: Any, level: int = _LEVEL) -> Path:
    """Write a chunk to ``<folder>/<name>.js``. Raises StoreError if the file can't be written."""
    path = folder / f"{name}.js"
    with atomic_stream(path) as stream:
        stream.write(chunk_bytes(name, document, level))
    return path
