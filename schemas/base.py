"""Base classes of documents and of sections of the configuration, which refuse unknown keys; numbers with units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

__all__ = [
    "SCHEMA_VERSION",
    "Degrees",
    "Document",
    "Finite",
    "Frozen",
    "Hours",
    "Json",
    "Metres",
    "Row",
    "Seconds",
    "Section",
    "Share",
    "Vec3",
    "VersionedDocument",
    "first_fault",
]

SCHEMA_VERSION: Final = "1.0"
"""Version of all contracts in this package. The major part changes when a reader of the old form would misread the new
one (new keys, everything is computed again); the minor part when fields are only added.
"""

Json = dict[str, Any]
"""An object of a JSON document."""

Row = Mapping[str, Any]
"""A row of a table, by its columns."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A float that is neither infinite nor NaN."""

Vec3 = tuple[Finite, Finite, Finite]
"""A point or a size in metres, Habitat frame (+Y up, −Z north)."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Metres = Annotated[Positive, Field(json_schema_extra={"unit": "m"})]
Degrees = Annotated[Positive, Field(json_schema_extra={"unit": "°"})]
Seconds = Annotated[Positive, Field(json_schema_extra={"unit": "s"})]
Hours = Annotated[float, Field(ge=0, allow_inf_nan=False, json_schema_extra={"unit": "h"})]
Share = Annotated[float, Field(ge=0, le=1, json_schema_extra={"unit": "share"})]


class Document(BaseModel):
    """A document in which an unknown key is an error. The text below a field is its description."""

    model_config = ConfigDict(extra="forbid", validate_default=True, use_attribute_docstrings=True)


class Frozen(Document):
    """An immutable, hashable document."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class VersionedDocument(Document):
    """A document that is stored as a file of its own and records its schema version."""

    schema_version: Literal["1.0"] = SCHEMA_VERSION


class Section(Document):
    """An immutable section of the configuration. Booleans are not accepted as numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    @field_validator("*", mode="before")
    @classmethod
    def _no_boolean_as_number(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError("true and false are not allowed here")
        return value


def first_fault(error: Exception) -> str:
    """Return what is wrong in one line: of a refused document, its first wrong value with the place; of another error,
    its message.
    """
    if not isinstance(error, ValidationError):
        return str(error)
    fault = error.errors()[0]
    return ": ".join(filter(None, [".".join(map(str, fault["loc"])), fault["msg"]]))
