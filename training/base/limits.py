"""The limits of a recipe's values, in one place.

They are far beyond useful values. A value outside them is a typing error, which is refused before
it takes memory or days.
"""

from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field

from runtime.contract.contract import MAX_SIDE, MIN_SIDE

# Configuration of all tables of a recipe: no conversions ("3", true), unknown keys, NaN or Inf.
STRICT = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

Index = Annotated[int, Field(ge=0, le=10**9)]
Seed = Annotated[int, Field(ge=0, le=2**32 - 1)]
Steps = Annotated[int, Field(ge=1, le=10**8)]
Count = Annotated[int, Field(ge=1, le=10**6)]
Workers = Annotated[int, Field(ge=0, le=1024)]
BatchSize = Annotated[int, Field(ge=1, le=65536)]
# Pixels of a frame's height or width, as networks take it.
Side = Annotated[int, Field(ge=MIN_SIDE, le=MAX_SIDE)]
CropSide = Annotated[int, Field(ge=1, le=MAX_SIDE)]

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, le=1e9)]
# Limits of a relative change of colours.
Strength = Annotated[float, Field(ge=0, le=10)]
Degrees = Annotated[float, Field(ge=0, le=180)]
NotNegative = Annotated[float, Field(ge=0, le=1e9)]


def _require_order(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("expected low <= high")
    return limits


_PositiveShare = Annotated[float, Field(gt=0, le=1)]
_Factor = Annotated[float, Field(ge=0.01, le=100)]
# (low, high) of a value that is drawn at random.
ShareRange = Annotated[tuple[_PositiveShare, _PositiveShare], AfterValidator(_require_order)]
FactorRange = Annotated[tuple[_Factor, _Factor], AfterValidator(_require_order)]
