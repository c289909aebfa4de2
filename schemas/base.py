"""Base classes of all documents, which refuse unknown keys, and small value types."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["Document", "Finite", "Frozen", "Vec3", "VersionedDocument"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A float that is neither infinite nor NaN."""

Vec3 = tuple[Finite, Finite, Finite]
"""A point or a size in metres, Habitat frame (+Y up, −Z north)."""


class Document(BaseModel):
    """A document in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", validate_default=True)


class Frozen(Document):
    """An immutable, hashable document."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class VersionedDocument(Document):
    """A document that is stored as a file of its own and records its schema version."""

    schema_version: Literal["1.0"] = "1.0"
