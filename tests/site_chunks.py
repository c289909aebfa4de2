"""Read the chunks of the explorer's page."""

from __future__ import annotations

import base64
import gzip
import re
from typing import Any, Final

import orjson

_PARTS: Final = re.compile(rb'explorer\.receive\("([a-z]+(?:-\d+)?)", "([A-Za-z0-9+/=]*)"\);\n')


def chunk_content(data: bytes) -> tuple[str, Any]:
    """Return the name and the document of a chunk, the inverse of `chunk_bytes`."""
    found = _PARTS.fullmatch(data)
    if found is None:
        raise ValueError("not a chunk")
    return found[1].decode(), orjson.loads(gzip.decompress(base64.b64decode(found[2])))
