"""Values about servos: specification, ping result, readings, statistics."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ikservo.errors import BusError, ServoSilentError
from ikservo.hardware.packets import FaultKind, Reply, ReplyFault
from ikservo.registers import Alarm, ControlTable

__all__ = ["PingResult", "Readings", "ServoSpec", "ServoStatistics"]


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """A servo that should be on the line.

    Attributes:
        id: Its bus id.
        table: Its control table.
        name: The joint it turns, for messages.
    """

    id: int
    table: type[ControlTable]
    name: str = ""

    def __str__(self) -> str:
        return f"{self.name} (id {self.id})" if self.name else f"id {self.id}"


@dataclass(frozen=True, slots=True)
class PingResult:
    """What a servo says it is.

    Attributes:
        id: The id that answered.
        model_number: Its model register.
        firmware: Firmware version, where the protocol's ping tells it.
    """

    id: int
    model_number: int
    firmware: int | None = None


@dataclass(slots=True)
class ServoStatistics:
    """What happened to the questions put to one servo.

    Attributes:
        asked: Questions, repeats included.
        lost: Questions without an answer.
        garbled: Questions whose answer was unusable.
        refused: Questions the servo answered with no.
        retried: Questions put again.
        lost_in_a_row: Questions without a usable answer since the last good one.
        round_trips_s: How long the latest answers took, seconds; a group's answers count as one.
    """

    asked: int = 0
    lost: int = 0
    garbled: int = 0
    refused: int = 0
    retried: int = 0
    lost_in_a_row: int = 0
    round_trips_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))

    def record(self, reply: Reply, took_s: float) -> None:
        """Count one question and what came of it."""
        self.asked += 1
        if isinstance(reply, ReplyFault):
            self.lost += reply.kind is FaultKind.SILENT
            self.garbled += reply.kind is FaultKind.GARBLED
            self.refused += reply.kind is FaultKind.REFUSED
            if reply.kind is not FaultKind.REFUSED:
                self.lost_in_a_row += 1
                return
        self.lost_in_a_row = 0
        self.round_trips_s.append(took_s)

    def round_trip_s(self, quantile: float) -> float | None:
        """Return the round trip that a share of the latest answers did not exceed."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(int(quantile * len(ordered)), len(ordered) - 1)] if ordered else None


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

    def require_all(self) -> Mapping[int, T_co]:
        """Return the values, if every servo gave one.

        Raises:
            BusError: The one that is missing, or one error that names all that are.
        """
        if not self.errors:
            return self.values
        first, *others = self.errors.values()
        if not others:
            raise first
        raise self._combine_errors(first)

    def _combine_errors(self, first: BusError) -> BusError:
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
