"""Dynamixel X access rules, shutdown, bus watchdog, control table backup."""

from __future__ import annotations

from collections.abc import Callable

from servosim.register import SimulatedArea, SimulatedRegister
from servosim.servo import InstructionError, Servo

_LIMIT_OF = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}
_Rows = tuple[SimulatedRegister, ...]
_GOALS = frozenset((*_LIMIT_OF, "goal_position"))


class AccessRules:
    """Checks writes to one servo's memory.

    Args:
        servo: The servo.
        protections: Refuses torque after a shutdown.
        modes: The operating modes that the servo has.
        current_mode: Returns the effective operating mode.

    Attributes:
        first_data: The first address of indirect data; below it no address is indirect.
    """

    def __init__(
        self,
        servo: Servo,
        protections: DynamixelXProtections,
        modes: tuple[int, ...],
        current_mode: Callable[[], int],
    ) -> None:
        self.memory, self.table = servo.memory, servo.table
        self._protections, self._modes, self._current_mode = protections, modes, current_mode
        names = self.table.by_name
        self._data = {
            row.address: names[
                "indirect_address_" + row.name.removeprefix("indirect_data_")
            ].address
            for row in self.table.registers
            if row.name.startswith("indirect_data_")
        }
        self.first_data = min(self._data)
        self._found: dict[tuple[int, int], _Rows] = {}

    def check_write(self, address: int, data: bytes) -> InstructionError | None:
        """Return why a write is refused; writes to indirect data are checked at their target."""
        if address + len(data) <= self.first_data:
            return self._check_direct_write(address, data)
        for start, part in self._split_runs(address, data):
            refusal = self._check_direct_write(start, part)
            if refusal is not None:
                return refusal
        return None

    def read(self, address: int, length: int, read: Callable[[int, int], bytes]) -> bytes:
        """Read, following indirect addresses."""
        return b"".join(
            read(self._target_address(at), 1) for at in range(address, address + length)
        )

    def store(self, address: int, data: bytes, store: Callable[[int, bytes], None]) -> None:
        """Store, following indirect addresses."""
        for start, part in self._split_runs(address, data):
            store(start, part)

    def _target_address(self, address: int) -> int:
        at = self._data.get(address)
        if at is None:
            return address
        return int.from_bytes(self.memory.image[at : at + 2], "little")

    def _split_runs(self, address: int, data: bytes) -> list[tuple[int, bytes]]:
        """Split a write into runs of neighbouring bytes, following indirect addresses."""
        runs: list[tuple[int, bytes]] = []
        for k in range(len(data)):
            target = self._target_address(address + k)
            if runs and runs[-1][0] + len(runs[-1][1]) == target:
                runs[-1] = (runs[-1][0], runs[-1][1] + data[k : k + 1])
            else:
                runs.append((target, data[k : k + 1]))
        return runs

    def _check_direct_write(self, address: int, data: bytes) -> InstructionError | None:
        rows = self._rows_at(address, len(data))
        if isinstance(rows, InstructionError):
            return rows
        for row in rows:
            value = row.decode(data[row.address - address : row.end - address])
            refusal = self._check_access(row)
            if refusal is not None:
                return refusal
            if not self._accepts(row, value):
                return InstructionError.RANGE
        return None

    def _rows_at(self, address: int, length: int) -> _Rows | InstructionError:
        """Return the registers of a range of bytes, or the reason why it may not be written."""
        rows = self._found.get((address, length))
        if rows is None:
            if not self.table.is_gapless(address, length):
                return InstructionError.ACCESS
            rows = self.table.registers_in(address, length)
            if rows[0].address < address or rows[-1].end > address + length:
                return InstructionError.LENGTH
            self._found[address, length] = rows
        return rows

    def _check_access(self, row: SimulatedRegister) -> InstructionError | None:
        get = self.memory.get
        if not row.writable or (row.persists and get("torque_enable")):
            return InstructionError.ACCESS
        if row.name in _GOALS and get("bus_watchdog") == -1:
            return InstructionError.RANGE
        if row.name == "torque_enable" and self._protections.shut_down:
            return InstructionError.RESULT_FAIL
        return None

    def _accepts(self, row: SimulatedRegister, value: int) -> bool:
        """Check whether a value is in its register's range, which may depend on other registers."""
        get, name = self.memory.get, row.name
        if name == "operating_mode":
            return value in self._modes
        if name == "goal_position" and self._current_mode() == 3:
            return get("min_position_limit") <= value <= get("max_position_limit")
        limit = _LIMIT_OF.get(name)
        return abs(value) <= get(limit) if limit else row.lower <= value <= row.upper


