"""Switch torque on and off, with a check of the supply voltage."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ikservo.errors import BusError, RefusedError, ServoAlarmError, ServoRejectedError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.goal_writing import write_goals
from ikservo.hardware.register_access import MAX_ENABLING_TICKS
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import ControlTable, Family, RegisterName


def torque_on(bus: ServoBus, servo_id: int) -> int:
    """Switch a servo's torque on at its present position; return that tick.

    The servo's goal is set to this position and read back before torque is switched on, because a
    joint that was moved by hand would otherwise jump to an old goal. A joint slightly outside its
    servo's limits moves back inside them.

    Raises:
        ServoAlarmError: The supply voltage is outside the servo's limits.
        RefusedError: The servo is far outside its limits or in a different mode; torque stays off.
        BusError: The servo does not reply, or does not accept the goal.
    """
    check_supply_voltage(bus, servo_id)
    accepted = read_goal_range(bus, servo_id)
    bus.read(servo_id, RegisterName.TORQUE_ENABLE, raw=True)
    present_tick = bus.read(servo_id, RegisterName.PRESENT_POSITION, raw=True)
    goal_tick = nearest_goal(str(bus.servos[servo_id]), present_tick, accepted)
    with bus.enabling({servo_id: present_tick}):
        write_goals(bus, {servo_id: goal_tick}, {servo_id: accepted}, confirmed=True)
        kept_tick = bus.read(servo_id, RegisterName.GOAL_POSITION, raw=True)
        check_kept_goal(bus, servo_id, kept_tick, goal_tick)
        bus.write(servo_id, RegisterName.TORQUE_ENABLE, 1, raw=True)
    return goal_tick


def check_kept_goal(bus: ServoBus, servo_id: int, kept_tick: int, goal_tick: int) -> None:
    """Check a goal that was read back, before torque is switched on.

    Raises:
        ServoRejectedError: The servo still holds a different goal.
    """
    if kept_tick != goal_tick:
        raise ServoRejectedError(
            f"keeps goal {kept_tick} instead of its position, {goal_tick}",
            "Move the joint by hand back within its limits; torque stays off.",
            servo=str(bus.servos[servo_id]),
            servo_id=servo_id,
            port=bus.port.name,
        )


def nearest_goal(joint: str, tick: int, accepted: tuple[int, int]) -> int:
    """Find the tick nearest to ``tick`` that a servo accepts; see ``accepted_goal_range``.

    Raises:
        RefusedError: The joint is far outside its servo's limits; torque stays off.
    """
    low, high = accepted
    goal = min(max(tick, low), high)
    if abs(goal - tick) > MAX_ENABLING_TICKS:
        raise RefusedError(
            f"{joint} is at tick {tick}, far outside the range of its servo, {low} to {high}.",
            "Move the joint by hand back within its limits; torque stays off.",
        )
    return goal


def read_goal_range(bus: ServoBus, servo_id: int) -> tuple[int, int]:
    """Read the lowest and the highest goal that a servo accepts; see ``accepted_goal_range``.

    Raises:
        RefusedError: The servo is not in a position mode.
        BusError: The servo does not reply.
    """
    servo = bus.servos[servo_id]
    readings = bus.sync_read_many([servo_id], goal_range_registers(servo.table), raw=True)
    return accepted_goal_range(servo, readings.require_all()[servo_id])


def goal_range_registers(table: type[ControlTable]) -> tuple[RegisterName, ...]:
    """Return the registers that decide which goals a model accepts."""
    names = (
        RegisterName.MIN_POSITION_LIMIT,
        RegisterName.MAX_POSITION_LIMIT,
        RegisterName.OPERATING_MODE,
    )
    return tuple(name for name in names if name not in table.missing)


def accepted_goal_range(servo: ServoSpec, held: Mapping[RegisterName, int]) -> tuple[int, int]:
    """Return the lowest and highest goal that a servo accepts, by its ``goal_range_registers``.

    Raises:
        RefusedError: The servo is not in a position mode: with torque on, it would turn without
            end, or move by the goal relative to its position.
    """
    table, mode = servo.table, held.get(RegisterName.OPERATING_MODE)
    limits = held[RegisterName.MIN_POSITION_LIMIT], held[RegisterName.MAX_POSITION_LIMIT]
    if mode is None:
        if limits == (0, 0):
            raise _mode_error(servo, "both its position limits are 0")
        return limits
    if mode not in table.position_modes:
        raise _mode_error(servo, f"its operating mode is {mode}")
    several_turns = mode != table.position_modes[0]
    if table.family is Family.FEETECH_STS:
        several_turns = limits == (0, 0)
    return table.find(RegisterName.GOAL_POSITION).range if several_turns else limits


def _mode_error(servo: ServoSpec, reason: str) -> RefusedError:
    hint = "Torque stays off. Calibrate the arm: ikservo calibrate"
    return RefusedError(f"{servo} cannot hold a position: {reason}.", hint)


def torque_off(bus: ServoBus, servo_ids: Iterable[int]) -> dict[int, BusError]:
    """Switch off the torque of all servos that can be reached; return the errors of the others.

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
    """Check that the servo's supply voltage is within the servo's own limits.

    Raises:
        ServoAlarmError: The voltage is outside the servo's limits.
        BusError: The servo does not reply.
    """
    voltage_v = bus.read(servo_id, RegisterName.PRESENT_VOLTAGE)
    lower_v = bus.read(servo_id, RegisterName.MIN_VOLTAGE_LIMIT)
    upper_v = bus.read(servo_id, RegisterName.MAX_VOLTAGE_LIMIT)
    if lower_v <= voltage_v <= upper_v:
        return voltage_v
    raise ServoAlarmError(
        f"{bus.servos[servo_id]} has a supply voltage of {voltage_v:.1f} V; "
        f"its own limits are {lower_v:.1f} to {upper_v:.1f} V.",
        "Check the power supply; torque stays off.",
    )
