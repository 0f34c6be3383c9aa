"""The shape of whoever is told of every frame on the line."""

from __future__ import annotations

from typing import Protocol

from servosim.frames import Frame, FrameReader
from servosim.servo import Servo

__all__ = ["Witness"]


class Witness(Protocol):
    """Somebody who listens to the line without taking part."""

    def heard(self, at_s: float, frame: Frame, framing: type[FrameReader]) -> None:
        """The host's frame has come through."""
        ...

    def said(self, at_s: float, servo: Servo | None, data: bytes) -> None:
        """A servo starts to answer; None when several speak at once."""
        ...
