"""Raise and lower servo gains in RAM, and keep former values on disk while others are tried.

A program that is killed leaves the trial values in the servo until its power goes off; a file holds
the former ones: ``{"p_gain": 32}``, or with the lowered value, ``{"p_gain": [32, 8]}``.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from pydantic import TypeAdapter, ValidationError

from ikservo.control.joint_reading import read_registers
from ikservo.errors import FileFormatError, RegisterAccessError
from ikservo.files.reading import config_dir, read_text
from ikservo.files.writing import FileWriteError, remove_durably, write_atomic
from ikservo.guard import DrivenJoint
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import RegisterDifference, register_differences
from ikservo.hardware.port_choice import is_simulator
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.servo import ServoSpec
from ikservo.model.servo_torque import GRIPPER_P_GAINS, find_servo_torque
from ikservo.registers import Register

# The XL330's P gain is used for the elbows of Koch and OMX arms, and needs a D gain. The XL430 has
# a D gain by default; its P gain is the value that ROBOTIS sets in the OMX-F.
_XL330_GAINS: Mapping[str, int] = MappingProxyType(
    {"position_d_gain": 600, "position_p_gain": 1500}
)
_XL430_GAINS: Mapping[str, int] = MappingProxyType({"position_p_gain": 1000})
_ARM_GAINS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {"XL330-M288": _XL330_GAINS, "XL330-M077": _XL330_GAINS, "XL430-W250": _XL430_GAINS}
)
# A gripper is slightly softer.
_GRIPPER_GAINS: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {name: {"position_p_gain": gain} for name, gain in GRIPPER_P_GAINS.items()}
)
_NO_GAINS: Mapping[str, int] = MappingProxyType({})


def raise_gains(bus: ServoBus, servo_id: int, *, gripper: bool) -> None:
    """Raise the gains of a servo in RAM if its defaults are too low.

    Raises:
        BusError: The servo does not answer.
    """
    table = bus.servos[servo_id].table
    gains = (_GRIPPER_GAINS if gripper else _ARM_GAINS).get(table.model_name, _NO_GAINS)
    for name, gain in gains.items():
        if bus.read(servo_id, table.registers[name], raw=True) < gain:
            bus.write(servo_id, table.registers[name], gain, raw=True)


_GAIN_NAMES = ("position_p_gain", "p_gain")


def read_gain_shares(bus: ServoBus, driven_joints: Sequence[DrivenJoint]) -> list[float]:
    """Read each joint's P gain as a fraction of the gain for which the motor table is valid.

    The fraction is 1 if the gain or the register is not known.

    Raises:
        BusError: A servo does not answer.
    """
    keys: dict[int, list[Register]] = {}
    for driven in driven_joints:
        registers = bus.servos[driven.servo_id].table.registers
        keys[driven.servo_id] = [registers[name] for name in _GAIN_NAMES if name in registers]
    read = read_registers(bus, {i: found for i, found in keys.items() if found})
    shares: list[float] = []
    for driven in driven_joints:
        torque = find_servo_torque(bus.servos[driven.servo_id].table.model_name, None)
        gain = next(iter(read.get(driven.servo_id, {}).values()), 0)
        shares.append(gain / torque.p_gain if torque and gain else 1.0)
    return shares


_LOWERED = ("p_gain", "i_gain", "d_gain", "position_p_gain", "position_i_gain", "position_d_gain")
_LOWERED_SHARE = 0.25


class LoweredGains:
    """Lowers the gains of servos in RAM for a time.

    Args:
        bus: The bus of the servos.

    Attributes:
        former: The former gains of servos whose gains are lowered, by id.
    """

    def __init__(self, bus: ServoBus) -> None:
        self._bus, self.former = bus, dict[int, dict[Register, int]]()

    def lower(self, servo_id: int) -> float:
        """Lower the gains of a servo; return how many times softer it is.

        The result is 1, and the gains stay, if they cannot be remembered or belong to a trial.

        Raises:
            BusError: The servo does not reply.
        """
        bus, servo = self._bus, self._bus.servos[servo_id]
        known = [servo.table.registers[n] for n in _LOWERED if n in servo.table.registers]
        if not known or _former_path(bus, servo).exists():
            return 1.0
        read = bus.sync_read_many([servo_id], known, raw=True).values.get(servo_id, {})
        former = {register: raw for register, raw in read.items() if raw > 1}
        if known[0] not in former:
            return 1.0
        self.former[servo_id] = former
        lowered = {register: round(raw * _LOWERED_SHARE) or 1 for register, raw in former.items()}
        try:
            note_former(bus, servo, former, lowered)
            for register, raw in lowered.items():
                bus.write_until_power_off(servo_id, register, raw)
        except (FileWriteError, RegisterAccessError):  # the servo would store them
            self.restore(servo_id)
            return 1.0
        return former[known[0]] / lowered[known[0]]

    def restore(self, servo_id: int) -> None:
        """Write the former gains of a servo whose gains were lowered.

        Raises:
            BusError: The servo does not reply; its gains will be restored when the arm is opened.
        """
        for register, raw in self.former[servo_id].items():
            with contextlib.suppress(RegisterAccessError):  # which also refused the lowered value
                self._bus.write_until_power_off(servo_id, register, raw)
        del self.former[servo_id]
        with contextlib.suppress(OSError):  # the next opening removes the file
            _former_path(self._bus, self._bus.servos[servo_id]).unlink(missing_ok=True)


_Former = int | tuple[int, int]  # with the lowered value, if it was lowered
_FORMER: TypeAdapter[dict[str, _Former]] = TypeAdapter(dict[str, _Former])
_MOST_BYTES = 10_000


def note_former(
    bus: ServoBus,
    servo: ServoSpec,
    former: Mapping[Register, int],
    lowered: Mapping[Register, int] | None = None,
) -> None:
    """Write the present values of a real servo to a file before others are tried.

    If ``lowered`` has the new values, the present ones are put back when the arm is opened again.
    Such a file need not survive a power cut, and a motion cannot wait for the disk: after 0.1 s
    without packets, the watchdogs stop the servos.

    Raises:
        FileWriteError: The file cannot be written.
    """
    if not is_simulator(bus.port.name):
        rows = {r.name: (raw, lowered[r]) if lowered else raw for r, raw in former.items()}
        text = f"{json.dumps(rows)}\n"
        write_atomic(_former_path(bus, servo), text, synced=lowered is None)


def forget_former(bus: ServoBus, servo: ServoSpec) -> None:
    """Remove the file, because the servo keeps its present values."""
    if (path := _former_path(bus, servo)).exists():
        remove_durably(path)


def forget_if_former(bus: ServoBus, servo: ServoSpec, registers: Container[Register]) -> None:
    """Remove the file if it has any of the registers; keep a damaged file."""
    with contextlib.suppress(FileFormatError):
        if any(register in registers for register in read_former(bus, servo)):
            forget_former(bus, servo)


def read_former(bus: ServoBus, servo: ServoSpec) -> dict[Register, _Former]:
    """Return the values from before an interrupted trial; empty if no trial was interrupted.

    Raises:
        FileFormatError: The file is damaged.
    """
    path = _former_path(bus, servo)
    if not path.exists():
        return {}
    try:
        former = _FORMER.validate_json(read_text(path, _MOST_BYTES), strict=True)
        return {servo.table.registers[name]: raw for name, raw in former.items()}
    except (ValidationError, ValueError, KeyError, RecursionError) as error:
        way_out = "register values; rename the file, then switch the servo's power off and on"
        raise FileFormatError(path, "", "is damaged", way_out) from error


def tried_differences(bus: ServoBus, servo: ServoSpec) -> list[RegisterDifference]:
    """Return the trial values that an interrupted trial has left in a servo.

    Raises:
        FileFormatError: The file is damaged.
        BusError: The servo does not reply.
    """
    rows = read_former(bus, servo)
    former = {r: raw if isinstance(raw, int) else raw[0] for r, raw in rows.items()}
    return register_differences(bus, servo.id, {**former}) if former else []


def restore_former(bus: ServoBus, servo: ServoSpec) -> list[RegisterDifference]:
    """Write the values from before an interrupted trial, and return the changes.

    Raises:
        FileFormatError: The file is damaged.
        BusError: The servo does not reply.
    """
    changes = tried_differences(bus, servo)
    for each in changes:
        bus.write_until_power_off(servo.id, each.register, each.expected)
    forget_former(bus, servo)
    return changes


def restore_lowered(bus: ServoBus) -> list[str]:
    """Put back gains that a killed program has left lowered; return a warning for each gain.

    Gains that were changed since are kept, and so are the values of a trial.

    Raises:
        BusError: A servo does not reply.
    """
    restored: list[str] = []
    for servo in bus.servos.values():
        with contextlib.suppress(FileFormatError, FileWriteError, RegisterAccessError):
            rows = read_former(bus, servo)
            if not any(isinstance(raw, tuple) for raw in rows.values()):
                continue
            changes = tried_differences(bus, servo)
            left = [each for each in changes if rows[each.register] == (each.expected, each.found)]
            for each in left:
                bus.write_until_power_off(servo.id, each.register, each.expected)
                restored.append(f"{servo}: gain lowered by a killed program, put back: {each}.")
            forget_former(bus, servo)
    return restored


def _former_path(bus: ServoBus, servo: ServoSpec) -> Path:
    owner = serial_number_of(bus.port.name) or "servos"
    return config_dir() / "tried" / f"{owner}_{servo.id:03}_{servo.table.model_name}.json"
