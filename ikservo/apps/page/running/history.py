"""History of the servos and the line over the last ten minutes, in a ring buffer."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.apps.page.dragging.snapshot import ArmSnapshot
from ikservo.hardware.servo import LinkStatistics

_DURATION_S = 600.0
_PERIOD_S = 0.02
_JITTER_S = 0.001  # a cycle may come early by this much
_CSV_ROWS = 100  # rows formatted at a time; the control loop runs in between

Table = NDArray[np.float32]

_STORED = ("goal", "position", "load", "current", "temperature", "voltage")
_OF_LINE = ("round_trip", "losses")
_UNITS = {
    "load": "%", "current": "A", "temperature": "°C", "voltage": "V", "round_trip": "ms",
    "losses": "",
}  # fmt: skip
QUANTITIES = ("goal", "position", "error", *_STORED[2:], *_OF_LINE)
"""All quantities; quantities of the line have no joint."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One quantity over time.

    Attributes:
        quantity: One of ``QUANTITIES``. ``goal`` is the reference of the joint, which the servo's
            own goal leads; ``error`` is goal minus position; ``losses`` counts the requests without
            a usable reply.
        unit: The unit that is shown.
        joint: The joint name; empty for a quantity of the line.
    """

    quantity: str
    unit: str
    joint: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class HistorySlice:
    """Samples of all channels.

    Attributes:
        channels: The columns.
        times_s: Times (k,), increasing.
        values: Values (k, columns) in the channels' units, NaN if not measured.
        reason: The reason why the arm stopped at the end; empty for a recording of the present.
    """

    channels: tuple[Channel, ...]
    times_s: NDArray[np.float64]
    values: Table
    reason: str = ""

    def select(self, wanted: Sequence[Channel]) -> Table:
        """Select the columns of some channels (k, wanted)."""
        columns = [self.channels.index(channel) for channel in wanted]
        return self.values[:, columns]


class History:
    """Samples of every joint and of the line in preallocated memory.

    One thread records, others read: a reader that is overtaken drops the overwritten samples, so
    that no thread waits for another.

    Args:
        joints: The joint names.
        prismatic: Whether each joint is prismatic, and shown in millimetres.
        duration_s: The least time for which samples are kept.
        period_s: The shortest time between two samples.

    Attributes:
        channels: Every channel, ``error`` included.
        last_stop: The ten seconds before the last stop; None before the first stop.
    """

    STOP_S = 10.0

    def __init__(
        self,
        joints: Sequence[str],
        prismatic: Sequence[bool],
        duration_s: float = _DURATION_S,
        period_s: float = _PERIOD_S,
    ) -> None:
        self._least_s, self._count = period_s - _JITTER_S, 0
        self._scale = np.array([1000.0 if is_m else math.degrees(1.0) for is_m in prismatic])
        capacity = math.ceil(duration_s / self._least_s) + 1
        self._times = np.zeros(capacity)
        self._values = np.full(
            (capacity, len(_STORED) * len(joints) + len(_OF_LINE)), math.nan, dtype=np.float32
        )
        of_joints = (
            Channel(quantity, _UNITS.get(quantity, "mm" if is_m else "°"), joint)
            for quantity in QUANTITIES[: -len(_OF_LINE)]
            for joint, is_m in zip(joints, prismatic, strict=True)
        )
        of_line = (Channel(quantity, _UNITS[quantity]) for quantity in _OF_LINE)
        self.channels = (*of_joints, *of_line)
        self.last_stop: HistorySlice | None = None

    def record(self, snapshot: ArmSnapshot, link: LinkStatistics, now_s: float) -> None:
        """Append a sample; a sample that comes too soon after the last one is dropped."""
        last_s = self._times[(self._count - 1) % len(self._times)]
        if not self._count or now_s - last_s >= self._least_s:
            self._append(snapshot, link, now_s)

    def _append(self, snapshot: ArmSnapshot, link: LinkStatistics, now_s: float) -> None:
        row = self._count % len(self._times)
        self._times[row] = now_s
        count = len(self._scale)
        goal = np.full(count, math.nan) if snapshot.reference is None else snapshot.reference
        telemetry = [
            (_or_nan(state.load_percent), _or_nan(state.current_a), state.temperature_c,
             state.voltage_v)
            for state in snapshot.states
        ]  # fmt: skip
        round_trip_ms = _or_nan(link.round_trip_s) * 1000.0
        self._values[row] = np.concatenate(
            (
                goal * self._scale,
                snapshot.measured * self._scale,
                np.array(telemetry).T.ravel(),
                (round_trip_ms, link.lost),
            )
        )
        self._count += 1  # incremented last, so that readers see whole samples

    def mark_stop(
        self, reason: str, snapshot: ArmSnapshot, link: LinkStatistics, now_s: float
    ) -> None:
        """Keep the last ten seconds, because the arm was stopped.

        The sample at the stop is always kept, because only it counts the losses of the failed
        cycle.
        """
        self._append(snapshot, link, now_s)
        kept = self.since(now_s - self.STOP_S)
        self.last_stop = HistorySlice(kept.channels, kept.times_s, kept.values, reason)

    def since(self, start_s: float) -> HistorySlice:
        """Return the samples after a time, the oldest first."""
        capacity, count = len(self._times), self._count
        order = np.arange(max(0, count - capacity + 1), count)
        times = self._times[order % capacity]
        first = int(np.searchsorted(times, start_s, side="right"))
        stored = self._values[order[first:] % capacity]
        overwritten = max(0, self._count - capacity + 1 - int(order[first])) if len(stored) else 0
        stored, n = stored[overwritten:], len(self._scale)
        goal, position = stored[:, :n], stored[:, n : 2 * n]
        values = np.hstack((goal, position, goal - position, stored[:, 2 * n :]))
        return HistorySlice(self.channels, times[first:][overwritten:], values)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


_CSV_UNITS = {"°": "deg", "mm": "mm", "%": "percent", "A": "a", "°C": "c", "V": "v", "ms": "ms"}


def csv_lines(recording: HistorySlice) -> Generator[str]:
    """Yield a recording as CSV (RFC 4180), a hundred lines at a time.

    The first line has the names with their units; a value that was not measured is empty.
    """
    names = ["time_s"]
    for channel in recording.channels:
        parts = (channel.joint, channel.quantity, _CSV_UNITS.get(channel.unit, ""))
        names.append("_".join(part for part in parts if part))
    yield ",".join(names) + "\r\n"
    for start in range(0, len(recording.times_s), _CSV_ROWS):
        rows = slice(start, start + _CSV_ROWS)
        lines: list[str] = []
        for time_s, values in zip(
            recording.times_s[rows].tolist(), recording.values[rows].tolist(), strict=True
        ):
            cells = ["" if math.isnan(value) else f"{value:.6g}" for value in values]
            lines.append(",".join((f"{time_s:.3f}", *cells)) + "\r\n")
        yield "".join(lines)
