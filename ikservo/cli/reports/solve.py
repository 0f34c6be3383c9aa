"""What ``ikservo solve`` says of one answer, for a person and for a program."""

from __future__ import annotations

import math

from ikservo.cli.choosing import limit_sources, limit_words
from ikservo.cli.output import point, print_json, print_lines
from ikservo.cli.reports.conditioning import result_fields, result_lines
from ikservo.cli.reports.joints import joint_lines
from ikservo.cli.reports.reach import why_short
from ikservo.cli.reports.solutions import joint_units
from ikservo.cli.reports.torques import torque_lines
from ikservo.ik import Result, Target
from ikservo.kinematics import joint_torques
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["print_result"]


# Methods that walk from one start and may end beside a target that others reach.
_WALKS = ("pseudo_inverse", "transpose", "ccd")


def print_result(
    model: Model,
    target: Target,
    result: Result,
    *,
    force_n: Vector | None = None,
    json: bool,
) -> None:
    """Print the joints, how close they come, what holds them back, and how they stand there.

    With a force (3,) at the tip also the torques that it has on the joints.
    """
    torques = None if force_n is None else joint_torques(model.chain, result.q, force_n)
    if json:
        print_json("solve", **_fields(model, result, torques))
        return
    print_lines([*_lines(model, target, result), *_posture(result)])
    if torques is not None:
        print_lines(torque_lines(model.chain, torques))


def _fields(model: Model, result: Result, torques: Vector | None) -> dict[str, object]:
    found = result.solutions
    fields: dict[str, object] = {} if torques is None else {"torques_nm": torques}
    return fields | {
        "reached": result.reached,
        "q_rad": result.q,
        "joints_rad": dict(zip(model.chain.names, result.q.tolist(), strict=True)),
        "limit_from": limit_sources(model),
        "position_error_m": result.position_error_m,
        "orientation_error_rad": result.orientation_error_rad,
        "method": result.method,
        "iterations": result.iterations,
        "nearest_m": result.nearest_m,
        "binding": [limit_words(model, limit) for limit in result.binding],
        "solutions": {"kind": found.kind, "count": found.count, "freedom": found.freedom},
        **result_fields(result),
    }


def _posture(result: Result) -> list[str]:
    """Return what to say of an answer besides: others like it, and how freely it moves."""
    others = [f"solutions  {result.solutions}"] if result.reached else []
    return [*others, *result_lines(result)]


def _lines(model: Model, target: Target, result: Result) -> list[str]:
    units = joint_units(model.chain)
    joints = zip(model.chain.names, zip(result.q.tolist(), units, strict=True), strict=True)
    lines = joint_lines(dict(joints))
    lines.append(f"{result.method}, {result.iterations} iterations")
    if result.reached:
        return [*lines, f"error  {_left(target, result)}"]
    held = ", ".join(limit_words(model, limit) for limit in result.binding)
    held = held or why_short(model.chain, target)
    nearest = point(result.nearest_m.tolist())
    walked = result.method in _WALKS
    said = f"not reached by {result.method}" if walked else "out of reach"
    lines.append(f"{said}: {held}")
    return [*lines, f"nearest  {nearest}, {_left(target, result, 1)} away"]


def _left(target: Target, result: Result, digits: int = 4) -> str:
    gap = f"{result.position_error_m * 1000:.{digits}f} mm"
    if target.only_position and result.orientation_error_rad == 0.0:
        return gap
    return f"{gap} and {math.degrees(result.orientation_error_rad):.{digits}f}°"
