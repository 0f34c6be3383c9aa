"""Limits in servo RAM (profile, torque, watchdog); if they are lost, the servo was reset."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial

from ikservo.control.joint_reading import with_retries
from ikservo.errors import BusError, HeldUpError, RegisterAccessError
from ikservo.guard import MAX_TRAVEL_RAD, DrivenJoint, OverloadRule
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.servo import ServoSpec
from ikservo.model.servo_torque import find_servo_torque, nominal_supply_v
from ikservo.registers import Alarm, OperatingMode, Register, RegisterName


def limit_torque(bus: ServoBus, servo_id: int, fraction: float) -> None:
    """Limit a servo's torque to a fraction (0 to 1) of the maximum in its settings.

    Raises:
        RegisterAccessError: The model has no such limit.
        BusError: The limit cannot be written.
    """
    registers = torque_limit_registers(bus, servo_id)
    if registers is None:
        servo = str(bus.servos[servo_id])
        raise RegisterAccessError(servo, "torque limit", "this servo has none in RAM")
    limit, maximum = registers
    max_counts = bus.read(servo_id, maximum, raw=True)
    bus.write(servo_id, limit, max(1, round(fraction * max_counts)), raw=True)


def torque_limit_registers(bus: ServoBus, servo_id: int) -> tuple[Register, Register] | None:
    """Return the RAM register that limits a servo's torque, and the register with its maximum.

    Feetech STS and older Dynamixel have a torque limit in RAM. Dynamixel X limits its current by
    the goal current in current-based position mode, and otherwise its duty by the goal PWM. The
    result is None if the model has no such register.

    Raises:
        BusError: The servo's mode cannot be read.
    """
    registers = bus.servos[servo_id].table.registers
    if "torque_limit" in registers:
        return registers["torque_limit"], registers["max_torque"]
    if "goal_current" in registers:
        mode = bus.read(servo_id, RegisterName.OPERATING_MODE, raw=True)
        if mode == OperatingMode.CURRENT_BASED_POSITION:
            return registers["goal_current"], registers["current_limit"]
    if "pwm_limit" in registers:
        return registers["goal_pwm"], registers["pwm_limit"]
    return None


def read_torque_share(bus: ServoBus, servo_id: int) -> float:
    """Read the maximum fraction of its torque that a servo's present limits allow.

    Raises:
        BusError: The servo does not answer.
    """
    registers = torque_limit_registers(bus, servo_id)
    if registers is None:
        return 1.0
    limit, _ = registers
    return min(abs(bus.read(servo_id, limit, raw=True)) / limit.range[1], 1.0)


# Dynamixel's data sheets call an overload "persistent" without figures; these are the simulator's.
_DYNAMIXEL_OUTPUT = 0.9  # fraction of the full output
_DYNAMIXEL_TIME_S = 2.0  # time until the servo protects itself


def read_overload_rule(bus: ServoBus, servo_id: int, gain_share: float) -> OverloadRule | None:
    """Read a servo's overload rule for its share of the motor table's P gain; None if it has none.

    Raises:
        BusError: The servo does not answer.
    """
    table = bus.servos[servo_id].table
    registers, torque = table.registers, find_servo_torque(table.model_name, None)
    per_rad = gain_share * torque.stiffness_nm_rad / torque.full_duty_nm if torque else 0.0
    share = read_torque_share(bus, servo_id)
    full_a = torque.full_current_a(nominal_supply_v(table.model_name, None)) if torque else 0.0
    if "overload_torque" in registers:
        output = bus.read(servo_id, registers["overload_torque"])
        time_s = bus.read(servo_id, registers["protection_time"])
        most_a, current_s = _read_current_limit(bus, servo_id)
        if full_a and 0.0 < most_a < output * full_a:  # reached first; the shorter time is safe
            return OverloadRule(most_a / full_a, min(time_s, current_s), per_rad, share, full_a)
        return OverloadRule(output, time_s, per_rad, share) if output < 1.0 else None
    bits = sum(1 << bit for bit, alarm in table.alarm_bits.items() if alarm is Alarm.OVERLOAD)
    if "shutdown" in registers and bus.read(servo_id, registers["shutdown"], raw=True) & bits:
        counted_a = full_a if table.present_load.unit.symbol == "A" else 0.0
        return OverloadRule(_DYNAMIXEL_OUTPUT, _DYNAMIXEL_TIME_S, per_rad, share, counted_a)
    return None


def _read_current_limit(bus: ServoBus, servo_id: int) -> tuple[float, float]:
    """Read current [A] and time [s] of Feetech's overcurrent protection; 0 A if there is none."""
    registers = bus.servos[servo_id].table.registers
    limit = registers.get("protection_current")
    if limit is None or limit.unit.symbol != "A" or "over_current_time" not in registers:
        return 0.0, 0.0
    return bus.read(servo_id, limit), bus.read(servo_id, registers["over_current_time"])


