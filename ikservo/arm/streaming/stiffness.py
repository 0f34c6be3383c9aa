"""Gains for servos whose own are so soft that they sag by 6° under an arm.

That is how far a joint sinks when its watchdog makes its goal where it stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ikservo.hardware.bus import ServoBus

__all__ = ["stiffen"]

# The gains at which owners of Koch and OMX arms run their elbows: a D part goes with so much P.
_ARM: Mapping[str, int] = MappingProxyType({"position_d_gain": 600, "position_p_gain": 1500})
# A gripper yields a little more.
_JAWS: Mapping[str, int] = MappingProxyType({"position_p_gain": 800})
_SOFT = ("XL330-M288", "XL330-M077")


def stiffen(bus: ServoBus, servo_id: int, *, jaws: bool) -> None:
    """Raise the gains of a servo that is too soft; in RAM, never below what stands there.

    Raises:
        BusError: It does not answer.
    """
    table = bus.servos[servo_id].table
    if table.model_name not in _SOFT:
        return
    for name, least in (_JAWS if jaws else _ARM).items():
        if bus.read(servo_id, table.registers[name], raw=True) < least:
            bus.write(servo_id, table.registers[name], least, raw=True)
