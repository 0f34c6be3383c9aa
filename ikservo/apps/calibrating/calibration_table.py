"""A calibration as text: zeros, signs and ranges, and the differences from an earlier one."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.calibration import format_position
from ikservo.calibration.records import CalibratedJoint, Calibration

COLUMNS = ("joint", "servo", "zero", "sign", "range", "measured")


def calibration_row(joint: CalibratedJoint) -> list[str]:
    """Return the table cells of a joint, in the order of ``COLUMNS``."""
    ids = " and ".join(f"{servo.model} (id {servo.id})" for servo in joint.servos)
    return [joint.name, ids, _zero(joint), _sign(joint), _range(joint), joint.swept]


def calibration_lines(calibration: Calibration) -> Iterator[str]:
    """Yield a line for each joint, without its servos."""
    for joint in calibration.joints:
        sign = f"servo counts {_sign(joint)}"
        yield f"{joint.name}: zero at {_zero(joint)}, {sign}, {_range(joint)} ({joint.swept})"


def difference_lines(new: Calibration, old: Calibration) -> Iterator[str]:
    """Yield a line for each joint whose zero, sign or range has changed."""
    for joint in new.joints:
        before = old.joint(joint.name)
        if before is None:
            yield f"{joint.name}: was not calibrated"
            continue
        named = {"zero": _zero, "sign": _sign, "range": _range}
        changed = [
            f"{name} was {text(before)}, is now {text(joint)}"
            for name, text in named.items()
            if text(before) != text(joint)
        ]
        if changed:
            yield f"{joint.name}: {'; '.join(changed)}"


def _zero(joint: CalibratedJoint) -> str:
    return f"tick {joint.zero_tick:g}"


def _sign(joint: CalibratedJoint) -> str:
    return "with the joint" if joint.sign == 1 else "against it"


def _range(joint: CalibratedJoint) -> str:
    unit = "m" if joint.lower_m is not None else "rad"
    shown = [format_position(end, unit) for end in joint.recorded_range() or ()]
    return " to ".join(shown) or "not measured"
