"""How hard a servo may press: its torque limit in RAM, gone with its power."""

from __future__ import annotations

from ikservo.errors import RegisterAccessError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import OperatingMode, Register, Role

__all__ = ["limit_force", "torque_limit_registers"]


def limit_force(bus: ServoBus, servo_id: int, share: float) -> None:
    """Limit a servo's torque to a share (0 to 1) of what its own settings allow at most.

    Raises:
        RegisterAccessError: The model has no such limit.
        BusError: It does not take it.
    """
    registers = torque_limit_registers(bus, servo_id)
    if registers is None:
        servo = str(bus.servos[servo_id])
        raise RegisterAccessError(servo, "its torque limit", "there is none in RAM")
    limit, most = registers
    top = bus.read(servo_id, most, raw=True)
    bus.write(servo_id, limit, max(1, round(share * top)), raw=True)


def torque_limit_registers(bus: ServoBus, servo_id: int) -> tuple[Register, Register] | None:
    """Return the RAM register that limits a servo's torque, and the one with the most it may hold.

    Feetech STS and older Dynamixel have a torque limit in RAM. Dynamixel X limits its current by
    the goal current where it is in current-based position mode, else its duty by the goal PWM.
    None where the model has no such register.

    Raises:
        BusError: The servo does not say which mode it is in.
    """
    registers = bus.servos[servo_id].table.registers
    if "torque_limit" in registers:
        return registers["torque_limit"], registers["max_torque"]
    if "goal_current" in registers:
        mode = bus.read(servo_id, Role.OPERATING_MODE, raw=True)
        if mode == OperatingMode.CURRENT_BASED_POSITION:
            return registers["goal_current"], registers["current_limit"]
    if "goal_pwm" in registers:
        return registers["goal_pwm"], registers["pwm_limit"]
    return None
