"""Fields and names that all messages of a page share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ikservo.files.validation import StrictModel

_MAX_SEQ = 2**53 - 1  # the largest whole number that JavaScript counts without gaps

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]{1,64}$")]
StopInput = Literal["button", "Space", "Escape", "gamepad"]
"""The control with which the user requested a stop."""


class PageMessage(StrictModel):
    """The fields of all messages.

    Attributes:
        seq: Sequence number, increasing; a repeated number is a replay.
        seen: Number of the last scene drawn before sending, which gives the message's age.
    """

    seq: Annotated[int, Field(ge=1, le=_MAX_SEQ)]
    seen: Annotated[int, Field(ge=0, le=_MAX_SEQ)]
