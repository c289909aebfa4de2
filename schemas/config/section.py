"""Base class of all sections of the configuration, and number types that carry their unit."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import ConfigDict, Field, ValidationInfo, field_validator

from schemas.base import Document

__all__ = ["Degrees", "Hours", "Metres", "Positive", "Seconds", "Section", "Share"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Metres = Annotated[Positive, Field(json_schema_extra={"unit": "m"})]
Degrees = Annotated[Positive, Field(json_schema_extra={"unit": "°"})]
Seconds = Annotated[Positive, Field(json_schema_extra={"unit": "s"})]
Hours = Annotated[float, Field(ge=0, allow_inf_nan=False, json_schema_extra={"unit": "h"})]
Share = Annotated[float, Field(ge=0, le=1, json_schema_extra={"unit": "share"})]


class Section(Document):
    """An immutable section of the configuration. Booleans are not accepted as numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    @field_validator("*", mode="before")
    @classmethod
    def _yes_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError("true and false are not allowed here")
        return value
