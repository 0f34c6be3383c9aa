"""Firmware of the Feetech STS series: modes, homing offset, lock, torque 128 (STS memory table)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from servosim.drive import Mode
from servosim.motor import Motor
from servosim.servo import Protocol, Refusal, Servo
from servosim.servos.feetech_watch import Watch
from servosim.shaft import Shaft
from servosim.tables import ServoTable

__all__ = ["FeetechSts"]

# fmt: off
BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400,
         19_200, 14_400, 9_600, 4_800)
# fmt: on
KP_PER_GAIN = 5.3 / 32  # assumed: the sheets give no unit; 32 is the delivered P gain
KD_PER_GAIN = 0.001  # assumed [s/rad]
KI_PER_GAIN = 0.05  # assumed [1/(rad s)]
CURRENT_UNIT_A = 0.0065
CALIBRATE = 128  # written to torque_enable: here is tick 2048
PHASE_SLOW_UNIT, PHASE_ZERO_IS_MAX, PHASE_TURNS = 0x04, 0x08, 0x10


class FeetechSts(Servo):
    """An STS servo."""

    protocol = Protocol.FEETECH
    bauds = MappingProxyType(dict(enumerate(BAUDS)))
    registered_flag = "async_write"
    instructions = frozenset((1, 2, 3, 4, 5, 6, 0x0A, 0x0B, 0x82, 0x83))
    answers_broadcast_ping = True
    kept_by_recovery = ("id",)

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: Shaft,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(table, motor, shaft, delivered, seed)
        offset = (delivered or {}).get("homing_offset", 0)
        self.shaft = Shaft(shaft.sign, shaft.zero_tick + offset, shaft.ticks)
        self.turn_base_tick = 0
        self.step_goal_tick = 0
        self.watch = Watch(self)
        self._list_live()
        self._list_effects()
        self.start()

    # The line's questions.

    @property
    def return_delay_s(self) -> float:
        """The return delay register, 2 µs a step."""
        return self.memory.get("return_delay") * 2e-6

    @property
    def status_level(self) -> int:
        """The status return level register."""
        return 2 if self.memory.get("response_level") else 1

    @property
    def alarm(self) -> int:
        """The alarm bits of a status packet."""
        return self.watch.bits

    @property
    def eeprom_open(self) -> bool:
        """The lock register: 0 lets EEPROM writes survive the power."""
        return self.memory.get("lock") == 0

    def refusal(self, address: int, data: bytes) -> Refusal | None:
        """Refuse what lies outside the memory; the rest is the register's own business."""
        return None if data and address + len(data) <= self.table.size else Refusal.RANGE

    def store(self, address: int, data: bytes) -> None:
        """Store what is writable, each value clipped to its range; ignore the rest."""
        asked = bytearray(self.memory.image)
        asked[address : address + len(data)] = data
        rows = [row for row in self.table.covered(address, len(data)) if row.writable]
        persist = self.eeprom_open
        for row in rows:
            value = row.decode(asked[row.address : row.end])
            clipped = max(row.lower, min(row.upper, value))
            self.memory.write(row.address, row.encode(clipped), persist=persist)
        for row in rows:
            if row.name in self.effects:
                self.effects[row.name]()
        self.changed()

    def supervise(self, dt_s: float) -> None:
        """Look after heat, load, voltage and the bus."""
        self.watch.look(dt_s)
        self._follow_seam()

    # Position.

    @property
    def multi_turn(self) -> bool:
        """Phase bit 4: feedback counts turns since power-up."""
        return bool(self.memory.get("phase") & PHASE_TURNS)

    def actual_tick(self) -> int:
        """Return the sensor's tick, turns counted since power-up."""
        return self.shaft.tick_at(self.motor.encoder_rad) - self.turn_base_tick

    def present_tick(self) -> int:
        """Return the present position: wrapped into one turn unless phase bit 4 is set."""
        tick = self.actual_tick() - self.memory.get("homing_offset")
        return tick if self.multi_turn else tick % 4096

    def angle_at(self, position_tick: int) -> float:
        """Return the joint angle [rad] that a position register's number means now.

        The firmware compares goal and present inside one turn, so it never crosses the seam.
        """
        actual = self.actual_tick()
        turn_tick = actual - self.memory.get("homing_offset") - self.present_tick()
        tick = position_tick + self.memory.get("homing_offset") + turn_tick
        return self.shaft.angle_at(tick + self.turn_base_tick)

    def calibrate(self) -> None:
        """Make the present position tick 2048 by choosing the homing offset."""
        offset = (self.actual_tick() - 2048 + 2048) % 4096 - 2048
        self.memory.put("homing_offset", max(-2047, offset))
        self.memory.keep("homing_offset")
        self.hold_here()

    def hold_here(self) -> None:
        """Make the present position the goal."""
        self.memory.put("goal_position", self.present_tick())
        self.set_goal()

    def forget_turns(self) -> None:
        """Count turns from the present one again."""
        self.turn_base_tick = self.shaft.tick_at(self.motor.encoder_rad) // 4096 * 4096
        self.set_goal()

    # From memory to drive.

    def start(self) -> None:
        """Set everything from the memory after power-up."""
        self.drive.torque_on = False
        self.watch.start()
        self.memory.put("torque_limit", self.memory.get("max_torque"))
        self.turn_base_tick = self.shaft.tick_at(self.motor.encoder_rad) // 4096 * 4096
        self.memory.put("goal_position", self.present_tick())
        for effect in (self.set_gains, self.set_limits, self.set_mode):
            effect()

    def set_torque(self) -> None:
        """Torque enable written: 0 off, 1 on, 2 damping, 128 calibrates."""
        asked = self.memory.get("torque_enable")
        if asked == CALIBRATE:
            self.memory.put("torque_enable", int(self.drive.torque_on))
            self.calibrate()
            return
        self.watch.release()
        self.drive.torque_on = asked != 0
        self.set_mode()

    def set_mode(self) -> None:
        """Operating mode or torque written."""
        mode = self.memory.get("operating_mode")
        damping = self.memory.get("torque_enable") == 2
        self.step_goal_tick = self.actual_tick()
        modes = (Mode.POSITION, Mode.VELOCITY, Mode.PWM, Mode.POSITION)
        self.drive.mode = Mode.PWM if damping else modes[mode]
        self.set_goal()
        if damping:
            self.drive.goal_pwm = 0.0

    def set_goal(self) -> None:
        """A goal register was written: hand goal, speed and acceleration over together."""
        drive, get, sign = self.drive, self.memory.get, self.shaft.sign
        self._set_profile()
        drive.goal_velocity_rad_s = sign * get("goal_speed") * self._speed_unit()
        drive.goal_pwm = sign * get("goal_time") / 1000
        if get("operating_mode") == 3:
            drive.goal_rad = self.shaft.angle_at(self.step_goal_tick + self.turn_base_tick)
        else:
            drive.goal_rad = self.angle_at(self._clamped_goal())

    def set_position_goal(self) -> None:
        """Goal position written; in step mode it is added to where the servo was to go."""
        if self.memory.get("operating_mode") == 3:
            self.step_goal_tick += self.memory.get("goal_position")
        self.set_goal()

    def set_gains(self) -> None:
        """Hand the gains over in SI."""
        drive, get = self.drive, self.memory.get
        drive.kp = get("p_gain") * KP_PER_GAIN
        drive.kd = get("d_gain") * KD_PER_GAIN
        drive.ki = get("i_gain") * KI_PER_GAIN
        drive.integral_limit = get("integral_limit") * 4 / 1000 or 1.0
        drive.minimum_pwm = get("min_startup_force") / 1000
        drive.dead_zone_rad = get("cw_dead_zone") * self.shaft.rad_per_tick

    def set_limits(self) -> None:
        """Hand the limits over; an overload keeps its own torque limit."""
        self.drive.moving_threshold_rad_s = self.memory.get("moving_threshold") * self._speed_unit()
        self.drive.torque_limit = self.watch.torque_limit()

    def _set_profile(self) -> None:
        drive, get = self.drive, self.memory.get
        drive.acceleration_rad_s2 = get("acceleration") * 100 * self.shaft.rad_per_tick
        speed = abs(get("goal_speed")) * self._speed_unit()
        stands = speed == 0 and not get("phase") & PHASE_ZERO_IS_MAX
        drive.velocity_limit_rad_s = 1e-6 if stands else speed

    def _speed_unit(self) -> float:
        steps = 1 if self.memory.get("phase") & PHASE_SLOW_UNIT else 50
        return steps * self.shaft.rad_per_tick

    def _clamped_goal(self) -> int:
        get = self.memory.get
        goal, lower, upper = (
            get("goal_position"), get("min_position_limit"), get("max_position_limit"),
        )  # fmt: skip
        return goal if lower == upper == 0 else max(lower, min(upper, goal))

    def _follow_seam(self) -> None:
        """After the seam the same goal lies on the other side, and the servo runs there."""
        if self.drive.torque_on and self.memory.get("operating_mode") == 0:
            self.drive.goal_rad = self.angle_at(self._clamped_goal())

    # Tables of what is measured and what is set off.

    def _list_live(self) -> None:
        motor, sign = self.motor, self.shaft.sign
        self.live = {
            "present_position": self.present_tick,
            "present_speed": lambda: round(sign * motor.velocity_rad_s / self._speed_unit()),
            "present_load": lambda: round(sign * motor.pwm * 1000),
            "present_voltage": lambda: round(self.supply_v * 10),
            "present_temperature": lambda: int(motor.temperature_c),
            "present_current": lambda: round(abs(motor.current_a) / CURRENT_UNIT_A),
            "status": lambda: self.watch.bits,
            "moving": lambda: int(motor.moving),
            "target_position": lambda: self.memory.get("goal_position"),
        }

    def _list_effects(self) -> None:
        gains = ("p_gain", "d_gain", "i_gain", "min_startup_force", "integral_limit",
                 "cw_dead_zone", "ccw_dead_zone")  # fmt: skip
        goals = ("acceleration", "goal_time", "goal_speed", "homing_offset", "phase",
                 "min_position_limit", "max_position_limit")  # fmt: skip
        self.effects = {
            "torque_enable": self.set_torque,
            "operating_mode": self.set_mode,
            "goal_position": self.set_position_goal,
            **dict.fromkeys(("torque_limit", "moving_threshold"), self.set_limits),
            **dict.fromkeys(gains, self.set_gains),
            **dict.fromkeys(goals, self.set_goal),
        }
