"""What servos complain about, in one vocabulary for every family."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

__all__ = ["Alarm", "decode_alarms"]


class Alarm(StrEnum):
    """Something a servo reports about itself; the value is what a person reads."""

    VOLTAGE = "supply voltage outside its limits"
    ENCODER = "position sensor fault"
    HEAT = "too hot"
    CURRENT = "too much current"
    SHOCK = "electrical shock or too little power for the motor"
    OVERLOAD = "overload"
    UNKNOWN = "hardware alert, see its error register"


def decode_alarms(bits: int, meaning: Mapping[int, Alarm]) -> frozenset[Alarm]:
    """Return the alarms that a status byte reports.

    Args:
        bits: The byte as the servo gives it.
        meaning: Bit number to alarm, from the servo's table. A bit that the sheet does not
            name is reported as ``Alarm.UNKNOWN`` rather than passed over.
    """
    if not bits:
        return frozenset()
    set_bits = (bit for bit in range(8) if bits >> bit & 1)
    return frozenset(meaning.get(bit, Alarm.UNKNOWN) for bit in set_bits)
