"""Health of servos in a motion: lost replies, heat, supply, load, lost power and torque."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ikservo.errors import RefusedError, ServoAlarmError, ServoSilentError
from ikservo.model.arm_model import HealthLimits
from ikservo.registers import Alarm


class CommunicationMonitor:
    """Count of consecutive cycles without a servo's reply; after ``max_lost``, raises an error."""

    def __init__(self, names: Sequence[str], max_lost: int = 3) -> None:
        self._row = dict.fromkeys(names, 0)
        self._max_lost = max_lost

    @property
    def lost_joints(self) -> tuple[str, ...]:
        """The joints whose last reply is missing."""
        return tuple(name for name, row in self._row.items() if row)

    def update(self, replied: Container[str]) -> None:
        """Record the joints that replied in this cycle.

        Raises:
            ServoSilentError: Joints were silent in too many consecutive cycles; the error names
                them.
        """
        for name in self._row:
            self._row[name] = 0 if name in replied else self._row[name] + 1
        silent = [name for name, row in self._row.items() if row >= self._max_lost]
        if silent:
            raise ServoSilentError(
                f"did not answer {self._max_lost} times in a row", servo=", ".join(silent)
            )


# The status of a servo that was not read for this long is unknown.
_STALE_S = 1.0
# If a servo's own limit is below the arm file's limit, warnings begin this far below the servo's.
_WARN_BELOW_C = 5.0


@dataclass(frozen=True, slots=True)
class ServoTelemetry:
    """The telemetry of a servo with torque on, without its position.

    Attributes:
        joint: The joint of the servo.
        time_s: Time of the reading.
        temperature_c: The temperature.
        voltage_v: The supply voltage.
        load_percent: The load in percent of the maximum, signed; None if the servo does not report
            it.
        torque: Whether torque is on.
        settings_intact: Whether RAM still holds the settings that were written.
        alarms: The alarms, as text.
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


@dataclass(slots=True)
class _Heating:
    """Heating rate of a servo between changes of its sensor, which reports whole degrees."""

    degree_c: float = math.nan
    since_s: float = 0.0
    rate_c_s: float = 0.0

    def update(self, telemetry: ServoTelemetry) -> None:
        risen_c = telemetry.temperature_c - self.degree_c
        if risen_c == 0.0:
            return
        elapsed_s = telemetry.time_s - self.since_s
        self.rate_c_s = risen_c / elapsed_s if risen_c > 0.0 and elapsed_s > 0.0 else 0.0
        self.degree_c, self.since_s = telemetry.temperature_c, telemetry.time_s

    def time_left(self, hold_c: float) -> str:
        """Describe when a temperature will be reached; empty if the temperature does not rise."""
        if self.rate_c_s <= 0.0 or hold_c == math.inf:
            return ""
        return f", at this rate in {(hold_c - self.degree_c) / self.rate_c_s:.0f} s"


class HealthMonitor:
    """Check of telemetry for warnings and for reasons to hold.

    Args:
        limits: The limits of the arm file.
        supply_v: The supply limits of each joint's servo, low and high, as in its registers.
        trip_c: The temperature at which each joint's servo protects itself, as in its register.

    Attributes:
        release: Whether a servo is so hot that its torque must be switched off.
    """

    def __init__(
        self,
        limits: HealthLimits,
        supply_v: Mapping[str, tuple[float, float]] | None = None,
        trip_c: Mapping[str, float] | None = None,
    ) -> None:
        self._limits, self._supply_v = limits, dict(supply_v or {})
        self._trip_c = dict(trip_c or {})
        self._heating: dict[str, _Heating] = {}
        self._read_s: dict[str, float] = {}
        self._loaded_s: dict[str, float] = {}
        self.release = False

    def update(self, telemetry: ServoTelemetry) -> tuple[str, ...]:
        """Update the monitored values; return warnings for the user.

        Raises:
            ServoAlarmError: The arm must hold: a servo is too hot or overloaded, its supply is out
                of range, it was reset, or it reports an alarm or values that are not finite.
        """
        limits = self._limits
        self._read_s[telemetry.joint] = telemetry.time_s
        self.release |= telemetry.temperature_c >= limits.release_c
        faults = list(self._find_faults(telemetry))
        if faults:
            found = "; ".join(fault.found for fault in faults)
            raise ServoAlarmError(f"{telemetry.joint} {found}.", faults[0].hint)
        hold_c = self._hold_c(telemetry.joint)
        heating = self._heating.setdefault(telemetry.joint, _Heating())
        heating.update(telemetry)
        if telemetry.temperature_c < min(limits.warn_c, hold_c - _WARN_BELOW_C):
            return ()
        return (
            f"{telemetry.joint} is at {telemetry.temperature_c:.0f} °C; "
            f"motion stops at {hold_c:.0f} °C{heating.time_left(hold_c)}.",
        )

    def _hold_c(self, joint: str) -> float:
        """Return the lower of the arm file's holding limit and the servo's trip temperature."""
        hold_c = self._limits.hold_c
        # While an overheated arm is lowered, no limit applies.
        return min(hold_c, self._trip_c.get(joint, hold_c)) if hold_c < math.inf else hold_c

    def check_telemetry_age(self, time_s: float) -> None:
        """Check that every servo that has been read before was read recently.

        Raises:
            RefusedError: A servo was not read recently, so its status is unknown.
        """
        for joint, read_s in self._read_s.items():
            if not time_s - read_s <= _STALE_S:
                raise RefusedError(
                    f"No status (temperature, voltage, load) from {joint} for "
                    f"{time_s - read_s:.1f} s; stopped.",
                    "The arm holds its position. See: ikservo where",
                )

    def _find_faults(self, telemetry: ServoTelemetry) -> Iterator[_ThresholdFault]:
        """Yield each fault; the comparisons are written so that NaN also counts as a fault."""
        if not (telemetry.torque and telemetry.settings_intact):
            lost = "settings lost" if telemetry.torque else "torque is off"
            yield _ThresholdFault(f"was reset: {lost}", _RESET_HINT)
        if telemetry.alarms:
            alarms = ", ".join(sorted(str(alarm) for alarm in telemetry.alarms))
            yield _ThresholdFault(f"reports an alarm: {alarms}", alarm_hint(telemetry.alarms))
        celsius, hold_c = telemetry.temperature_c, self._hold_c(telemetry.joint)
        if not celsius < hold_c:
            found = f"is at {celsius:.0f} °C (limit {hold_c:.0f} °C)"
            yield _ThresholdFault(found, "Let it cool down: ikservo relax")
        servo_low_v, servo_high_v = self._supply_v.get(telemetry.joint, (-math.inf, math.inf))
        low_v = max(servo_low_v, self._limits.low_v)
        high_v = min(servo_high_v, self._limits.high_v)
        voltage_v = telemetry.voltage_v
        if not low_v <= voltage_v <= high_v:
            found = (
                f"has a supply voltage of {voltage_v:.1f} V, outside {low_v:.1f} to {high_v:.1f} V"
            )
            yield _ThresholdFault(found, "Check the power supply and its cable.")
        yield from self._load_faults(telemetry)

    def _load_faults(self, telemetry: ServoTelemetry) -> Iterator[_ThresholdFault]:
        """Yield a fault for a load that has been too high for too long."""
        if (
            telemetry.load_percent is None
            or abs(telemetry.load_percent) <= self._limits.load_percent
        ):
            self._loaded_s.pop(telemetry.joint, None)
            return
        duration_s = telemetry.time_s - self._loaded_s.setdefault(telemetry.joint, telemetry.time_s)
        if not (duration_s < self._limits.load_s and math.isfinite(telemetry.load_percent)):
            found = f"has been at {abs(telemetry.load_percent):.0f} % load for {duration_s:.1f} s"
            yield _ThresholdFault(
                found, "Reduce the load; check whether something blocks the joint."
            )


def alarm_hint(alarms: Container[str]) -> str:
    """Return advice on a servo's alarms, which are given as text."""
    if Alarm.VOLTAGE in alarms:
        return "Check the power supply and its cable. If the alarm stays: ikservo recover"
    return "Remove the load, or let the servo cool down. If the alarm stays: ikservo recover"