VOLTAGE, HEAT, ENCODER, SHOCK, OVERLOAD = 0x01, 0x04, 0x08, 0x10, 0x20
OVERLOAD_AFTER_S = 2.0  # assumed: the sheets say "persistent"
OVERLOAD_FRACTION = 0.9  # assumed fraction of the largest output that counts as overload
IN_POSITION_TICK = 8  # assumed
FOLLOWING_TICK = 200  # assumed


class DynamixelXProtections:
    """Protections and status bits of one servo.

    Args:
        servo: The servo.
        current_mode: Returns its operating mode.
        hold_position: Stops it at its position.
    """

    def __init__(
        self, servo: Servo, current_mode: Callable[[], int], hold_position: Callable[[], None]
    ) -> None:
        self.servo = servo
        self._current_mode, self._hold_position = current_mode, hold_position
        self.shut_down = False
        self._overload_s = 0.0
        self._injected = 0

    def start(self) -> None:
        """Start again after power-up; only this clears a shutdown."""
        self.shut_down = False
        self._overload_s = 0.0
        self._injected = 0

    def raise_alarm(self, bits: int) -> None:
        """Set hardware error bits; those in the shutdown register switch torque off."""
        servo = self.servo
        servo.memory.put("hardware_error_status", servo.memory.get("hardware_error_status") | bits)
        if bits & servo.memory.get("shutdown"):
            self.shut_down = True
            servo.memory.put("torque_enable", 0)
            servo.cut_torque()

    def check(self, dt_s: float) -> None:
        """Run all protections once; ``dt_s`` is the time since the last check."""
        get, servo = self.servo.memory.get, self.servo
        if servo.motor.temperature_c > get("temperature_limit"):
            self.raise_alarm(HEAT)
        if not get("min_voltage_limit") <= round(servo.supply_v * 10) <= get("max_voltage_limit"):
            self.raise_alarm(VOLTAGE)
        self._check_load(dt_s)
        self._check_bus_watchdog()

    def start_watchdog(self) -> None:
        """Apply a write to the bus watchdog: the interval starts now."""
        self.servo.received_s = self.servo.time_s

    def moving_status(self) -> int:
        """Compute the moving status register: arrival, profile and its kind, following error."""
        servo, motor = self.servo, self.servo.motor
        if self._current_mode() not in (3, 4, 5):
            return 0
        unit = servo.shaft.rad_per_tick
        arrived = abs(servo.drive.goal_rad - motor.encoder_rad) <= IN_POSITION_TICK * unit
        lagging = abs(motor.reference_rad - motor.encoder_rad) > FOLLOWING_TICK * unit
        return arrived | motor.profile_running << 1 | lagging << 3 | self._profile_kind()

    def _profile_kind(self) -> int:
        drive = self.servo.drive
        if drive.velocity_limit_rad_s == 0 and drive.profile_time_s == 0:
            return 0x00
        ramps = drive.acceleration_rad_s2 > 0 or drive.acceleration_time_s > 0
        return 0x30 if ramps else 0x10

    def _check_load(self, dt_s: float) -> None:
        servo, motor = self.servo, self.servo.motor
        heavy = abs(motor.torque_nm) > OVERLOAD_FRACTION * motor.parameters.stall_torque_nm
        self._overload_s = self._overload_s + dt_s if heavy and servo.drive.torque_on else 0.0
        if self._overload_s > OVERLOAD_AFTER_S:
            self.raise_alarm(OVERLOAD)

    def _check_bus_watchdog(self) -> None:
        servo = self.servo
        steps = servo.memory.get("bus_watchdog")
        late = servo.time_s - servo.received_s > steps * 0.020
        if steps > 0 and servo.drive.torque_on and late:
            servo.memory.put("bus_watchdog", -1)
            self._hold_position()


class ControlTableBackup:
    """The stored copy of one servo's writable RAM, without goals and torque.

    Args:
        servo: The servo.
        apply_settings: Applies gains and profile to its drive after they were restored.
    """

    def __init__(self, servo: Servo, apply_settings: Callable[[], None]) -> None:
        self.servo, self._apply_settings = servo, apply_settings
        self._rows = [
            row
            for row in servo.table.registers
            if row.area is SimulatedArea.RAM
            and row.writable
            and not row.name.startswith(("goal_", "torque_", "indirect_data_"))
        ]
        self._kept: dict[str, int] | None = None

    @property
    def is_available(self) -> bool:
        """Whether there is something to restore."""
        return self._kept is not None

    def store(self) -> InstructionError | None:
        """Store the present values."""
        if self.servo.drive.torque_on:
            return InstructionError.RESULT_FAIL
        self._kept = {row.name: self.servo.memory.get(row.name) for row in self._rows}
        return None

    def restore(self) -> InstructionError | None:
        """Restore the stored values."""
        if self._kept is None or self.servo.drive.torque_on:
            return InstructionError.RESULT_FAIL
        for name, value in self._kept.items():
            self.servo.memory.put(name, value)
        self._apply_settings()
        return None
