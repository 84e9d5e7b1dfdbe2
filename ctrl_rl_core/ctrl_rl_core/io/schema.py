"""Base classes of file schemas: strict types, no unknown keys, finite numbers."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


class Schema(BaseModel):
    """A header or part of one; unknown keys and wrong types, such as text for a number, are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Name = Annotated[str, Field(min_length=1, max_length=500)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, le=2**48)]
Number = Annotated[float, Field(ge=-1e30, le=1e30)]
"""A physical quantity in SI units."""
Positive = Annotated[float, Field(gt=0.0, le=1e30)]
Anything = dict[str, Any]
"""Content for human readers; code that uses it must check it first."""
