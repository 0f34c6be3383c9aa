"""What Feetech servos have in common: values clipped to their ranges, the lock, the alarms."""

from __future__ import annotations

from collections.abc import Mapping

from servosim.drive import Mode
from servosim.frames import Dynamixel1Reader
from servosim.motor import Motor
from servosim.protocol import Protocol, Refusal
from servosim.servo import Servo
from servosim.servos.feetech_watch import FeetechWatch
from servosim.shaft import Shaft
from servosim.tables import Area, ServoTable

__all__ = ["BAUDS", "Feetech"]

# fmt: off
BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400,
         19_200, 14_400, 9_600, 4_800)
# fmt: on
DAMPING = 2  # written to torque_enable: the shaft turns heavily
PHASE_ZERO_IS_MAX = 0x08  # goal speed 0 means the greatest speed


class Feetech(Servo):
    """A Feetech servo; the series add their units and modes."""

    protocol = Protocol.FEETECH
    framing = Dynamixel1Reader
    registered_flag = "async_write"
    kept_by_recovery = ("id",)
    kp_per_gain = 5.3 / 32  # duty for each radian and each step of the P gain (SO-101 MJCF)
    kd_per_gain = 0.001  # assumed [s/rad]
    ki_per_gain = 0.05  # assumed [1/(rad s)]

    def __init__(
        self,
        table: ServoTable,
        motor: Motor,
        shaft: Shaft,
        delivered: Mapping[str, int] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(table, motor, shaft, delivered, seed)
        self.watch = FeetechWatch(self)
        self.list_live()
        self.list_effects()
        self.start()

    # The line's questions.

    @property
    def return_delay_s(self) -> float:
        """The return delay register, 2 µs a step."""
        return self.memory.get("return_delay") * 2e-6

    @property
    def status_level(self) -> int:
        """The response level: 1 answers everything, 0 only pings and reads."""
        return 2 if self.memory.get("response_level") else 1

    @property
    def alarm(self) -> int:
        """The status register."""
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
        end, image, opened = address + len(data), self.memory.image, self.eeprom_open
        for row in self.table.covered(address, len(data)):
            if row.address >= address and row.end <= end:
                raw = data[row.address - address : row.end - address]
            else:
                asked = bytearray(image)
                asked[address:end] = data
                raw = bytes(asked[row.address : row.end])
            value = row.decode(raw)
            if not row.accepts(value):
                raw = row.encode(max(row.lower, min(row.upper, value)))
            if row.writable:
                self.memory.write(row.address, raw, persist=opened and row.area is Area.EEPROM)
        self.set_off(address, len(data))

    def supervise(self, dt_s: float) -> None:
        """Look after heat, load and voltage."""
        self.watch.look(dt_s)

    def inject_alarm(self, bits: int) -> None:
        """Raise alarm bits without a cause, or take them back."""
        self.watch.inject(bits)

    def allows(self, goal: int) -> bool:
        """Say whether a goal position lies inside the limits; both zero are none."""
        lower, upper = self.memory.get("min_position_limit"), self.memory.get("max_position_limit")
        return lower == upper == 0 or lower <= goal <= upper

    # Position.

    def present_tick(self) -> int:
        """Return the present position register's number."""
        return self.shaft.tick_at(self.motor.encoder_rad)

    def angle_at(self, position_tick: int) -> float:
        """Return the joint angle [rad] of a position register's number."""
        return self.shaft.angle_at(position_tick)

    def hold_here(self) -> None:
        """Make the present position the goal."""
        self.memory.put("goal_position", self.present_tick())
        self.set_goal()

    # From memory to drive.

    def start(self) -> None:
        """Set everything from the memory after power-up; the goal is where the servo is."""
        self.drive.torque_on = False
        self.watch.start()
        self.memory.put("goal_position", self.present_tick())
        for effect in (self.set_gains, self.set_limits, self.set_mode):
            effect()

    def set_torque(self) -> None:
        """Torque enable written: 0 off, 1 on, 2 damping."""
        self.watch.release()
        self.drive.torque_on = self.memory.get("torque_enable") != 0
        self.set_mode()

    def set_mode(self) -> None:
        """Operating mode or torque written."""
        damping = self.memory.get("torque_enable") == DAMPING
        self.drive.mode = Mode.PWM if damping else self.asked_mode()
        self.set_goal()
        if damping:
            self.drive.goal_pwm = 0.0

    def set_goal(self) -> None:
        """A goal register was written: hand goal and profile over together."""
        raise NotImplementedError

    def asked_mode(self) -> Mode:
        """Return the mode that the memory asks for."""
        raise NotImplementedError

    def set_gains(self) -> None:
        """Hand the gains over in SI."""
        drive, get = self.drive, self.memory.get
        drive.kp = get("p_gain") * self.kp_per_gain
        drive.kd = get("d_gain") * self.kd_per_gain
        drive.ki = get("i_gain") * self.ki_per_gain
        drive.minimum_pwm = get("min_startup_force") / 1000
        drive.dead_zone_rad = get("cw_dead_zone") * self.shaft.rad_per_tick

    def set_limits(self) -> None:
        """Hand the limits over; an overload keeps its own torque limit."""
        self.drive.torque_limit = self.watch.torque_limit()

    def clamped_goal(self) -> int:
        """Return the goal position inside the limits; limits both 0 are none."""
        get = self.memory.get
        lower, upper = get("min_position_limit"), get("max_position_limit")
        goal = get("goal_position")
        return goal if lower == upper == 0 else max(lower, min(upper, goal))

    def profile_speed(self, speed_rad_s: float) -> float:
        """Return the speed limit for a goal speed: 0 means the greatest, or to stand still."""
        stands = speed_rad_s == 0.0 and not self.memory.get("phase") & PHASE_ZERO_IS_MAX
        return 1e-6 if stands else speed_rad_s

    # Tables of what is measured and what is set off.

    def list_live(self) -> None:
        """Fill ``live``; the series add their own."""
        motor = self.motor
        self.live = {
            "present_position": self.present_tick,
            "present_load": lambda: round(self.shaft.sign * motor.pwm * 1000),
            "present_voltage": lambda: round(self.supply_v * 10),
            "present_temperature": lambda: int(motor.temperature_c),
            "status": lambda: self.watch.bits,
            "moving": lambda: int(motor.moving),
        }

    def list_effects(self) -> None:
        """Fill ``effects``; the series add their own."""
        gains = ("p_gain", "d_gain", "i_gain", "min_startup_force", "cw_dead_zone")
        goals = ("goal_time", "goal_speed", "phase", "min_position_limit", "max_position_limit")
        self.effects = {
            "torque_enable": self.set_torque,
            "goal_position": self.set_goal,
            **dict.fromkeys(gains, self.set_gains),
            **dict.fromkeys(goals, self.set_goal),
        }
