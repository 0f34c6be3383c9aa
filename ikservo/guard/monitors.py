"""Monitors of a running motion: following error, lost communication, dead-man, servo health."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.errors import RefusedError, ServoAlarmError, ServoSilentError
from ikservo.guard.limits import CommandLimits
from ikservo.kinematics.arrays import Vector
from ikservo.model.model import HealthLimits

__all__ = [
    "DEAD_MAN_TIMEOUT_S",
    "CommunicationMonitor",
    "DeadManSwitch",
    "HealthLimits",
    "HealthMonitor",
    "ServoTelemetry",
    "TrackingMonitor",
]


_MAX_CYCLES = 3
# A joint that only lags makes its motion slower before it comes so near the end of its look-ahead.
_ERROR_FRACTION = 0.9


class TrackingMonitor:
    """Counts the beats in which a joint is further from its goal than lag and load explain.

    Args:
        names: The joints.
        most: How far each may be behind (n,), rad or m.
    """

    def __init__(self, names: Sequence[str], most: Vector) -> None:
        self._names, self._most = list(names), most
        self._behind = np.zeros(len(self._names), dtype=np.int64)

    @classmethod
    def for_limits(
        cls, fences: Sequence[CommandLimits], speeds: Mapping[str, float] | None = None
    ) -> TrackingMonitor:
        """Return a watch over joints whose goals keep the gate's look-ahead.

        Args:
            fences: Of the joints, in the order of the vectors (n,).
            speeds: Top speeds of the motion by joint, rad/s or m/s, as for `Gate.set_speeds`.
        """
        given = speeds or {}
        most = [
            _ERROR_FRACTION
            * f.max_lead_ticks(given.get(f.joint, f.speed))
            * f.joint_map.unit_per_tick
            for f in fences
        ]
        return cls([fence.joint for fence in fences], np.array(most))

    def update(self, goals: Vector, measured: Vector) -> None:
        """Compare goals and measured joints (n,), rad or m, once a beat.

        Raises:
            RefusedError: A joint has been too far behind for three beats; names it.
        """
        # Written so that no number at all is behind, too.
        behind = ~(np.abs(goals - measured) <= self._most)
        self._behind = np.where(behind, self._behind + 1, 0)
        if (self._behind >= _MAX_CYCLES).any():
            names = [self._names[i] for i in np.flatnonzero(self._behind >= _MAX_CYCLES)]
            raise RefusedError(
                f"{', '.join(names)} does not follow its setpoint; motion stopped.",
                "Check for obstacles, its cable, and its alarms: ikservo where",
            )


class CommunicationMonitor:
    """Counts the cycles in a row in which a joint's servo did not answer.

    Args:
        names: The joints.
        most: The series that stops the arm.
    """

    def __init__(self, names: Sequence[str], most: int = 3) -> None:
        self._row = dict.fromkeys(names, 0)
        self._most = most

    @property
    def lost_joints(self) -> tuple[str, ...]:
        """Return the joints whose last answer is missing."""
        return tuple(name for name, row in self._row.items() if row)

    def update(self, answered: Container[str]) -> None:
        """Note which joints answered in this cycle.

        Raises:
            ServoSilentError: A joint was silent too many times in a row; names all such.
        """
        for name in self._row:
            self._row[name] = 0 if name in answered else self._row[name] + 1
        silent = [name for name, row in self._row.items() if row >= self._most]
        if silent:
            raise ServoSilentError(
                f"did not answer {self._most} times in a row", servo=", ".join(silent)
            )


DEAD_MAN_TIMEOUT_S = 0.3
"""How long one command lasts, of whoever streams them: without another the arm brakes and holds."""


class DeadManSwitch:
    """Tells whether the last command from outside is too old to move on.

    Args:
        timeout_s: How long one command lasts.
    """

    def __init__(self, timeout_s: float = DEAD_MAN_TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self._fresh_s = -math.inf

    def refresh(self, time_s: float) -> None:
        """Note that a command came; one with no time, or an older one, does not count."""
        if time_s < math.inf:
            self._fresh_s = max(self._fresh_s, time_s)

    def expired(self, time_s: float) -> bool:
        """Return whether the switch has expired; it has as long as no command ever came."""
        return not time_s - self._fresh_s <= self._timeout_s


# A joint whose servo was not asked for this long is not known to be well.
_STALE_S = 1.0


@dataclass(frozen=True, slots=True)
class ServoTelemetry:
    """What a servo under torque tells about itself, besides where it is.

    Attributes:
        joint: The joint it turns.
        time_s: When it was asked.
        temperature_c: Its temperature.
        voltage_v: Its supply.
        load_percent: Its load as a share of the most there is, signed; None where it tells none.
        torque: Whether its torque is on.
        settings_intact: Whether its RAM still holds what was written there.
        alarms: What it complains about, in words.
    """

    joint: str
    time_s: float
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    settings_intact: bool
    alarms: frozenset[str]


@dataclass(frozen=True, slots=True)
class _ThresholdFault:
    found: str
    hint: str


class HealthMonitor:
    """Judges vitals: a warning, or a reason to hold.

    Args:
        limits: What the arm file allows.
        supply_v: The least and the highest supply of each joint's servo, as it says itself.

    Attributes:
        release: Whether a servo was so hot that it must be let go.
    """

    def __init__(
        self, limits: HealthLimits, supply_v: Mapping[str, tuple[float, float]] | None = None
    ) -> None:
        self._limits, self._supply_v = limits, dict(supply_v or {})
        self._asked_s: dict[str, float] = {}
        self._loaded_s: dict[str, float] = {}
        self.release = False

    def update(self, vitals: ServoTelemetry) -> tuple[str, ...]:
        """Return what a person should be told, in words.

        Raises:
            ServoAlarmError: The arm must hold: a servo is too hot, overloaded, wrongly fed, was
                reset, complains, or tells no numbers.
        """
        limits = self._limits
        self._asked_s[vitals.joint] = vitals.time_s
        self.release |= vitals.temperature_c >= limits.release_c
        faults = list(self._find_faults(vitals))
        if faults:
            found = "; ".join(fault.found for fault in faults)
            raise ServoAlarmError(f"{vitals.joint} {found}.", faults[0].hint)
        if vitals.temperature_c < limits.warn_c:
            return ()
        return (
            f"{vitals.joint} is at {vitals.temperature_c:.0f} °C; "
            f"motion stops at {limits.hold_c:.0f} °C.",
        )

    def check_telemetry_age(self, time_s: float) -> None:
        """Check that every servo that was asked once was asked lately.

        Raises:
            RefusedError: One was not, so that nobody knows how it is.
        """
        for joint, asked_s in self._asked_s.items():
            if not time_s - asked_s <= _STALE_S:
                raise RefusedError(
                    f"No status (temperature, voltage, load) from {joint} for "
                    f"{time_s - asked_s:.1f} s; stopped.",
                    "The arm holds. See: ikservo where",
                )

    def _find_faults(self, vitals: ServoTelemetry) -> Iterator[_ThresholdFault]:
        yield from _reset_faults(vitals)
        if vitals.alarms:
            words = ", ".join(sorted(str(alarm) for alarm in vitals.alarms))
            yield _ThresholdFault(
                f"reports an alarm: {words}",
                "Remove the load, or let it cool down: ikservo recover",
            )
        yield from self._temperature_faults(vitals.temperature_c)
        yield from self._voltage_faults(vitals)
        yield from self._load_faults(vitals)

    def _temperature_faults(self, celsius: float) -> Iterator[_ThresholdFault]:
        # Written so that no number at all is a fault, too.
        if not celsius < self._limits.hold_c:
            found = f"is at {celsius:.0f} °C (limit {self._limits.hold_c:.0f} °C)"
            yield _ThresholdFault(found, "Let it cool down: ikservo relax")

    def _voltage_faults(self, vitals: ServoTelemetry) -> Iterator[_ThresholdFault]:
        servo_low_v, servo_high_v = self._supply_v.get(vitals.joint, (-math.inf, math.inf))
        low_v = max(servo_low_v, self._limits.low_v)
        high_v = min(servo_high_v, self._limits.high_v)
        if not low_v <= vitals.voltage_v <= high_v:
            found = (
                f"has a supply of {vitals.voltage_v:.1f} V, outside {low_v:.1f} to {high_v:.1f} V"
            )
            yield _ThresholdFault(found, "Check the power supply and its cable.")

    def _load_faults(self, vitals: ServoTelemetry) -> Iterator[_ThresholdFault]:
        """Yield a fault for a load that has been too high for too long."""
        if vitals.load_percent is None or abs(vitals.load_percent) <= self._limits.load_percent:
            self._loaded_s.pop(vitals.joint, None)
            return
        lasts_s = vitals.time_s - self._loaded_s.setdefault(vitals.joint, vitals.time_s)
        if not (lasts_s < self._limits.load_s and math.isfinite(vitals.load_percent)):
            found = f"has been at {abs(vitals.load_percent):.0f} % load for {lasts_s:.1f} s"
            yield _ThresholdFault(
                found, "Reduce the load; check whether something blocks the joint."
            )


def _reset_faults(vitals: ServoTelemetry) -> Iterator[_ThresholdFault]:
    if not (vitals.torque and vitals.settings_intact):
        lost = "settings lost" if vitals.torque else "torque is off"
        yield _ThresholdFault(
            f"was reset: {lost}",
            "Its supply voltage may have dropped. Check power and cables, then start the motion "
            "again.",
        )
