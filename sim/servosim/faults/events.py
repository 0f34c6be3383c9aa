"""Faults of servos, supply and cable: each says what begins and what ends it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from servosim.faults.fault import Fault

if TYPE_CHECKING:
    from servosim.line import Line
    from servosim.servo import Servo

__all__ = ["EVENTS", "Undo"]

Undo = Callable[[], None]


def _nothing() -> None:
    """Nothing to end."""


def _servos(line: Line, fault: Fault) -> list[Servo]:
    return [servo for servo in line.world.servos if fault.id in (None, servo.id)]


def _unplug(line: Line, _: Fault) -> Undo:
    line.plugged = False

    def replug() -> None:
        line.plugged = True

    return replug


def _brownout(line: Line, fault: Fault) -> Undo:
    servos = _servos(line, fault)
    for servo in servos:
        servo.power_down()

    def power_up() -> None:
        for servo in servos:
            servo.power_up()

    return power_up


def _reset(line: Line, fault: Fault) -> Undo:
    for servo in _servos(line, fault):
        servo.reboot()
    return _nothing


def _alarm(line: Line, fault: Fault) -> Undo:
    servos = _servos(line, fault)
    for servo in servos:
        servo.inject_alarm(fault.bits)

    def clear() -> None:
        for servo in servos:
            servo.inject_alarm(0)

    return clear


def _hot(line: Line, fault: Fault) -> Undo:
    for servo in _servos(line, fault):
        servo.motor.heat.temperature_c = fault.celsius
    return _nothing


def _stuck(line: Line, fault: Fault) -> Undo:
    servos = _servos(line, fault)
    for servo in servos:
        servo.motor.stuck = True

    def free() -> None:
        for servo in servos:
            servo.motor.stuck = False
        line.world.wake()

    return free


def _slipping(line: Line, fault: Fault) -> Undo:
    servos = _servos(line, fault)
    for servo in servos:
        servo.motor.grip = fault.grip

    def mend() -> None:
        for servo in servos:
            servo.motor.grip = 1.0
        line.world.wake()

    return mend


def _voltage(line: Line, fault: Fault) -> Undo:
    rails = line.world.rails_of(_servos(line, fault))
    before = [rail.open_v for rail in rails]
    for rail in rails:
        rail.open_v = fault.volts

    def mend() -> None:
        for rail, volts in zip(rails, before, strict=True):
            rail.open_v = volts
        line.world.wake()

    return mend


def _torque_lost(line: Line, fault: Fault) -> Undo:
    for servo in _servos(line, fault):
        servo.lose_torque()
    return _nothing


EVENTS: dict[str, Callable[[Line, Fault], Undo]] = {
    "unplug": _unplug,  # the cable is pulled; plugged in again at the end
    "brownout": _brownout,  # no supply: deaf and limp; at the end they boot with an empty RAM
    "reset": _reset,  # the firmware starts anew in mid-motion
    "alarm": _alarm,  # `bits` of the error byte
    "hot": _hot,  # the servo is at `celsius`, and cools from there
    "stuck": _stuck,  # the shaft does not move
    "slipping": _slipping,  # the gears pass `grip` of the torque on
    "voltage": _voltage,  # the supply gives `volts`
    "torque_lost": _torque_lost,  # the bridge is off although the register says on
}
