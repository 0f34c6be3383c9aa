"""Recover servos from alarms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from ikservo.errors import BusError, RefusedError, ServoAlarmError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.goal_writing import write_goals
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.torque import read_goal_range, torque_on
from ikservo.registers import Alarm, Family, RegisterName

_BOOT_S = 3.0  # the longest time until a restarted servo replies again
_BOOT_STEP_S = 0.05
_REBOOTING = (Family.DYNAMIXEL_2,)  # families that keep an alarm until restart
_NEEDS_REBOOT = "keeps its alarm until it restarts: support the arm, then ikservo recover --reboot"


@dataclass(frozen=True, slots=True)
class RecoveryResult:
    """The result of one servo's recovery: a text for the user, and the alarms before and after.

    ``torque`` is None if the servo does not reply.
    """

    servo: ServoSpec
    before: tuple[str, ...]
    after: tuple[str, ...]
    action: str
    torque: bool | None

    @property
    def healthy(self) -> bool:
        """Whether the servo replies and has no alarm."""
        return self.torque is not None and not self.after


def recover(bus: ServoBus, *, reboot: bool = False) -> list[RecoveryResult]:
    """Clear alarms, and set the goal of every servo with torque to its position.

    A servo whose torque is off gets no goal, because a goal can switch torque on. A Feetech servo's
    torque is switched off, and on again at its position if it was on. A Dynamixel is restarted only
    if ``reboot`` is true; this switches its torque off.

    Raises:
        PortLostError: The port was lost.
        StoppedError: Another program has stopped this one; the remaining servos are unchanged.
    """
    done = [_recover_servo(bus, servo, reboot=reboot) for servo in bus.servos.values()]
    # Set the goals of joints with torque to their positions, so that they stop pressing.
    servo_ids = [r.servo.id for r in done if r.torque]
    present: Mapping[int, int] = bus.sync_read(
        servo_ids, RegisterName.PRESENT_POSITION, raw=True
    ).values
    ranges: dict[int, tuple[int, int]] = {}
    for servo_id in present:
        with suppress(BusError, RefusedError):
            ranges[servo_id] = read_goal_range(bus, servo_id)
    # A servo outside its limits would not stay at its position, but move to the nearest limit.
    inside = {i: present[i] for i, (low, high) in ranges.items() if low <= present[i] <= high}
    if inside:
        write_goals(bus, inside, ranges)
        bus.sync_read(inside, RegisterName.GOAL_POSITION)  # a reply shows that the write is over
    return done


def _recover_servo(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> RecoveryResult:
    before: tuple[str, ...] = ()
    try:
        before = _read_alarms(bus, servo)
        action = _clear_alarm(bus, servo, reboot=reboot) if before else "had no alarm"
        after = _read_alarms(bus, servo)
    except BusError as error:
        return RecoveryResult(servo, before, before, error.found, None)
    except ServoAlarmError as error:  # its supply is out of range: torque stays off
        action, after = f"torque stays off: {error.message}", (str(Alarm.VOLTAGE),)
    torque: bool | None = None
    with suppress(BusError):
        torque = bus.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1
    return RecoveryResult(servo, before, after, action, torque)


def _read_alarms(bus: ServoBus, servo: ServoSpec) -> tuple[str, ...]:
    alarms: Iterable[Alarm] = bus.read_alarms(servo.id)
    return tuple(sorted(str(alarm) for alarm in alarms))


def _clear_alarm(bus: ServoBus, servo: ServoSpec, *, reboot: bool) -> str:
    if servo.table.family not in _REBOOTING:
        was_on = bus.read(servo.id, RegisterName.TORQUE_ENABLE, raw=True) == 1
        bus.check_may_move()  # raises while the servo still has torque
        bus.write(servo.id, RegisterName.TORQUE_ENABLE, 0, raw=True)
        if not was_on:
            return "torque switched off again"
        try:
            torque_on(bus, servo.id)
        except RefusedError as error:  # it cannot hold its position
            return f"torque stays off: {error.message}"
        return "torque off and on again"
    if not reboot:
        return _NEEDS_REBOOT
    bus.reboot(servo.id)
    wait_for_boot(bus, servo)
    return "restarted; torque off"


def wait_for_boot(bus: ServoBus, servo: ServoSpec) -> None:
    """Wait until a restarting servo replies again.

    Raises:
        BusError: The servo does not reply in time.
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
