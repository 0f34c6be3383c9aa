"""What ``ikservo solve`` says of one answer, for a person and for a program."""

from __future__ import annotations

import math

from ikservo.cli.choosing import limit_sources, limit_words
from ikservo.cli.output import point, print_json, print_lines
from ikservo.cli.reports.solutions import joint_words
from ikservo.ik import BUILD, Result, Target
from ikservo.model import Model

__all__ = ["print_result"]


# Methods that walk from one start and may end beside a target that others reach.
_WALKS = ("pseudo_inverse", "transpose", "ccd")


def print_result(model: Model, target: Target, result: Result, *, json: bool) -> None:
    """Print the joints, how close they come, and what holds them back."""
    if json:
        print_json("solve", **_fields(model, result))
    else:
        print_lines(_lines(model, target, result))


def _fields(model: Model, result: Result) -> dict[str, object]:
    return {
        "reached": result.reached,
        "q_rad": result.q,
        "limit_from": limit_sources(model),
        "position_error_m": result.position_error_m,
        "orientation_error_rad": result.orientation_error_rad,
        "method": result.method,
        "iterations": result.iterations,
        "nearest_m": result.nearest_m,
        "binding": [limit_words(model, limit) for limit in result.binding],
    }


def _lines(model: Model, target: Target, result: Result) -> list[str]:
    words = joint_words(model.chain, result.q)
    lines = [f"{name}  {word}" for name, word in zip(model.chain.names, words, strict=True)]
    lines.append(f"{result.method}, {result.iterations} iterations")
    if result.reached:
        return [*lines, f"error  {_left(target, result)}"]
    held = ", ".join(limit_words(model, limit) for limit in result.binding) or BUILD
    nearest = point(result.nearest_m.tolist())
    walked = result.method in _WALKS
    said = f"not reached by {result.method}" if walked else "not reachable"
    lines.append(f"{said}: held back by {held}")
    return [*lines, f"nearest  {nearest}, {_left(target, result, 1)} away"]


def _left(target: Target, result: Result, digits: int = 4) -> str:
    gap = f"{result.position_error_m * 1000:.{digits}f} mm"
    if target.only_position and result.orientation_error_rad == 0.0:
        return gap
    return f"{gap} and {math.degrees(result.orientation_error_rad):.{digits}f}°"
