"""Texts of the page, formatted as on the command line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikservo.apps.page.dragging.goal_planning import PlannedPath
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.messages.message_fields import StopInput
from ikservo.apps.page.picking.picking import PickCandidate
from ikservo.apps.page.picking.visibility import PostureAnalysis
from ikservo.errors import format_point
from ikservo.kinematics.conditioning import Conditioning
from ikservo.planning.reports import describe_alarms, describe_torque

if TYPE_CHECKING:
    from ikservo.arm import JointState
    from ikservo.model.arm_model import HealthLimits

STOP_TEXTS: dict[StopInput, str] = {
    "button": "Stopped from the page",
    "Space": "Stopped by the Space key on the page",
    "Escape": "Stopped by the Escape key on the page",
    "gamepad": "Stopped by a gamepad on the page",
}
"""Text for each control that can stop the arm, as the beginning of a sentence."""

_LOADED_PERCENT = 80.0
_JAWS_MOVE = 0.005  # rad or m
_SAME_POINT_M = 1e-4
# A supply outside these fractions of the nominal voltage is wrong or exhausted: the three cells of
# an 11.1 V battery give 9 to 12.6 V.
_LOW_SUPPLY, _HIGH_SUPPLY = 0.8, 1.2


def describe_target(marker: TargetMarker, method: str | None = None) -> str:
    """Describe the result for a target: reached, or the nearest point and the active limits.

    The iterative ``method`` has not necessarily ended at the nearest point.
    """
    if marker.reached:
        return f"target {format_point(marker.target_m)}"
    if method is not None:
        return f"{method} ended {marker.gap_m * 1000:.1f} mm from {format_point(marker.target_m)}."
    limits_text = f" ({', '.join(map(str, marker.binding))})" if marker.binding else ""
    if marker.turn_error_rad and marker.gap_m < _SAME_POINT_M:
        return (
            f"The tool cannot have this orientation here{limits_text}: "
            f"the nearest one differs by {math.degrees(marker.turn_error_rad):.1f}°."
        )
    return (
        f"{format_point(marker.target_m)} cannot be reached{limits_text}. Nearest reachable point: "
        f"{format_point(marker.nearest_m)}, {marker.gap_m * 1000:.1f} mm away."
    )


def path_rows(path: PlannedPath | None) -> list[tuple[str, str, str]]:
    """Return the row about the path to the goal: kind, length, time and clearance."""
    if path is None or path.refusal is not None:
        return []
    plan = path.plan
    if plan is None:
        return [("path", "is being planned", "")]
    direct = "straight" if path.is_straight else "leaving contact"
    others = np.array([list(others.values()) for _, others in path.postures])
    jaws_move = path.run is not None and others.size and np.ptp(others, axis=0).max() > _JAWS_MOVE
    how = "around" if plan.around else "with the jaws" if jaws_move else direct
    text = f"{how}, {plan.path_m * 1000:.0f} mm, {plan.duration_s:.1f} s"
    if 0.0 < plan.clearance_m < math.inf:
        text += f", {plan.clearance_m * 1000:.0f} mm clear"
    return [("path", text, "")]


def describe_stop(text: str, states: Sequence[JointState]) -> str:
    """Describe why the arm was stopped, and whether it holds."""
    return f"{text.removesuffix('.')}; {describe_torque(states)}."


def format_solve_time(solve_s: float) -> str:
    """Format a time as ``0.04 ms``."""
    return f"{solve_s * 1000:.2f} ms"


def format_supply(volts: Sequence[float]) -> str:
    """Format voltages as ``7.4 V``, or as ``11.8 – 12.1 V`` if servos differ."""
    low, high = f"{min(volts):.1f}", f"{max(volts):.1f}"
    return f"{low} V" if low == high else f"{low} – {high} V"


def health_rows(states: Sequence[JointState], limits: HealthLimits) -> list[dict[str, object]]:
    """Return a row for each servo: temperature, voltage, load, torque, alarms, warning level."""
    rows: list[dict[str, object]] = []
    for state in states:
        is_loaded = abs(state.load_percent or 0.0) >= _LOADED_PERCENT
        level = "amber" if state.temperature_c >= limits.warn_c or is_loaded else "good"
        if state.alarms or state.temperature_c >= limits.hold_c:
            level = "red"
        rows.append(
            {
                "name": state.name,
                "temperature": f"{state.temperature_c:.0f} °C",
                "voltage": f"{state.voltage_v:.1f} V",
                "load": "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
                "torque": "on" if state.torque else "off",
                "alarms": ", ".join(state.alarms),
                "level": level,
            }
        )
    return rows


def condition_rows(
    states: Sequence[JointState], supply_v: float | None, limits: HealthLimits
) -> list[tuple[str, str, str]]:
    """Return rows of name, text and level for present faults: supply, alarms, torque off."""
    rows: list[tuple[str, str, str]] = []
    low_v, high_v = limits.low_v, limits.high_v
    if supply_v is not None:
        low_v, high_v = max(low_v, _LOW_SUPPLY * supply_v), min(high_v, _HIGH_SUPPLY * supply_v)
    volts = [state.voltage_v for state in states]
    wrong = [each for each in volts if not low_v <= each <= high_v]
    if wrong:
        side = f"below {low_v:.1f} V" if min(wrong) < low_v else f"above {high_v:.1f} V"
        rows.append(("supply", f"{format_supply(volts)}, {side}", "bad"))
    rows += [(names, alarms, "bad") for names, alarms in describe_alarms(states)]
    limp = [state.name for state in states if not state.torque]
    if limp and len(limp) < len(states):
        rows.append(("limp", ", ".join(limp), "warn"))
    return rows


_NEAR_RAD = math.radians(10.0)
_UNITS = {1: "m", 2: "m²", 3: "m³"}


def insight_rows(
    measured: Conditioning, analysis: PostureAnalysis | None
) -> list[tuple[str, str, str]]:
    """Return rows of name, text, level: manipulability, singularity, hidden links if known."""
    unit = _UNITS.get(len(measured.moves_m_rad), "")
    value = f"{measured.manipulability:.2g} {unit}, "
    rows = [("manipulability", f"{value}at worst {measured.slowest_m_rad * 1000:.0f} mm/rad", "")]
    if analysis is None:
        return rows
    nearest = analysis.singularity
    if nearest is None:
        rows.append(("singularity", "none inside the limits", ""))
    else:
        text = f"{math.degrees(nearest.distance_rad):.1f}° away, mostly by {nearest.joint}"
        rows.append(("singularity", text, "warn" if nearest.distance_rad < _NEAR_RAD else ""))
    hidden = [
        f"{seen.link} (by {seen.hidden_by[0]})" if seen.hidden_by else seen.link
        for seen in analysis.seen
        if not seen.is_visible
    ]
    return [*rows, ("hidden here", ", ".join(hidden), "")] if hidden else rows


_KIND_NAMES = {"link": "", "fixed": "does not move", "object": "object"}
_TIP = {"name": "the tip moves here", "what": "", "at": "", "depth": "", "depth_m": None}


def candidate_rows(options: Sequence[PickCandidate | None], chosen: int) -> list[dict[str, object]]:
    """Return a row for each thing under the pointer: name, hit point, depth behind the first.

    An option of None stands for the plane of the view.
    """
    first_m = min((found.hit.depth_m for found in options if found is not None), default=0.0)
    rows: list[dict[str, object]] = []
    for index, found in enumerate(options):
        if found is None:
            rows.append({**_TIP, "chosen": index == chosen})
            continue
        behind_m = found.hit.depth_m - first_m
        rows.append(
            {
                "name": found.hit.link,
                "what": _KIND_NAMES[found.kind],
                "at": format_point(found.hit.point_m),
                "depth": "nearest" if behind_m <= 0.0 else f"{behind_m * 1000:.0f} mm behind",
                "depth_m": round(found.hit.depth_m, 6),
                "chosen": index == chosen,
            }
        )
    return rows
