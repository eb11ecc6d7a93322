"""What all sections of the mission file are made of: numbers with their limits, names, corners."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


def one_of_keys(*keys: str) -> Callable[[dict[str, Any]], None]:
    """Say in the JSON Schema that exactly one of these keys must be there."""

    def extra(schema: dict[str, Any]) -> None:
        schema["oneOf"] = [{"required": [key]} for key in keys]

    return extra


class Section(BaseModel):
    """What all parts of the file share: no unknown keys, no conversions of type, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


Metres = Annotated[float, Field(ge=-1e7, le=1e7)]
Length = Annotated[float, Field(gt=0.0, le=1e7)]
Degrees = Annotated[float, Field(ge=-36000.0, le=36000.0)]
Weight = Annotated[float, Field(ge=0.0, le=1e9)]
Range = Annotated[list[Metres], Field(min_length=2, max_length=2, description="[min, max], metres")]
Corner = Annotated[list[Metres], Field(min_length=2, max_length=2, description="[x, y], metres")]
Vector = Annotated[list[Metres], Field(min_length=2, max_length=2, description="[x, y], of any length")]
Ring = Annotated[list[Corner], Field(min_length=3, description="Corners in order, not closed, metres")]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f\\/]+$")]
