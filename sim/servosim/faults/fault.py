"""One fault: what, to whom, when, how often; and the files that list them."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from servosim.errors import FaultError

__all__ = ["Fault", "read_faults"]

_WHOLE = ("id", "bytes", "bits")
_RANGES = {
    "id": (0, 253),
    "at_s": (-math.inf, math.inf),
    "for_s": (0.0, math.inf),
    "count": (0, math.inf),
    "probability": (0.0, 1.0),
    "delay_s": (0.0, 3600.0),
    "bytes": (0, 4096),
    "bits": (0, 255),
    "volts": (0.0, 60.0),
    "celsius": (-55.0, 300.0),
    "grip": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong.

    Attributes:
        kind: See ``servosim.faults.replies`` and ``servosim.faults.events``.
        id: The servo it happens to; None for all.
        at_s: When it begins, in seconds of the simulation.
        for_s: How long it lasts.
        count: At most so often (faults of replies and instructions).
        probability: Chance each time (faults of replies and instructions).
        delay_s: Of a late reply.
        bytes: Of garbage, or left of a short reply.
        bits: Flipped in a reply, or set in an alarm.
        volts: Of a wrong supply.
        celsius: Of an overheated servo.
        grip: Share of the torque that slipping gears pass on.
    """

    kind: str
    id: int | None = None
    at_s: float = 0.0
    for_s: float = math.inf
    count: float = math.inf
    probability: float = 1.0
    delay_s: float = 0.05
    bytes: int = 3
    bits: int = 1
    volts: float = 4.0
    celsius: float = 90.0
    grip: float = 0.2

    def __post_init__(self) -> None:
        for name, (lower, upper) in _RANGES.items():
            value = getattr(self, name)
            if name == "id" and value is None:
                continue
            if name in _WHOLE and (isinstance(value, bool) or not isinstance(value, int)):
                raise FaultError(f"{name} = {value!r} is no whole number")
            if not lower <= value <= upper:
                raise FaultError(f"{name} = {value!r} is not between {lower:g} and {upper:g}")

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Fault:
        """Return the fault that a table of a file describes.

        Raises:
            FaultError: An unknown key or kind, or a value of the wrong kind.
        """
        known = [field.name for field in fields(cls)]
        for key, value in table.items():
            if key not in known:
                raise FaultError(f"a fault has no {key!r}; it has: {', '.join(known)}")
            if not isinstance(value, str if key == "kind" else (int, float)):
                raise FaultError(f"{key} = {value!r} has the wrong kind")
        if "kind" not in table:
            raise FaultError("a fault needs a kind")
        return cls(**table)


def read_faults(path: Path) -> list[Fault]:
    """Return the faults of a file: TOML with ``[[fault]]`` tables, or JSON with a list.

    Raises:
        FaultError: The file cannot be read, or a fault in it is none.
    """
    try:
        text = path.read_text(encoding="utf-8")
        listed = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)["fault"]
    except KeyError as error:
        raise FaultError(f"{path}: no [[fault]] in it") from error
    except (OSError, ValueError) as error:
        raise FaultError(f"{path}: {error}") from error
    try:
        return [Fault.of(table) for table in listed]
    except (FaultError, AttributeError, TypeError) as error:
        raise FaultError(f"{path}: {error}") from error
