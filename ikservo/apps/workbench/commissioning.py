"""Set up new servos: ids, baud rate, first settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ikservo.apps.workbench.id_and_baud_rate import (
    ServoSettings,
    check_model,
    provision,
    wait_for_servo,
    wait_until_unplugged,
)
from ikservo.arm.opening import backup_owner, resolve_port
from ikservo.errors import IkservoError, UnknownNameError
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.scan import FoundServo
from ikservo.hardware.servo import ServoSpec
from ikservo.maintenance.dialogue import ACCEPT, Dialogue, Notice, Progress, Question, Unasked
from ikservo.model import Model
from ikservo.registers import control_table


@dataclass(frozen=True, slots=True)
class ConfiguredServo:
    """A servo after its set-up, with its former settings and descriptions of the changes."""

    servo: ServoSpec
    found: FoundServo
    written: tuple[str, ...]

    def __str__(self) -> str:
        return f"✓ {self.servo}: {', '.join(self.written) or 'nothing to change'}"


def planned_settings(model: Model) -> list[ServoSettings]:
    """Return the settings of each servo of an arm, in the arm file's order."""
    return [
        ServoSettings(
            ServoSpec(servo.id, control_table(servo.model), joint.name),
            model.baud_rate,
            servo.eeprom,
        )
        for joint in model.joints
        for servo in (joint.servo, *joint.shadows)
    ]


def remaining_settings(model: Model, start: str | None) -> list[ServoSettings]:
    """Return the settings of an arm's servos, beginning with a given joint; None: all servos.

    Raises:
        UnknownNameError: The arm has no such joint.
    """
    todo = planned_settings(model)
    names = [settings.servo.name for settings in todo]
    if start is None:
        return todo
    if start not in names:
        raise UnknownNameError("joint", start, names)
    return todo[names.index(start) :]


def open_line(model: Model, port: str | None) -> Port:
    """Open the port for servos that are plugged in one by one.

    Raises:
        PortError: There is no port, or it cannot be opened.
    """
    return open_port(resolve_port(model, port), model.baud_rate)


def configure_servos(
    line: Port,
    model: Model,
    todo: Sequence[ServoSettings],
    wait_s: float,
    on_configured: Callable[[ConfiguredServo], None],
) -> Dialogue[None]:
    """Configure one servo after another, each plugged in alone; see ``configure_servo``.

    Args:
        line: The port, see ``open_line``.
        model: The arm.
        todo: The desired settings of the servos, see ``remaining_settings``.
        wait_s: The time to wait until a servo is plugged in, or unplugged.
        on_configured: Called with each servo that is done.
    """
    for number, settings in enumerate(todo, start=1):
        configured = yield from configure_servo(line, model, settings, wait_s)
        on_configured(configured)
        if number < len(todo):
            yield Notice("Unplug this servo.")
            now = replace(configured.found, id=settings.servo.id, baud_rate=settings.baud_rate)
            for _ in wait_until_unplugged(line, now, wait_s):
                yield Progress("waiting until it is unplugged")


def configure_servo(
    line: Port, model: Model, settings: ServoSettings, wait_s: float
) -> Dialogue[ConfiguredServo]:
    """Wait for one servo, and give it its id, baud rate and settings.

    Raises:
        PortError: The port is lost.
        ServoSilentError: No servo was plugged in, or several are.
        CalibrationError: The servo is a different model.
        BusError: The servo did not keep a written value.
        FileWriteError: The EEPROM copy cannot be written; this servo was not changed.
        IkservoError: The user declined; this servo was not changed.
    """
    servo = settings.servo
    owners = {each.servo.id: each.servo.name for each in planned_settings(model)}
    yield Notice("")
    model_name = servo.table.model_name
    place = f"{list(owners).index(servo.id) + 1} of {len(owners)}"
    yield Notice(f"{place}: plug in only the {model_name} of {servo} …", joint=servo.name)
    yield Notice("Searching at every baud rate. If you stop, finished servos keep their settings.")
    found = yield from _find_servo(line, settings, wait_s)
    check_model(found, settings)
    used = f" It was used before, for {owners.get(found.id, 'another joint')}; new ones have id 1."
    used = "" if found.id in (1, servo.id) else used
    yield Notice(f"Found {found}, firmware {found.firmware}.{used}")
    if (found.id, found.baud_rate) != (servo.id, settings.baud_rate):
        question = f"Set it to id {servo.id} at {settings.baud_rate} baud for {servo.name}?"
        if (yield Question(question, Unasked.ERROR)) != ACCEPT:
            raise IkservoError("Cancelled; this servo was not changed.")
    owner = backup_owner(line.name, model.name)
    return ConfiguredServo(servo, found, provision(line, found, settings, owner))


def _find_servo(line: Port, settings: ServoSettings, wait_s: float) -> Dialogue[FoundServo]:
    """Wait for the only servo on the line; report the search and whether several servos reply."""
    search = wait_for_servo(line, settings.servo.table, settings.baud_rate, wait_s)
    while True:
        try:
            seen = next(search)
        except StopIteration as end:
            return end.value
        if isinstance(seen, int):
            yield Progress(f"searching at {seen} baud")
        elif len(seen) > 1 or any(servo.shares_id for servo in seen):
            listed = "; ".join(map(str, seen))
            name = settings.servo.name
            yield Notice(
                f"More than one servo answers: {listed}. Plug in only the servo of {name}."
            )
