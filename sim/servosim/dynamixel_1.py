"""Dynamixel AX, MX and XL-320 firmware with its protections (ROBOTIS e-manual)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from servosim.control import ControlMode
from servosim.frames import Dynamixel1Reader, Dynamixel2Reader
from servosim.motor import Motor
from servosim.register import ServoTable, SimulatedArea, SimulatedRegister
from servosim.servo import AlarmBits, BusProtocol, HornMounting, InstructionError, Servo

VOLTAGE, ANGLE, HEAT, OVERLOAD = 0x01, 0x02, 0x04, 0x20
OVERLOAD_AFTER_S = 2.0  # assumed: the sheets say "persistent"
OVERLOAD_FRACTION = 0.9  # assumed fraction of the largest output that counts as overload


class Dynamixel1Protections(AlarmBits):
    """Protections of one servo; the XL-320 has other bits for the same causes."""

    def __init__(self, servo: Dynamixel1) -> None:
        super().__init__()
        self.servo = servo
        bits = (0x04, 0x02, 0x01) if servo.is_320 else (VOLTAGE, HEAT, OVERLOAD)
        self._voltage, self._heat, self._overload = bits
        self.start()

    def start(self) -> None:
        """Start again after power-up."""
        self.bits = self.injected = 0
        self._overload_s = 0.0

    def clear_overload(self) -> None:
        """Reset an overload after a write to the torque limit."""
        self.bits &= ~self._overload
        self._overload_s = 0.0

    def check(self, dt_s: float) -> None:
        """Check everything once; ``dt_s`` is the time since the last check."""
        get, servo, motor = self.servo.memory.get, self.servo, self.servo.motor
        volts = round(servo.supply_v * 10)
        self.set_alarm(
            self._voltage, not get("min_voltage_limit") <= volts <= get("max_voltage_limit")
        )
        self.set_alarm(self._heat, motor.temperature_c > get("temperature_limit"))
        heavy = abs(motor.torque_nm) > OVERLOAD_FRACTION * motor.parameters.stall_torque_nm
        self._overload_s = self._overload_s + dt_s if heavy and servo.drive.torque_on else 0.0
        if self._overload_s > OVERLOAD_AFTER_S:
            self.bits |= self._overload
        if self.bits & get("shutdown") and servo.drive.torque_limit > 0.0:
            servo.memory.put("torque_limit", 0)
            servo.drive.torque_limit = 0.0
            servo.changed()


# Baud rate = 2 000 000 / (number + 1); the MX has three additional, faster codes.
BAUDS = {n: 2_000_000 / (n + 1) for n in range(255)}
MX_BAUDS = BAUDS | {250: 2.25e6, 251: 2.5e6, 252: 3.0e6}
BAUDS_320 = {0: 9600.0, 1: 57600.0, 2: 115200.0, 3: 1e6}
RPM_RAD_S = 2 * math.pi / 60
SPEED_RAD_S = {"AX-12A": 0.111 * RPM_RAD_S, "MX-28": 0.114 * RPM_RAD_S, "XL-320": 0.111 * RPM_RAD_S}
ACCELERATION_RAD_S2 = math.radians(8.583)
SLOPE_RAD = math.radians(300.0 / 1024)  # step of a compliance slope; the duty is full at its end
FULL = 1023  # maximum of torque limits and punch
MULTI_TURN = 4095  # value of both angle limits


class Dynamixel1(Servo):
    """An AX or MX servo; the angle limits select joint, wheel or multi-turn mode.

    An XL-320 has the AX's potentiometer, the MX's gains, protocol 2.0 and a mode register.
    """

    protocol = BusProtocol.DYNAMIXEL_1
    framing = Dynamixel1Reader
    bauds = MappingProxyType(MX_BAUDS)
    registered_flag = "registered"

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: HornMounting,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(table, motor, shaft, delivered, seed)
        self.is_mx = "multi_turn_offset" in table.by_name
        self.is_320 = "operating_mode" in table.by_name
        self.bauds = MX_BAUDS if self.is_mx else BAUDS
        if self.is_320:
            self.protocol, self.framing = BusProtocol.DYNAMIXEL_2, Dynamixel2Reader
            self.bauds, self.registered_flag = BAUDS_320, "registered_instruction"
            self.knows_fast_reads = False
        self._locking = "torque_enable" if self.is_320 else "lock"
        bulk_read = {0x08, 0x92} if self.is_mx else set[int]()
        self.instructions = frozenset({1, 2, 3, 4, 5, 6, 0x83} | bulk_read)
        self.speed_unit_rad_s = SPEED_RAD_S[table.model]
        self.turn_base_tick = 0
        self.watch = Dynamixel1Protections(self)
        self._list_live()
        self._list_effects()
        self.start()

    # Status for the line.

    @property
    def return_delay_s(self) -> float:
        """The return delay, from a register in steps of 2 µs."""
        return self.memory.get("return_delay_time") * 2e-6

    @property
    def status_level(self) -> int:
        """The status return level register."""
        return self.memory.get("status_return_level")

    @property
    def alarm(self) -> int:
        """The alarm bits of a status packet; protocol 2.0 has one bit for all causes."""
        return 0x80 if self.is_320 and self.watch.bits else self.watch.bits

    def check_write(self, address: int, data: bytes) -> InstructionError | None:
        """Check a write: read-only registers and values out of range are range errors."""
        end = address + len(data)
        if not data or end > self.table.size:
            return InstructionError.RANGE
        for row in self.table.registers_in(address, len(data)):
            whole = row.address >= address and row.end <= end
            value = row.decode(data[row.address - address : row.end - address]) if whole else 0
            if not row.writable or not whole or not row.accepts(value):
                return InstructionError.RANGE
            if row.area is SimulatedArea.EEPROM and self.memory.get(self._locking):
                return InstructionError.ACCESS if self.is_320 else InstructionError.RANGE
            if self._is_goal_outside(row, value):
                return InstructionError.LIMIT
        return None

    def _is_goal_outside(self, row: SimulatedRegister, value: int) -> bool:
        """Check whether a value is a goal outside the angle limits, or would open the lock."""
        if row.name == "lock":
            return value == 0 and bool(self.memory.get("lock"))
        if row.name != "goal_position":
            return False
        return not self.is_goal_allowed(value)

    def inject_alarm(self, bits: int) -> None:
        """Raise alarm bits without a cause, or clear them."""
        self.watch.inject_alarm(bits)

    def is_goal_allowed(self, goal: int) -> bool:
        """Check whether a goal position is inside the angle limits."""
        lower, upper = self.memory.get("cw_angle_limit"), self.memory.get("ccw_angle_limit")
        return self.is_wheel_mode or self.is_multi_turn or lower <= goal <= upper

    # Position.

    @property
    def is_wheel_mode(self) -> bool:
        """Whether speed is controlled: both angle limits are 0, or the mode of an XL-320 is 1."""
        if self.is_320:
            return self.memory.get("operating_mode") == 1
        return self.memory.get("cw_angle_limit") == self.memory.get("ccw_angle_limit") == 0

    @property
    def is_multi_turn(self) -> bool:
        """Whether positions are multi-turn: both angle limits are 4095 on an MX."""
        limits = self.memory.get("cw_angle_limit"), self.memory.get("ccw_angle_limit")
        return self.is_mx and limits == (MULTI_TURN, MULTI_TURN)

    def present_tick(self) -> int:
        """Compute the value of the present position register."""
        tick = self.shaft.tick_at(self.motor.encoder_rad) - self.turn_base_tick
        if not self.is_mx:
            return max(0, min(1023, tick))
        if not self.is_multi_turn:
            return tick % 4096
        get = self.memory.get
        return (tick + get("multi_turn_offset")) // get("resolution_divider")

    def angle_at(self, position_tick: int) -> float:
        """Compute the joint angle [rad] for a value of the position register."""
        get = self.memory.get
        if self.is_multi_turn:
            position_tick = position_tick * get("resolution_divider") - get("multi_turn_offset")
            return self.shaft.angle_at(position_tick + self.turn_base_tick)
        now_tick = self.shaft.tick_at(self.motor.encoder_rad)
        return self.shaft.angle_at(now_tick - self.present_tick() + position_tick)

    # From memory to drive.

    def start(self) -> None:
        """Set all states from the memory after power-up."""
        self.drive.torque_on = False
        self.watch.start()
        if self.is_mx:
            self.turn_base_tick = self.shaft.tick_at(self.motor.encoder_rad) // 4096 * 4096
        self.memory.put("torque_limit", self.memory.get("max_torque"))
        self.memory.put("goal_position", self.present_tick())
        self.set_gains()
        self.set_limits()
        self.set_goal()

    def set_torque(self) -> None:
        """Apply a write to torque enable."""
        self.drive.torque_on = bool(self.memory.get("torque_enable"))
        self.set_goal()

    def set_position_goal(self) -> None:
        """Apply a write to the goal position, which enables torque."""
        self.memory.put("torque_enable", 1)
        self.watch.bits &= ~ANGLE
        self.set_torque()

    def set_goal(self) -> None:
        """Apply goal, speed and acceleration together after a write to a goal register."""
        drive, get = self.drive, self.memory.get
        speed_rad_s = get("moving_speed") * self.speed_unit_rad_s
        if self.is_mx:
            drive.acceleration_rad_s2 = get("goal_acceleration") * ACCELERATION_RAD_S2
        drive.velocity_limit_rad_s = abs(speed_rad_s)
        # The MX controls its wheel's speed, the AX only its voltage.
        wheel = ControlMode.VELOCITY if self.is_mx else ControlMode.PWM
        drive.mode = wheel if self.is_wheel_mode else ControlMode.POSITION
        drive.goal_velocity_rad_s = self.shaft.sign * speed_rad_s
        drive.goal_pwm = self.shaft.sign * get("moving_speed") / FULL
        drive.goal_rad = self.angle_at(get("goal_position"))

    def set_gains(self) -> None:
        """Apply the gains in SI units; a slope of n steps equals an MX's P gain of 1024 / n."""
        drive, get = self.drive, self.memory.get
        drive.minimum_pwm = get("punch") / FULL
        drive.tick_rad = self.shaft.rad_per_tick
        if self.is_mx or self.is_320:
            unit = 1.0 / (32 * SLOPE_RAD) / (32 / 8)  # P gain 32 is Kp 4 and a slope of 32 steps
            drive.kp = unit * get("p_gain") / 8
            drive.ki = unit * get("i_gain") * 1000 / 2048
            drive.kd = unit * get("d_gain") * 4 / 1000
            return
        drive.dead_zone_rad = get("cw_compliance_margin") * SLOPE_RAD
        slope = get("cw_compliance_slope")  # rounded down to a power of two, at least 2
        steps = max(2, 1 << slope.bit_length() - 1) if slope else 2
        drive.kp = 1.0 / (steps * SLOPE_RAD)

    def set_limits(self) -> None:
        """Apply a write to the torque limit; after a shutdown it enables the motor again."""
        self.watch.clear_overload()
        self.drive.torque_limit = self.memory.get("torque_limit") / FULL

    def run_protections(self, dt_s: float) -> None:
        """Check temperature, load and voltage."""
        self.watch.check(dt_s)

    # Tables of measured registers and of write effects.

    def _list_live(self) -> None:
        motor, unit = self.motor, self.speed_unit_rad_s
        self.live = {
            "present_position": self.present_tick,
            "present_speed": lambda: round(self.shaft.sign * motor.velocity_rad_s / unit),
            "present_load": lambda: round(self.shaft.sign * motor.pwm * FULL),
            "present_voltage": lambda: round(self.supply_v * 10),
            "present_temperature": lambda: int(motor.temperature_c),
            "moving": lambda: int(motor.moving),
            "hardware_error_status": lambda: self.watch.bits,
            "realtime_tick": lambda: int((self.time_s - self.boot_s) * 1000) % 32768,
        }

    def _list_effects(self) -> None:
        goals = ("moving_speed", "goal_acceleration", "cw_angle_limit", "ccw_angle_limit",
                 "multi_turn_offset", "resolution_divider", "operating_mode")  # fmt: skip
        gains = ("p_gain", "i_gain", "d_gain", "punch", "cw_compliance_margin",
                 "cw_compliance_slope")  # fmt: skip
        self.effects = {
            "torque_enable": self.set_torque,
            "goal_position": self.set_position_goal,
            "torque_limit": self.set_limits,
            **dict.fromkeys(goals, self.set_goal),
            **dict.fromkeys(gains, self.set_gains),
        }
