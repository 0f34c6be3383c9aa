"""What one question to many servos brought: a value or an error for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ikservo.errors import BusError, ServoSilentError
from ikservo.registers import Alarm

__all__ = ["Readings"]

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Readings(Generic[T_co]):
    """A partial result; nothing that was heard is thrown away.

    Attributes:
        values: What each answering servo said.
        errors: Why each of the others did not.
        alarms: What servos complained about, beside their values; quiet servos are absent.
        hint: What the silence of some most likely means.
    """

    values: Mapping[int, T_co]
    errors: Mapping[int, BusError] = field(default_factory=dict[int, BusError])
    alarms: Mapping[int, frozenset[Alarm]] = field(default_factory=dict[int, frozenset[Alarm]])
    hint: str = ""

    def complete(self) -> Mapping[int, T_co]:
        """Return the values, if every servo gave one.

        Raises:
            BusError: The one that is missing, or one error that names all that are.
        """
        if not self.errors:
            return self.values
        first, *others = self.errors.values()
        if not others:
            raise first
        raise self._combined(first)

    def _combined(self, first: BusError) -> BusError:
        kinds = {type(error) for error in self.errors.values()}
        kind = type(first) if len(kinds) == 1 else BusError
        names = ", ".join(error.servo for error in self.errors.values())
        found = "do not answer" if kind is ServoSilentError else "sent no usable reply"
        return kind(
            found,
            self.hint,
            servo=names,
            port=first.port,
            asked=first.asked,
            sent=first.sent,
            received=first.received,
        )