_RESET_HINT = (
    "Its supply voltage may have dropped. Check power and cables, then start the motion again."
)


def power_lost_error(
    joints: Sequence[str], silent: Sequence[str], *, holds: bool
) -> ServoAlarmError | ServoSilentError:
    """Return the error for an arm that has lost its power during a motion."""
    if len(silent) == len(joints):
        found = "does not answer; it has most likely lost its power, has fallen and is limp"
        hint = "Support it, then check the power. If only the data cable is loose, it still holds."
        return ServoSilentError(found, hint, servo="The arm")
    now = "and holds where it is now" if holds else "and is limp"
    found = f"has lost its power, has fallen {now}"
    if silent:
        verb = "does" if len(silent) == 1 else "do"
        found = f"{found}; {', '.join(silent)} {verb} not answer"
        return ServoSilentError(found, _RESET_HINT, servo="The arm")
    return ServoAlarmError(f"Every servo was reset: the arm {found}.", _RESET_HINT)


def say_what_fell(
    error: ServoAlarmError | ServoSilentError,
    limp: Sequence[str],
    caught: Sequence[str],
    silent: Sequence[str],
) -> ServoAlarmError | ServoSilentError:
    """Add to an error which joints have fallen and which hold; return the error.

    ``limp`` servos answer without torque; ``caught`` servos were reset and have torque again.
    """
    is_known = "limp" in error.command_message
    states = [
        (() if is_known else limp, "has fallen and is limp", "have fallen and are limp"),
        (caught, "has fallen and holds where it is now", "have fallen and hold where they are now"),
        (
            silent,
            "has fallen and is limp if it has no power",
            "have fallen and are limp if they have no power",
        ),
    ]
    fell = [
        f"{', '.join(joints)} {one if len(joints) == 1 else many}"
        for joints, one, many in states
        if joints
    ]
    if limp or fell:
        error.command_message += f" {'; '.join([*fell, 'the other joints hold'])}."
    return error


def torque_lost_error(joints: Sequence[str]) -> ServoAlarmError:
    """Return the error for joints whose servos have lost their torque during a motion."""
    were, what = ("was", "joint") if len(joints) == 1 else ("were", "arm")
    text = f"{', '.join(joints)} {were} reset, so torque is off. The {what} is limp and has fallen."
    return ServoAlarmError(text, _RESET_HINT)
