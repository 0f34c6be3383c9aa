"""Panel with the registers of a joint's servo: read on request, written after checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ikservo.apps.page.running.arm_job import JobObserver
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.apps.page.server.server import Frame
from ikservo.apps.workbench.servo_workbench import (
    ServoLine,
    find_register,
    holds_torque,
    parse_register_value,
    plan_writes,
    read_registers,
    write_registers,
)
from ikservo.arm import Arm
from ikservo.errors import BusError, IkservoError, InputError, PortError, RegisterAccessError
from ikservo.hardware.register_batches import Register
from ikservo.hardware.servo import ServoSpec

# Registers that move the arm, stop its replies or belong to its calibration are set elsewhere.
_ELSEWHERE = {
    "torque_enable": "Use the switch beside the joint.",
    "id": "Press Set up servos in the list of arms.",
    "baud_rate": "Press Set up servos in the list of arms.",
    "homing_offset": "Calibrate the arm.",
    "position_offset": "Calibrate the arm.",
    "min_position_limit": "Calibrate the arm.",
    "max_position_limit": "Calibrate the arm.",
    "operating_mode": "In a terminal: ikservo servo write",
    "lock": "Each write locks the EEPROM again.",
    **dict.fromkeys(
        (
            "angular_resolution", "cw_angle_limit", "ccw_angle_limit", "drive_mode",
            "moving_speed", "multi_turn_offset", "phase", "protocol_type", "resolution_divider",
            "response_level", "secondary_id", "shutdown", "startup_configuration",
            "status_return_level",
        ),
        "In a terminal: ikservo servo write",
    ),
}  # fmt: skip


def _is_written_here(name: str) -> bool:
    return name not in _ELSEWHERE and not name.startswith("goal_")


class ServoPanel:
    """Display of one servo's control table, and writer of its registers, in the arm's thread."""

    def __init__(self, arm_thread: ArmThread) -> None:
        self._arm_thread = arm_thread
        self._fields: Frame = {"kind": "servo", "joint": None, "registers": [], "note": ""}

    def read(self, joint: str) -> None:
        """Read the whole table of a joint's servo.

        Raises:
            InputError: The arm is busy, follows the page or was stopped, or there is no such joint.
        """
        self._start(joint, "", "")

    def write(self, joint: str, name: str, text: str) -> None:
        """Write a raw integer, or a number with a unit, to a register, and read the table again.

        Raises:
            InputError: The errors of ``read``; or the page cannot write the register.
        """
        if not _is_written_here(name):
            hint = _ELSEWHERE.get(name, "Move the joint by its slider.")
            raise InputError(f"The page cannot write {name}.", hint)
        self._start(joint, name, text)

    def _start(self, joint: str, name: str, text: str) -> None:
        self._arm_thread.arm.joint_index.column(joint)
        self._arm_thread.request_job(_ServoJob(self, joint, name, text))

    def show(self, fields: Frame) -> None:
        """Replace the table that pages show."""
        self._fields = fields

    def frames(self, client: Client) -> list[Frame]:
        """Return the new frames for a client."""
        if client.sent.get("servo") is self._fields:
            return []
        client.sent["servo"] = self._fields
        return [self._fields]


class _ServoJob:
    """Job that writes a servo's register, if one is named, and reads its table (``ArmJob``)."""

    is_planned = False

    def __init__(self, panel: ServoPanel, joint: str, name: str, text: str) -> None:
        self._panel, self._joint, self._name, self._text = panel, joint, name, text
        self.title = f"Reading the servo of {joint}"

    def run(self, arm: Arm, observer: JobObserver) -> None:
        """Write and read; if the servo or its table refuses a value, only note it for the page.

        Raises:
            PortError: The port is lost.
        """
        bus = arm.context.servos.bus
        line = ServoLine(bus)
        servo = next(each for each in bus.servos.values() if each.name == self._joint)
        level = ""
        try:
            note = self._write(line, servo) if self._name else ""
        except PortError:
            raise
        except (InputError, RegisterAccessError, BusError) as error:
            note, level = f"{error.message} {error.command_hint}".strip(), "bad"
        observer.log_message(note, level)
        self._panel.show(table_frame(line, servo, note, _is_written_here))

    def _write(self, line: ServoLine, servo: ServoSpec) -> str:
        register = find_register(servo.table, self._name)
        if not _is_written_here(register.name):  # the name may be an alias of a forbidden register
            raise InputError(f"The page cannot write {register.name}.")
        try:
            return write_limp(line, servo, {register: parse_register_value(register, self._text)})
        except OSError as error:  # the disk has no room for the backup of the EEPROM
            if not isinstance(error, IkservoError) or isinstance(error, PortError):
                raise
            raise InputError(error.message, error.command_hint) from error


def write_values(line: ServoLine, servo: ServoSpec, values: Mapping[Register, int]) -> str:
    """Write registers after the checks of ``plan_writes``; describe the changes.

    Raises:
        IkservoError: The errors of ``plan_writes`` and ``write_registers``.
    """
    changes = plan_writes(line, servo, values)
    write_registers(line, servo, changes)
    return f"{servo}: {', '.join(map(str, changes)) or 'nothing to change'}."


def write_limp(line: ServoLine, servo: ServoSpec, values: Mapping[Register, int]) -> str:
    """Write registers of a servo without torque, as ``write_values`` does.

    Raises:
        InputError: The servo's torque is on.
        IkservoError: The errors of ``write_values``.
    """
    if holds_torque(line, servo):
        raise InputError(
            f"{servo} holds a joint, which could fall if values change.",
            "Support the joint, and switch its torque off first.",
        )
    return write_values(line, servo, values)


def table_frame(
    line: ServoLine, servo: ServoSpec, note: str, is_written: Callable[[str], bool]
) -> dict[str, Any]:
    """Read a servo's table and return it as a page shows it.

    Raises:
        BusError: The servo does not reply.
    """
    rows = [
        {
            "name": each.register.name,
            "address": each.register.address,
            "raw": each.raw,
            "value": each.text,
            "range": list(each.register.range),
            "area": each.register.area.name,
            "writable": each.register.is_writable and is_written(each.register.name),
            "default": each.default,
            "first": each.first if each.changed else None,
        }
        for each in read_registers(line, servo)
    ]
    return {
        "kind": "servo",
        "joint": servo.name or str(servo.id),
        "id": servo.id,
        "model": servo.table.model_name,
        "registers": rows,
        "note": note,
    }
