"""What the page says beside the picture, in the words of the command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ikservo.calibration import say
from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Vector
from ikservo.view.scene.aim import Aim

if TYPE_CHECKING:
    from ikservo.arm import JointState
    from ikservo.model.health import HealthLimits

__all__ = ["aim_words", "health_rows", "point", "range_words", "solver_words", "supply_words"]

_LOADED_PERCENT = 80.0


def point(at_m: Vector) -> str:
    """Return ``(0.250, 0.000, 0.150) m``."""
    return f"({', '.join(f'{float(x):z.3f}' for x in at_m)}) m"


def aim_words(aim: Aim, method: str | None = None) -> str:
    """Return what became of the target: reached, or how near and what holds the arm back.

    Args:
        aim: The target.
        method: The iteration that ended there, which need not be the nearest point that there is.
    """
    if aim.reached:
        return f"target {point(aim.target_m)}"
    if method is not None:
        return f"{method} ended {aim.gap_m * 1000:.1f} mm from {point(aim.target_m)}."
    held = f" ({', '.join(map(str, aim.binding))})" if aim.binding else ""
    return (
        f"{point(aim.target_m)} cannot be reached{held}. Nearest reachable point: "
        f"{point(aim.nearest_m)}, {aim.gap_m * 1000:.1f} mm away."
    )


def solver_words(solve_s: float) -> str:
    """Return ``0.04 ms``."""
    return f"{solve_s * 1000:.2f} ms"


def supply_words(volts: Sequence[float]) -> str:
    """Return ``7.4 V``, or ``11.8 – 12.1 V`` where servos see different voltages."""
    low, high = f"{min(volts):.1f}", f"{max(volts):.1f}"
    return f"{low} V" if low == high else f"{low} – {high} V"


def range_words(chain: Chain, column: int, position: float, limit_from: str) -> str:
    """Return ``elbow_flex 12.3°, -96.8° to 96.8° (arm file)``."""
    unit = "m" if chain.kinds[column] is JointKind.PRISMATIC else "rad"
    low, high = float(chain.lower_rad[column]), float(chain.upper_rad[column])
    at = f"{chain.names[column]} {say(position, unit)}"
    if not math.isfinite(high - low):
        return f"{at}, turns freely"
    return f"{at}, {say(low, unit)} to {say(high, unit)} ({limit_from})"


def health_rows(states: Sequence[JointState], limits: HealthLimits) -> list[dict[str, object]]:
    """Return a row for each servo: temperature, voltage, load, torque, alarms, how bad it is.

    Args:
        states: The servos.
        limits: From which temperatures on the arm warns and holds.
    """
    return [
        {
            "name": state.name,
            "temperature": f"{state.temperature_c:.0f} °C",
            "voltage": f"{state.voltage_v:.1f} V",
            "load": "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
            "torque": "on" if state.torque else "off",
            "alarms": ", ".join(state.alarms),
            "level": _level(state, limits),
        }
        for state in states
    ]


def _level(state: JointState, limits: HealthLimits) -> str:
    if state.alarms or state.temperature_c >= limits.hold_c:
        return "red"
    loaded = abs(state.load_percent or 0.0) >= _LOADED_PERCENT
    return "amber" if state.temperature_c >= limits.warn_c or loaded else "good"
