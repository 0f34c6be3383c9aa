"""Joint feedback: positions in every cycle, telemetry, register reads with retries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

import numpy as np

from ikservo.clock import Clock
from ikservo.errors import BusError, ServoSilentError
from ikservo.guard import CommandLimits, CommunicationMonitor
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import Readings, ServoSpec
from ikservo.kinematics.arrays import Vector
from ikservo.registers import Register, RegisterName

__all__ = [
    "Feedback",
    "JointState",
    "load_percent",
    "measure_cycle_time_s",
    "read_joint_states",
    "read_register",
    "read_registers",
    "with_retries",
]


_ATTEMPTS = 4
# A busy machine, or an adapter that hiccups, is given this much more time after each attempt.
_PAUSE_S = 0.02

_Key = TypeVar("_Key", bound=Register | RegisterName)


def read_register(bus: ServoBus, servo_ids: Iterable[int], wanted: RegisterName) -> dict[int, int]:
    """Return a raw register of every servo.

    Raises:
        BusError: A servo does not answer, however often it is asked; names all such.
    """
    rows = read_registers(bus, dict.fromkeys(servo_ids, (wanted,)))
    return {servo_id: row[wanted] for servo_id, row in rows.items()}


def read_registers(
    bus: ServoBus, wanted: Mapping[int, Sequence[_Key]]
) -> dict[int, Mapping[_Key, int]]:
    """Return of each servo its own raw registers.

    Raises:
        BusError: A servo does not answer, however often it is asked; names all such.
    """
    known: dict[int, Mapping[_Key, int]] = {}
    for attempt in range(1, _ATTEMPTS + 1):
        missing = {i: keys for i, keys in wanted.items() if i not in known}
        readings = bus.bulk_read(missing, raw=True)
        known |= readings.values
        if not readings.errors:
            break
        if attempt == _ATTEMPTS:
            readings.require_all()
        bus.clock.sleep_until(bus.clock.now_s() + _PAUSE_S * attempt)
    return known


def with_retries(clock: Clock, settle: Callable[[], None]) -> None:
    """Settle something with a servo at rest; where it fails it is tried again after a pause.

    Raises:
        BusError: However often that was tried.
    """
    for attempt in range(1, _ATTEMPTS):
        try:
            return settle()
        except BusError:
            clock.sleep_until(clock.now_s() + _PAUSE_S * attempt)
    return settle()


_MAX_LOST = 3  # beats in a row


class Feedback:
    """Reads the joints' positions.

    Args:
        bus: The line.
        fences: One for each joint.

    Attributes:
        latest: The ticks of the joints that answered last, by joint.
    """

    def __init__(self, bus: ServoBus, fences: Sequence[CommandLimits]) -> None:
        self._bus, self._fences = bus, tuple(fences)
        self._ids = [fence.servo_id for fence in fences]
        self._last: dict[int, int] = {}
        self.latest: dict[str, int] = {}
        self.reset_losses()

    def reset_losses(self) -> None:
        """Start counting losses anew: the arm was at rest."""
        self._losses = CommunicationMonitor(
            [fence.joint for fence in self._fences], max_lost=_MAX_LOST
        )

    @property
    def lost_joints(self) -> tuple[str, ...]:
        """Return the joints whose last answer is missing."""
        return self._losses.lost_joints

    def measure_ticks(self) -> dict[str, int]:
        """Return every joint's tick, measured now.

        Raises:
            BusError: A servo does not answer, however often it is asked.
        """
        return self._ticks_by_joint(self._read_all())

    def measure_positions(self) -> Vector:
        """Return where the joints are (n,), measured now, rad or m.

        Raises:
            BusError: A servo does not answer, however often it is asked.
        """
        self._read_all()
        return self._latest_positions()

    def read(self) -> Vector:
        """Return where the joints are (n,); one that did not answer, where it was last seen.

        Raises:
            ServoSilentError: A servo gave no answer for three beats in a row; names it.
        """
        readings = self._bus.sync_read(self._ids, RegisterName.PRESENT_POSITION, raw=True)
        heard = dict(readings.values)
        try:
            self._store_ticks(heard)
        except ServoSilentError:
            heard |= self._retry_silent(readings)
            self.reset_losses()
            self._store_ticks(heard)
        return self._latest_positions()

    def _retry_silent(self, readings: Readings[int]) -> dict[int, int]:
        """Ask one of the silent with all patience: a busy machine is not a dead servo.

        Once it has answered the others are asked again, too: nobody has seen them for long.

        Raises:
            ServoSilentError: It is silent indeed; names all that are.
        """
        servo_id, *others = readings.errors
        try:
            first = {servo_id: self._bus.read(servo_id, RegisterName.PRESENT_POSITION, raw=True)}
        except BusError:
            readings.require_all()
            raise
        return first | dict(
            self._bus.sync_read(others, RegisterName.PRESENT_POSITION, raw=True).values
        )

    def _store_ticks(self, heard: Mapping[int, int]) -> None:
        self._last |= heard
        self.latest = {f.joint: heard[f.servo_id] for f in self._fences if f.servo_id in heard}
        self._losses.update(self.latest)

    def _read_all(self) -> Mapping[int, int]:
        heard = read_register(self._bus, self._ids, RegisterName.PRESENT_POSITION)
        self._last |= heard
        self.latest = self._ticks_by_joint(heard)
        return heard

    def _ticks_by_joint(self, by_id: Mapping[int, int]) -> dict[str, int]:
        return {fence.joint: by_id[fence.servo_id] for fence in self._fences}

    def _latest_positions(self) -> Vector:
        return np.array([f.joint_map.position(self._last[f.servo_id]) for f in self._fences])


@dataclass(frozen=True, slots=True)
class JointState:
    """One joint as its servo reports it.

    Attributes:
        position_rad: Measured; metres for a prismatic joint.
        lower_rad: Lower limit, same unit.
        upper_rad: Upper limit.
        limit_from: Where the limits come from.
        load_percent: Share of the stall torque or, where the servo measures it, current.
        torque: Whether the servo holds.
        alarms: What the servo complains about, in words.
    """

    name: str
    position_rad: float
    lower_rad: float
    upper_rad: float
    limit_from: str
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    alarms: tuple[str, ...] = ()


_STATE_REGISTERS = (
    RegisterName.TORQUE_ENABLE,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
)


def read_joint_states(
    bus: ServoBus, fences: Sequence[CommandLimits], ticks: Mapping[str, int]
) -> tuple[JointState, ...]:
    """Return every joint's position, limits, temperature, voltage, load and torque.

    Args:
        bus: The line.
        fences: One for each joint.
        ticks: Where they were just measured.

    Raises:
        BusError: A servo does not answer.
    """
    ids = [fence.servo_id for fence in fences]
    rows = read_registers(bus, {i: [*_STATE_REGISTERS, *_available_registers(bus, i)] for i in ids})
    return tuple(
        JointState(
            name=fence.joint,
            position_rad=fence.joint_map.position(ticks[fence.joint]),
            lower_rad=fence.limits.lower.value,
            upper_rad=fence.limits.upper.value,
            limit_from=fence.limits.source,
            temperature_c=_state_value(bus, fence, rows, RegisterName.PRESENT_TEMPERATURE),
            voltage_v=_state_value(bus, fence, rows, RegisterName.PRESENT_VOLTAGE),
            load_percent=load_percent(
                bus.servos[fence.servo_id],
                _state_value(bus, fence, rows, RegisterName.PRESENT_LOAD),
            ),
            torque=rows[fence.servo_id][RegisterName.TORQUE_ENABLE] != 0,
            alarms=tuple(sorted(str(alarm) for alarm in bus.alarms.get(fence.servo_id, ()))),
        )
        for fence in fences
    )


def _available_registers(bus: ServoBus, servo_id: int) -> list[RegisterName]:
    return (
        [] if RegisterName.ALARMS in bus.servos[servo_id].table.missing else [RegisterName.ALARMS]
    )


def _state_value(
    bus: ServoBus,
    fence: CommandLimits,
    rows: Mapping[int, Mapping[RegisterName, int]],
    role: RegisterName,
) -> float:
    table = bus.servos[fence.servo_id].table
    return table.find(role).to_value(rows[fence.servo_id][role])


def load_percent(servo: ServoSpec, load: float) -> float:
    """Return a load as a share of the most there is: of torque, or of the current limit."""
    table = servo.table
    if table.present_load.unit.symbol != "A":
        return 100.0 * load
    most = table.registers["current_limit"]
    return 100.0 * load / most.to_value(most.range[1])


_CYCLE_TIMES_S = (0.002, 0.0025, 0.004, 0.005, 0.008, 0.01)
_READINGS = 5
# The bus is busy for a quarter of each beat; the rest is for us, for repeats and for others.
_TIME_MARGIN = 4.0
_MIN_TIME_MARGIN = 1.25  # a slow bus may be busy for most of it


def measure_cycle_time_s(bus: ServoBus, feedback: Feedback) -> float:
    """Read the positions a few times and choose the control cycle that the bus allows.

    Returns:
        The time between two goals: 500 to 100 Hz, less on a slow bus.

    Raises:
        BusError: A servo does not answer.
    """
    cycle_s = _reading_s(bus, feedback) + _writing_s(bus)
    for beat_s in _CYCLE_TIMES_S:
        if beat_s >= _TIME_MARGIN * cycle_s:
            return beat_s
    return max(_CYCLE_TIMES_S[-1], _MIN_TIME_MARGIN * cycle_s)


def _reading_s(bus: ServoBus, feedback: Feedback) -> float:
    """Return how long it takes to read all positions, and what one servo says besides."""
    taken_s: list[float] = []
    for _ in range(_READINGS):
        begin_s = bus.clock.now_s()
        feedback.measure_positions()
        taken_s.append(bus.clock.now_s() - begin_s)
    return median(taken_s) * (1.0 + 1.0 / len(bus.servos))


def _writing_s(bus: ServoBus) -> float:
    """Return how long the goals of all servos are on the wire; nobody answers to them."""
    header = 14
    each = 1 + next(iter(bus.servos.values())).table.goal_position.size
    return bus.port.wire_s(header + each * len(bus.servos))
