"""What all tables of files and messages have in common: nothing unknown, no guessed types."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

__all__ = ["StrictModel"]


class StrictModel(BaseModel):
    """A table that is refused where a key is unknown, or a value not of the type that it must be.

    No float is infinite or NaN. It is never changed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
