"""Torque on and off, with a check of the supply voltage."""

from __future__ import annotations

from collections.abc import Iterable

from ikservo.errors import BusError, ServoAlarmError, ServoRejectedError
from ikservo.hardware.bus import ServoBus
from ikservo.registers import RegisterName

__all__ = ["check_supply_voltage", "torque_off", "torque_on"]


def torque_on(bus: ServoBus, servo_id: int) -> int:
    """Enable torque of a servo at its measured position; return that tick.

    Its goal is set to the measured position and read back before torque comes on, because a
    joint that was moved by hand would otherwise jump to an old goal.

    Raises:
        ServoAlarmError: Its supply voltage is outside its own limits.
        BusError: It does not reply, or does not accept the goal.
    """
    check_supply_voltage(bus, servo_id)
    present_tick = bus.read(servo_id, RegisterName.PRESENT_POSITION, raw=True)
    bus.write(servo_id, RegisterName.GOAL_POSITION, present_tick, raw=True)
    goal_tick = bus.read(servo_id, RegisterName.GOAL_POSITION, raw=True)
    if goal_tick != present_tick:
        raise ServoRejectedError(
            f"keeps goal {goal_tick} instead of {present_tick}, its position",
            "Move the joint by hand into its limits; torque stays off.",
            servo=str(bus.servos[servo_id]),
            servo_id=servo_id,
            port=bus.port.name,
        )
    bus.write(servo_id, RegisterName.TORQUE_ENABLE, 1, raw=True)
    return present_tick


def torque_off(bus: ServoBus, servo_ids: Iterable[int]) -> dict[int, BusError]:
    """Disable torque of all servos that can be reached; return the errors of the others.

    Raises:
        PortLostError: The port is lost; no servo can be reached any more.
    """
    errors: dict[int, BusError] = {}
    for servo_id in servo_ids:
        try:
            bus.write(servo_id, RegisterName.TORQUE_ENABLE, 0, raw=True)
        except BusError as error:
            errors[servo_id] = error
    return errors


def check_supply_voltage(bus: ServoBus, servo_id: int) -> float:
    """Return the servo's supply voltage, if it is within the servo's own limits.

    Raises:
        ServoAlarmError: It does not.
        BusError: The servo does not reply.
    """
    voltage_v = bus.read(servo_id, RegisterName.PRESENT_VOLTAGE)
    lower_v = bus.read(servo_id, RegisterName.MIN_VOLTAGE_LIMIT)
    upper_v = bus.read(servo_id, RegisterName.MAX_VOLTAGE_LIMIT)
    if lower_v <= voltage_v <= upper_v:
        return voltage_v
    raise ServoAlarmError(
        f"{bus.servos[servo_id]} has a supply of {voltage_v:.1f} V; "
        f"its own limits are {lower_v:.1f} to {upper_v:.1f} V.",
        "Check the power supply; torque stays off.",
    )
