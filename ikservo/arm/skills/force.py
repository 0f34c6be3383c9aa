"""How hard a servo may press: its torque limit in RAM, gone with its power."""

from __future__ import annotations

from collections.abc import Mapping

from ikservo.errors import RegisterAccessError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import Register, Role

__all__ = ["limit_force"]

_CURRENT_POSITION = 5  # operating mode of Dynamixel X
_WHOLE_SCALE = 1000  # of Feetech's torque limit, where nothing else is said


def limit_force(bus: ServoBus, servo_id: int, share: float) -> None:
    """Limit a servo's torque to a share (0 to 1) of what its own settings allow at most.

    Feetech and older Dynamixel have a torque limit in RAM. Dynamixel X limits its current by the
    goal current where it is in current-based position mode, else its duty by the goal PWM.

    Raises:
        RegisterAccessError: The model has no such limit.
        BusError: It does not take it.
    """
    registers = bus.servos[servo_id].table.registers
    own, most = _limit(bus, servo_id, registers)
    top = bus.read(servo_id, most, raw=True) if most else _WHOLE_SCALE
    bus.write(servo_id, own, max(1, round(share * top)), raw=True)


def _limit(
    bus: ServoBus, servo_id: int, registers: Mapping[str, Register]
) -> tuple[Register, Register | None]:
    """Return the register that limits, and the one that holds the most it may be set to."""
    if "torque_limit" in registers:
        return registers["torque_limit"], registers.get("max_torque")
    if "goal_current" in registers:
        mode = bus.read(servo_id, Role.OPERATING_MODE, raw=True)
        if mode == _CURRENT_POSITION:
            return registers["goal_current"], registers["current_limit"]
    if "goal_pwm" in registers:
        return registers["goal_pwm"], registers["pwm_limit"]
    raise RegisterAccessError(str(bus.servos[servo_id]), "its torque limit", "there is none in RAM")
