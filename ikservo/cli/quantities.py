"""Quantities with units on the command line: ``250mm``, ``30deg``, ``5N``, ``500ms``."""

from __future__ import annotations

import math
import re

import typer

_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-z°]*)", re.IGNORECASE)
_METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_TOOL_SPEEDS = {"": 0.001, "mm": 0.001, "cm": 0.01, "m": 1.0}
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SECONDS = {"": 1.0, "s": 1.0, "ms": 0.001, "min": 60.0}
_NEWTONS = {"": 1.0, "n": 1.0, "mn": 0.001}
_RADIANS = {"": math.pi / 180, "deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0}


def parse_length_m(text: str | float) -> float:
    """Parse metres from ``0.25``, ``0.25m``, ``25cm`` or ``250mm``.

    A number of at least 1 needs a unit, because lengths on a table are rarely that large.
    """
    length_m = parse_coordinate_m(text)
    bare = str(text).strip()
    if abs(length_m) >= 1.0 and not bare[-1].isalpha():
        bare = bare.replace("\N{MINUS SIGN}", "-")
        raise typer.BadParameter(
            f"{bare} without a unit means metres. Did you mean {bare}mm? If not, write {bare}m"
        )
    return length_m


def parse_coordinate_m(text: str | float) -> float:
    """Parse metres like ``parse_length_m``, but accept large numbers without a unit.

    A point that was meant in millimetres is out of reach, and the user is then asked.
    """
    return _parse_quantity(str(text), _METRES, "a length such as 0.25, 250mm or 25cm")


def parse_angle_rad(text: str) -> float:
    """Parse radians from degrees, ``30`` or ``30deg``, or from ``0.2rad``."""
    return _parse_quantity(text, _RADIANS, "an angle such as 30, 30deg or 0.2rad")


def parse_force_n(text: str) -> float:
    """Parse newtons from ``5``, ``5N`` or ``500mN``."""
    return _parse_quantity(text, _NEWTONS, "a force such as 5, 5N or 500mN")


def parse_time_s(text: str | float) -> float:
    """Parse seconds above 0 from ``2``, ``2s``, ``500ms`` or ``1min``."""
    time_s = _parse_quantity(str(text), _SECONDS, "a time such as 2, 2s, 500ms or 1min")
    if time_s <= 0.0:
        raise typer.BadParameter(f"{text!r} is not a time above 0.")
    return time_s


def parse_tool_speed_m_s(text: str) -> float:
    """Parse m/s above 0 from ``50``, ``50mm/s``, ``5cm/s`` or ``0.05m/s``."""
    speed_m_s = _parse_quantity(
        text.strip().removesuffix("/s"), _TOOL_SPEEDS, "a speed such as 50, 50mm/s or 0.05m/s"
    )
    if speed_m_s <= 0.0:
        raise typer.BadParameter(f"{text!r} is not a speed above 0.")
    return speed_m_s


def parse_pixels(text: str | float) -> float:
    """Parse a horizontal or vertical pixel coordinate, which may be outside the picture."""
    try:
        return float(str(text).replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number of pixels.") from None


def parse_axis(text: str) -> tuple[float, float, float]:
    """Parse a direction from ``x``, ``y`` or ``z``, or from three numbers such as ``0,0,-1``."""
    if text.lower() in _AXES:
        return _AXES[text.lower()]
    parts = [
        _NUMBER.fullmatch(part.strip()) for part in text.replace("\N{MINUS SIGN}", "-").split(",")
    ]
    numbers = [float(part[1]) for part in parts if part is not None and not part[2]]
    if len(parts) != 3 or len(numbers) != 3:
        raise typer.BadParameter(f"{text!r} is not a direction such as x or 0,0,-1.")
    return (numbers[0], numbers[1], numbers[2])


def parse_point_m(text: str) -> tuple[float, float, float]:
    """Parse a point in metres from three lengths such as ``0.25,-50mm,0.1``."""
    parts = text.split(",")
    if len(parts) != 3:
        raise typer.BadParameter(f"{text!r} is not a point such as 0.25,-50mm,0.1.")
    return (parse_length_m(parts[0]), parse_length_m(parts[1]), parse_length_m(parts[2]))


def _parse_quantity(text: str, units: dict[str, float], expected: str) -> float:
    text = text.replace("\N{MINUS SIGN}", "-")
    match = _NUMBER.fullmatch(text.strip())
    if match is None and re.fullmatch(r"[-+]?\d+,\d+\s*[a-z°]*", text.strip(), re.IGNORECASE):
        point = text.replace(",", ".")
        raise typer.BadParameter(f"{text!r} has a comma; use a decimal point: {point}")
    if match is None or match[2].lower() not in units:
        raise typer.BadParameter(f"{text!r} is not {expected}.")
    value = float(match[1]) * units[match[2].lower()]
    if not math.isfinite(value):
        raise typer.BadParameter(f"{text!r} is not finite. Expected {expected}.")
    return value