_TIME_BASED_PROFILE = 0b100  # drive mode of Dynamixel X
_COARSE_SPEED = 50  # ticks/s per count if the table's fine_speed_bit is clear

# Servos use no ramps of their own: they would brake for each goal of a stream, lag the stream by v²
# / 2a, and run on further by that distance after the last goal.
_NO_RAMP = 0
_SPEED_MARGIN = 1.2  # a factor above 1, so that a joint that lags may catch up

_WATCHDOG_COUNTS = 5  # time-out of the watchdog in counts of 20 ms
_WATCHDOG_S = 0.020 * _WATCHDOG_COUNTS


def unwatched_servos(driven_joints: Iterable[DrivenJoint]) -> list[int]:
    """Return the ids of servos whose watchdog must not be used, because their joints would sink.

    A tripped watchdog sets the servo's goal to its position. A joint under load then sinks further
    than to its last goal: with payload in the heaviest posture, by more than ``MAX_TRAVEL_RAD``.
    """
    return [driven.servo_id for driven in driven_joints if driven.sag_rad > MAX_TRAVEL_RAD]


class ServoRamLimits:
    """Speed, acceleration and torque limits in RAM, and the watchdog if there is one.

    Args:
        bus: The servo bus.
        servo_ids: The servos to which goals are sent.
        unwatched: Servos whose watchdog is not used.
    """

    def __init__(
        self, bus: ServoBus, servo_ids: Sequence[int], unwatched: Collection[int] = ()
    ) -> None:
        self._bus, self._ids = bus, list(servo_ids)
        self._watched = [i for i in servo_ids if i not in unwatched]
        self._expected: dict[int, dict[Register, int]] = {i: {} for i in servo_ids}
        self._time_based: dict[int, bool] = {}
        self._speed_rad_s: float | None = None
        self._armed = False

    @property
    def watchdog_ids(self) -> list[int]:
        """The ids of the servos whose bus watchdog is used."""
        return [i for i in self._watched if "bus_watchdog" in self._limit_registers(i)]

    def invalidate(self) -> None:
        """Mark all limits as unwritten, because the servos may have lost their RAM."""
        self._speed_rad_s = None

    def prepare(self, servo_id: int, *, keep_torque: bool = False) -> None:
        """Clear the watchdog and set full torque, before torque comes on.

        A tripped watchdog blocks goals until it is cleared. ``keep_torque`` keeps the torque limit.

        Raises:
            BusError: The servo does not answer.
        """
        registers = self._limit_registers(servo_id)
        if "bus_watchdog" in registers:
            self._bus.write(servo_id, registers["bus_watchdog"], 0, raw=True)
        self._time_based[servo_id] = self._read_time_based(servo_id)
        limit = None if keep_torque else torque_limit_registers(self._bus, servo_id)
        if limit is not None:
            own, maximum = limit
            self._bus.write(servo_id, own, self._bus.read(servo_id, maximum, raw=True), raw=True)
        if "goal_torque" in registers:  # an HLS; programs for STS write 0, which means no current
            most = self._bus.read(servo_id, registers["protection_current"], raw=True)
            self._bus.write(servo_id, registers["goal_torque"], most, raw=True)

    def set_speed(self, speed_rad_s: float) -> None:
        """Limit the speed at which every servo turns towards its goal, at the horn.

        Raises:
            BusError: A servo cannot be written.
        """
        if speed_rad_s == self._speed_rad_s:
            return
        limit_rad_s = _SPEED_MARGIN * speed_rad_s
        for servo_id in self._ids:
            with_retries(self._bus.clock, partial(self._limit_speed, servo_id, limit_rad_s))
        self._speed_rad_s = speed_rad_s

    def profile_speed_rad_s(self, servo_id: int, speed_rad_s: float) -> float:
        """Compute a servo's profile speed for a motion with the given top speed, rad/s.

        The speed is infinite if the profile is set as a duration, because there is then no limit.
        """
        return math.inf if self._time_based[servo_id] else _SPEED_MARGIN * speed_rad_s

    def arm_watchdog(self) -> None:
        """Arm the watchdogs, which stop their servos after a tenth of a second without packets.

        Raises:
            BusError: A servo cannot be written.
        """
        self._armed = bool(self.watchdog_ids)
        self._write_watchdogs(_WATCHDOG_COUNTS)

    def disarm_watchdog(self) -> None:
        """Disarm the watchdogs: servos hold without packets.

        Raises:
            BusError: A servo cannot be written.
        """
        self._write_watchdogs(0)
        self._armed = False

    def broadcast_watchdog_off(self) -> None:
        """Disarm the watchdogs in an emergency, by one packet to all servos without replies."""
        for servo_id in self.watchdog_ids[:1]:
            register = self._limit_registers(servo_id)["bus_watchdog"]
            self._bus.sync_write(register, dict.fromkeys(self.watchdog_ids, 0), raw=True)
        self._armed = False

    def may_have_tripped(self, elapsed_s: float) -> bool:
        """Check whether a gap without packets is long enough for a watchdog to stop its servo."""
        return elapsed_s > _WATCHDOG_S and bool(self.watchdog_ids)

    def check_watchdog_gap(self, elapsed_s: float) -> None:
        """Read the watchdogs after a gap in which they may have tripped.

        Raises:
            HeldUpError: A watchdog has tripped or cannot be read; the servos hold.
        """
        if self._armed and self.may_have_tripped(elapsed_s):
            for servo_id in self.watchdog_ids:
                if self._read_tripped(servo_id) is not False:
                    raise _pause_error()

    def check_watchdog(self, servo_id: int) -> None:
        """Read whether a servo's watchdog has tripped.

        Raises:
            HeldUpError: The watchdog has tripped or cannot be read; the servo holds.
        """
        if self._read_tripped(servo_id) is not False:
            raise _pause_error()

    def reset_markers(self, servo_id: int, *, watchdog: bool = True) -> Mapping[Register, int]:
        """Return the RAM registers that a reset would change, with their present values."""
        if servo_id not in self._expected:
            return {}
        registers, expected = self._limit_registers(servo_id), self._expected[servo_id]
        if watchdog and self._armed and servo_id in self.watchdog_ids:
            return expected | {registers["bus_watchdog"]: _WATCHDOG_COUNTS}
        return expected

    def _read_tripped(self, servo_id: int) -> bool | None:
        """Read whether a servo's watchdog has tripped; None if it does not reply."""
        watchdog = self._limit_registers(servo_id).get("bus_watchdog")
        if watchdog is None:
            return False
        try:
            return self._bus.read(servo_id, watchdog, raw=True) not in (0, _WATCHDOG_COUNTS)
        except BusError:
            return None

    def _write_watchdogs(self, counts: int) -> None:
        """Write and confirm each watchdog, because a lost write would later look like a reset."""
        for servo_id in self.watchdog_ids:
            register = self._limit_registers(servo_id)["bus_watchdog"]
            write = partial(self._bus.write, servo_id, register, counts, raw=True)
            with_retries(self._bus.clock, write)

    def _limit_speed(self, servo_id: int, speed_rad_s: float) -> None:
        table = self._servo_spec(servo_id).table
        speed = table.find(RegisterName.PROFILE_VELOCITY)
        if servo_id not in self._time_based:  # only another joint was prepared
            self._time_based[servo_id] = self._read_time_based(servo_id)
        if self._time_based[servo_id]:  # the register is a duration; 0 disables the profile
            self._write_limit(servo_id, speed, 0)
            return
        if RegisterName.PROFILE_ACCELERATION not in table.missing:
            ramp = table.find(RegisterName.PROFILE_ACCELERATION)
            self._write_limit(servo_id, ramp, _NO_RAMP)
        counts = speed.to_raw(speed_rad_s)
        if table.fine_speed_bit:
            phase = self._bus.read(servo_id, table.registers["phase"], raw=True)
            fine = phase & table.fine_speed_bit
            counts = counts if fine else -(-counts // _COARSE_SPEED)
        elif speed.to_value(counts) * _SPEED_MARGIN < speed_rad_s:
            counts += 1  # rounded up, because a coarse unit must not slow the motion
        self._write_limit(servo_id, speed, min(max(1, counts), speed.range[1]))

    def _write_limit(self, servo_id: int, register: Register, counts: int) -> None:
        """Write a limit; the last limit written is the reset marker."""
        self._bus.write(servo_id, register, counts, raw=True)
        self._expected[servo_id] = {register: counts}

    def _read_time_based(self, servo_id: int) -> bool:
        """Read whether a servo's profile is set as a duration instead of a speed."""
        mode = self._limit_registers(servo_id).get("drive_mode")
        if mode is None:
            return False
        return self._bus.read(servo_id, mode, raw=True) & _TIME_BASED_PROFILE != 0

    def _limit_registers(self, servo_id: int) -> Mapping[str, Register]:
        return self._servo_spec(servo_id).table.registers

    def _servo_spec(self, servo_id: int) -> ServoSpec:
        return self._bus.servos[servo_id]


def _pause_error() -> HeldUpError:
    return HeldUpError(
        "The program was delayed, so the servos' watchdog stopped them.",
        "Reduce the computer's load, then move again.",
    )
