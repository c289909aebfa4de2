"""Checksums inside documents of the store, which reveal damage even where the document is still valid JSON.

A changed digit in a manifest would otherwise be taken for what was published. Documents written before there were
checksums have none and are taken as they are.
"""

from __future__ import annotations

import json
from typing import TypeVar

import orjson
from pydantic import BaseModel

from schemas.canonical import digest

__all__ = ["sealed", "unsealed"]

Model = TypeVar("Model", bound=BaseModel)


def sealed(document: BaseModel) -> bytes:
    """Encode the document as JSON with its field ``checksum`` set."""
    content = document.model_dump(mode="json", exclude={"checksum"})
    return orjson.dumps({**content, "checksum": digest(content)}, option=orjson.OPT_INDENT_2)


def unsealed(kind: type[Model], data: bytes) -> Model:
    """Decode the document in ``data``. Raises ``ValueError`` when it is malformed or differs from its checksum."""
    document = kind.model_validate_json(data)
    content = json.loads(data)
    checksum = content.pop("checksum", None)
    if checksum is not None and digest(content) != checksum:
        raise ValueError("the document differs from its checksum")
    return document
