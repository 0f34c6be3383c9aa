"""Who is on the line: one servo as the arm file knows it."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.registers import ServoTable

__all__ = ["Identity", "ServoSpec"]


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """A servo that should be on the line.

    Attributes:
        id: Its bus id.
        table: Its control table.
        name: The joint it turns, for messages.
    """

    id: int
    table: type[ServoTable]
    name: str = ""

    def __str__(self) -> str:
        return f"{self.name} (id {self.id})" if self.name else f"id {self.id}"


@dataclass(frozen=True, slots=True)
class Identity:
    """What a servo says it is.

    Attributes:
        id: The id that answered.
        model_number: Its model register.
        firmware: Firmware version, where the protocol's ping tells it.
    """

    id: int
    model_number: int
    firmware: int | None = None
