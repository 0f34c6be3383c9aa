"""Whether the servos are well: temperature, supply, load, alarms, and whether one was reset."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ikservo.errors import RefusedError, ServoAlarmError
from ikservo.model.health import HealthLimits

__all__ = ["Health", "HealthLimits", "Vitals"]

# A joint whose servo was not asked for this long is not known to be well.
_STALE_S = 1.0


@dataclass(frozen=True, slots=True)
class Vitals:
    """What a servo under torque tells about itself, besides where it is.

    Attributes:
        joint: The joint it turns.
        time_s: When it was asked.
        temperature_c: Its temperature.
        voltage_v: Its supply.
        load_percent: Its load as a share of the most there is, signed; None where it tells none.
        torque: Whether its torque is on.
        canary: Whether its RAM still holds what was written there.
        alarms: What it complains about, in words.
    """

    joint: str
    time_s: float
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    canary: bool
    alarms: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Fault:
    found: str
    hint: str


class Health:
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

    def see(self, vitals: Vitals) -> tuple[str, ...]:
        """Return what a person should be told, in words.

        Raises:
            ServoAlarmError: The arm must hold: a servo is too hot, overloaded, wrongly fed, was
                reset, complains, or tells no numbers.
        """
        limits = self._limits
        self._asked_s[vitals.joint] = vitals.time_s
        self.release |= vitals.temperature_c >= limits.release_c
        faults = list(self._faults(vitals))
        if faults:
            found = "; ".join(fault.found for fault in faults)
            raise ServoAlarmError(f"{vitals.joint} {found}.", faults[0].hint)
        if vitals.temperature_c < limits.warn_c:
            return ()
        return (
            f"{vitals.joint} is at {vitals.temperature_c:.0f} °C; "
            f"motion stops at {limits.hold_c:.0f} °C.",
        )

    def check(self, time_s: float) -> None:
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

    def _faults(self, vitals: Vitals) -> Iterator[_Fault]:
        yield from _reset(vitals)
        if vitals.alarms:
            words = ", ".join(sorted(str(alarm) for alarm in vitals.alarms))
            yield _Fault(
                f"reports an alarm: {words}",
                "Remove the load, or let it cool down: ikservo recover",
            )
        yield from self._heat(vitals.temperature_c)
        yield from self._supply(vitals)
        yield from self._load(vitals)

    def _heat(self, celsius: float) -> Iterator[_Fault]:
        # Written so that no number at all is a fault, too.
        if not celsius < self._limits.hold_c:
            found = f"is at {celsius:.0f} °C (limit {self._limits.hold_c:.0f} °C)"
            yield _Fault(found, "Let it cool down: ikservo relax")

    def _supply(self, vitals: Vitals) -> Iterator[_Fault]:
        servo_low_v, servo_high_v = self._supply_v.get(vitals.joint, (-math.inf, math.inf))
        low_v = max(servo_low_v, self._limits.low_v)
        high_v = min(servo_high_v, self._limits.high_v)
        if not low_v <= vitals.voltage_v <= high_v:
            found = (
                f"has a supply of {vitals.voltage_v:.1f} V, outside {low_v:.1f} to {high_v:.1f} V"
            )
            yield _Fault(found, "Check the power supply and its cable.")

    def _load(self, vitals: Vitals) -> Iterator[_Fault]:
        """Yield a fault for a load that has been too high for too long."""
        if vitals.load_percent is None or abs(vitals.load_percent) <= self._limits.load_percent:
            self._loaded_s.pop(vitals.joint, None)
            return
        lasts_s = vitals.time_s - self._loaded_s.setdefault(vitals.joint, vitals.time_s)
        if not (lasts_s < self._limits.load_s and math.isfinite(vitals.load_percent)):
            found = f"has been at {abs(vitals.load_percent):.0f} % load for {lasts_s:.1f} s"
            yield _Fault(found, "Reduce the load; check whether something blocks the joint.")


def _reset(vitals: Vitals) -> Iterator[_Fault]:
    if not (vitals.torque and vitals.canary):
        lost = "settings lost" if vitals.torque else "torque is off"
        yield _Fault(
            f"was reset: {lost}",
            "Its supply voltage may have dropped. Check power and cables, then start the motion "
            "again.",
        )
