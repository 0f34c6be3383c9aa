"""Values that describe servos: specification, ping result, readings, statistics."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ikservo.errors import BusError, ServoSilentError
from ikservo.hardware.packets import FaultKind, Reply, ReplyFault
from ikservo.registers import Alarm, ControlTable


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """A servo that is expected on the bus; messages call it by its name, the name of its joint."""

    id: int
    table: type[ControlTable]
    name: str = ""

    def __str__(self) -> str:
        return f"{self.name} (id {self.id})" if self.name else f"id {self.id}"


@dataclass(frozen=True, slots=True)
class PingResult:
    """The identity that a servo reports; not every protocol reports the firmware version."""

    id: int
    model_number: int
    firmware: int | None = None


@dataclass(slots=True)
class ServoStatistics:
    """The outcomes of the requests to one servo.

    Attributes:
        requests: Requests, including retries.
        lost: Requests without a reply.
        garbled: Requests whose reply was unusable.
        refused: Requests that the servo refused.
        retried: Requests that were repeated.
        lost_in_a_row: Requests without a usable reply since the last good one.
        round_trips_s: Durations of the latest exchanges, seconds; a group counts as one exchange.
    """

    requests: int = 0
    lost: int = 0
    garbled: int = 0
    refused: int = 0
    retried: int = 0
    lost_in_a_row: int = 0
    round_trips_s: deque[float] = field(default_factory=lambda: deque[float](maxlen=1000))

    def record(self, reply: Reply, took_s: float) -> None:
        """Count one request and its outcome."""
        self.requests += 1
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
        """Compute a quantile of the latest round trips, seconds; None if there were none."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(int(quantile * len(ordered)), len(ordered) - 1)] if ordered else None


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """The outcomes of all requests on a line since it was opened.

    Attributes:
        lost: Requests without a usable reply.
        round_trip_s: Slowest of the servos' latest exchanges, seconds; None if there were none.
    """

    lost: int
    round_trip_s: float | None

    @classmethod
    def of(cls, servos: Iterable[ServoStatistics]) -> LinkStatistics:
        """Add up the statistics of the servos of a line."""
        counts = list(servos)
        latest = [count.round_trips_s[-1] for count in counts if count.round_trips_s]
        lost = sum(count.lost + count.garbled for count in counts)
        return cls(lost, max(latest, default=None))


T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Readings(Generic[T_co]):
    """Result of a group read; if some servos fail, it contains the values of the others.

    Attributes:
        values: The value of each servo that replied.
        errors: The error of each servo that did not reply.
        alarms: Alarms received with the values; servos without alarms are left out.
        hint: The most likely cause if servos are silent.
    """

    values: Mapping[int, T_co]
    errors: Mapping[int, BusError] = field(default_factory=dict[int, BusError])
    alarms: Mapping[int, frozenset[Alarm]] = field(default_factory=dict[int, frozenset[Alarm]])
    hint: str = ""

    def require_all(self) -> Mapping[int, T_co]:
        """Return the values if every servo has sent its value.

        Raises:
            BusError: Values are missing; all servos without a value are named.
        """
        if not self.errors:
            return self.values
        first, *others = self.errors.values()
        if not others:
            raise first
        kinds = {type(error) for error in self.errors.values()}
        kind = type(first) if len(kinds) == 1 else BusError
        names = ", ".join(error.servo for error in self.errors.values())
        found = "do not answer" if kind is ServoSilentError else "sent no usable reply"
        raise kind(
            found,
            self.hint,
            servo=names,
            port=first.port,
            request=first.request,
            sent=first.sent,
            received=first.received,
        )
