"""Recover servos from alarms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ikservo.errors import BusError, ServoAlarmError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import torque_on
from ikservo.registers import Alarm, Family, RegisterName

__all__ = ["RecoveryResult", "recover"]

_BOOT_S = 3.0  # longest time until a servo answers again
_BOOT_STEP_S = 0.05
_REBOOTING = (Family.DYNAMIXEL_2,)  # keep an alarm until they start anew
_NEEDS_REBOOT = "keeps its alarm until it restarts: support the arm, then ikservo recover --reboot"


@dataclass(frozen=True, slots=True)
class RecoveryResult:
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
    def healthy(self) -> bool:
        """Whether it answers and has no complaint."""
        return self.torque is not None and not self.after


def recover(bus: ServoBus, *, reboot: bool = False) -> list[RecoveryResult]:
    """Clear alarms, and make every servo's goal where it is.

    A Feetech servo's torque is switched off and, if it was on, on again where the joint stands.
    A Dynamixel is restarted, which lets the joint go, and only if ``reboot`` asks for it.

    Args:
        bus: The line.
        reboot: Whether servos that need it may be restarted.

    Raises:
        PortLostError: The line is gone.
    """
    done = [_recover_servo(bus, servo, reboot=reboot) for servo in bus.servos.values()]
    _set_goals_to_present(bus, [r.servo.id for r in done if r.torque is not None])
    return done


def _recover_servo(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> RecoveryResult:
    before: tuple[str, ...] = ()
    try:
        before = _read_alarms(bus, servo)
        action = _clear_alarm(bus, servo, reboot=reboot) if before else "had no alarm"
        after = _read_alarms(bus, servo)
    except BusError as error:
        return RecoveryResult(servo, before, before, error.found, None)
    except ServoAlarmError as error:  # its supply is wrong: it must not hold
        action, after = f"torque stays off: {error.message}", (str(Alarm.VOLTAGE),)
    return RecoveryResult(servo, before, after, action, _is_torque_on(bus, servo))


def _is_torque_on(bus: ServoBus, servo: ServoSpec) -> bool | None:
    try:
        return bus.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1
    except BusError:
        return None


def _read_alarms(bus: ServoBus, servo: ServoSpec) -> tuple[str, ...]:
    alarms: Iterable[Alarm] = bus.read_alarms(servo.id)
    return tuple(sorted(str(alarm) for alarm in alarms))


def _clear_alarm(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> str:
    if servo.table.family not in _REBOOTING:
        return _cycle_torque(bus, servo)
    if not reboot:
        return _NEEDS_REBOOT
    bus.reboot(servo.id)
    _wait_for_boot(bus, servo)
    return "restarted; torque off"


def _cycle_torque(bus: ServoBus, servo: ServoSpec) -> str:
    was_on = bus.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1
    bus.write(servo.id, RegisterName.TORQUE_ENABLE, 0, raw=True)
    if not was_on:
        return "torque switched off again"
    torque_on(bus, servo.id)
    return "torque off and on again"


def _wait_for_boot(bus: ServoBus, servo: ServoSpec) -> None:
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


def _set_goals_to_present(bus: ServoBus, servo_ids: Iterable[int]) -> None:
    """Make goals of where the joints are, so that nothing moves when torque comes on."""
    present: Mapping[int, int] = bus.sync_read(
        servo_ids, RegisterName.PRESENT_POSITION, raw=True
    ).values
    if present:
        bus.sync_write(RegisterName.GOAL_POSITION, present, raw=True)
        bus.sync_read(
            present, RegisterName.GOAL_POSITION
        )  # once somebody answers, all have heard it
