"""After an overload: each family's own way back, and no goal left to snap to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ikservo.errors import BusError, ServoAlarmError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import torque_on
from ikservo.registers import Alarm, Family, Role

__all__ = ["Recovery", "recover"]

_BOOT_S = 3.0  # longest time until a servo answers again
_BOOT_STEP_S = 0.05
_REBOOTING = (Family.DYNAMIXEL_2,)  # keep an alarm until they start anew
_NEEDS_REBOOT = "keeps its alarm until it restarts: support the arm, then ikservo recover --reboot"


@dataclass(frozen=True, slots=True)
class Recovery:
    """What became of one servo.

    Attributes:
        servo: Which.
        before: What it complained about.
        after: What it still complains about.
        action: What was done, in words.
        torque: Whether it holds now; None where it does not answer.
    """

    servo: ServoSpec
    before: tuple[str, ...]
    after: tuple[str, ...]
    action: str
    torque: bool | None

    @property
    def well(self) -> bool:
        """Whether it answers and has no complaint."""
        return self.torque is not None and not self.after


def recover(bus: ServoBus, *, reboot: bool = False) -> list[Recovery]:
    """Clear alarms, and make every servo's goal where it is.

    A Feetech servo's torque is switched off and, if it was on, on again where the joint stands.
    A Dynamixel is restarted, which lets the joint go, and only if ``reboot`` asks for it.

    Args:
        bus: The line.
        reboot: Whether servos that need it may be restarted.

    Raises:
        PortLostError: The line is gone.
    """
    done = [_recovered(bus, servo, reboot=reboot) for servo in bus.servos.values()]
    _stay(bus, [r.servo.id for r in done if r.torque is not None])
    return done


def _recovered(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> Recovery:
    before: tuple[str, ...] = ()
    try:
        before = _complaints(bus, servo)
        action = _treat(bus, servo, reboot=reboot) if before else "had no alarm"
        after = _complaints(bus, servo)
    except BusError as error:
        return Recovery(servo, before, before, error.found, None)
    except ServoAlarmError as error:  # its supply is wrong: it must not hold
        action, after = f"torque stays off: {error.message}", (str(Alarm.VOLTAGE),)
    return Recovery(servo, before, after, action, _holds(bus, servo))


def _holds(bus: ServoBus, servo: ServoSpec) -> bool | None:
    try:
        return bus.read(servo.id, Role.TORQUE_ENABLE, raw=True) == 1
    except BusError:
        return None


def _complaints(bus: ServoBus, servo: ServoSpec) -> tuple[str, ...]:
    alarms: Iterable[Alarm] = bus.read_alarms(servo.id)
    return tuple(sorted(str(alarm) for alarm in alarms))


def _treat(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> str:
    if servo.table.family not in _REBOOTING:
        return _cycle_torque(bus, servo)
    if not reboot:
        return _NEEDS_REBOOT
    bus.reboot(servo.id)
    _await_boot(bus, servo)
    return "restarted; torque off"


def _cycle_torque(bus: ServoBus, servo: ServoSpec) -> str:
    was_on = bus.read(servo.id, Role.TORQUE_ENABLE, raw=True) == 1
    bus.write(servo.id, Role.TORQUE_ENABLE, 0, raw=True)
    if not was_on:
        return "torque switched off again"
    torque_on(bus, servo.id)
    return "torque off and on again"


def _await_boot(bus: ServoBus, servo: ServoSpec) -> None:
    """Wait until a servo that restarts answers again.

    Raises:
        BusError: It does not.
    """
    give_up_s = bus.clock.now_s() + _BOOT_S
    while True:
        bus.clock.sleep_until(bus.clock.now_s() + _BOOT_STEP_S)
        try:
            bus.ping(servo.id)
        except BusError:
            if bus.clock.now_s() > give_up_s:
                raise
        else:
            return


def _stay(bus: ServoBus, servo_ids: Iterable[int]) -> None:
    """Make goals of where the joints are, so that nothing moves when torque comes on."""
    present: Mapping[int, int] = bus.sync_read(servo_ids, Role.PRESENT_POSITION, raw=True).values
    if present:
        bus.sync_write(Role.GOAL_POSITION, present, raw=True)
        bus.sync_read(present, Role.GOAL_POSITION)  # once somebody answers, all have heard it
