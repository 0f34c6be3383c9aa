"""What every joint says about itself, asked once and completely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ikservo.arm.streaming.asking import ask_each
from ikservo.guard import Fence
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Role

__all__ = ["JointState", "load_percent", "read_states"]


@dataclass(frozen=True, slots=True)
class JointState:
    """One joint as its servo reports it.

    Attributes:
        position_rad: Measured; metres for a prismatic joint.
        lower_rad: Lower limit, same unit.
        upper_rad: Upper limit.
        limit_from: Where the limits come from.
        load_percent: Share of the stall torque or, where the servo measures it, current.
        torque: Whether the servo holds.
        alarms: What the servo complains about, in words.
    """

    name: str
    position_rad: float
    lower_rad: float
    upper_rad: float
    limit_from: str
    temperature_c: float
    voltage_v: float
    load_percent: float | None
    torque: bool
    alarms: tuple[str, ...] = ()


_NUMBERS = (
    Role.TORQUE_ENABLE,
    Role.PRESENT_LOAD,
    Role.PRESENT_VOLTAGE,
    Role.PRESENT_TEMPERATURE,
)


def read_states(
    bus: ServoBus, fences: Sequence[Fence], ticks: Mapping[str, int]
) -> tuple[JointState, ...]:
    """Return every joint's position, limits, temperature, voltage, load and torque.

    Args:
        bus: The line.
        fences: One for each joint.
        ticks: Where they were just measured.

    Raises:
        BusError: A servo does not answer.
    """
    ids = [fence.servo_id for fence in fences]
    rows = ask_each(bus, {i: [*_NUMBERS, *_telling(bus, i)] for i in ids})
    return tuple(
        JointState(
            name=fence.joint,
            position_rad=fence.joint_map.position(ticks[fence.joint]),
            lower_rad=fence.limits.lower.value,
            upper_rad=fence.limits.upper.value,
            limit_from=fence.limits.source,
            temperature_c=_value(bus, fence, rows, Role.PRESENT_TEMPERATURE),
            voltage_v=_value(bus, fence, rows, Role.PRESENT_VOLTAGE),
            load_percent=load_percent(
                bus.servos[fence.servo_id], _value(bus, fence, rows, Role.PRESENT_LOAD)
            ),
            torque=rows[fence.servo_id][Role.TORQUE_ENABLE] != 0,
            alarms=tuple(sorted(str(alarm) for alarm in bus.alarms.get(fence.servo_id, ()))),
        )
        for fence in fences
    )


def _telling(bus: ServoBus, servo_id: int) -> list[Role]:
    return [] if Role.ALARMS in bus.servos[servo_id].table.lacks else [Role.ALARMS]


def _value(
    bus: ServoBus, fence: Fence, rows: Mapping[int, Mapping[Role, int]], role: Role
) -> float:
    table = bus.servos[fence.servo_id].table
    return table.find(role).to_value(rows[fence.servo_id][role])


def load_percent(servo: ServoSpec, load: float) -> float:
    """Return a load as a share of the most there is: of torque, or of the current limit."""
    table = servo.table
    if table.present_load.unit.symbol != "A":
        return 100.0 * load
    most = table.registers["current_limit"]
    return 100.0 * load / most.to_value(most.range[1])
