"""Set up new servos: ids, baud rate, first settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.arm.opening import resolve_port
from ikservo.errors import IkservoError, UnknownNameError
from ikservo.hardware.port import Port, open_port
from ikservo.hardware.provisioning import (
    ServoSettings,
    check_model,
    provision,
    wait_for_servo,
    wait_until_unplugged,
)
from ikservo.hardware.scan import FoundServo
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model
from ikservo.registers import control_table

__all__ = ["ConfiguredServo", "ServoSettings", "SetupPrompt", "commission", "planned_settings"]


@dataclass(frozen=True, slots=True)
class ConfiguredServo:
    """A servo after its set-up.

    Attributes:
        servo: Its id, table and joint.
        found: As it was before.
        written: Descriptions of what was changed; empty where nothing was.
    """

    servo: ServoSpec
    found: FoundServo
    written: tuple[str, ...]


class SetupPrompt(Protocol):
    """The dialogue with the user."""

    def request_servo(self, settings: ServoSettings, /) -> None:
        """Request that only this servo be plugged in."""
        ...

    def show_found(self, found: Sequence[FoundServo]) -> None:
        """Show the servos that reply; called each time they change."""
        ...

    def show_search(self, baud_rate: int) -> None:
        """Show the baud rate that is searched; called before each."""
        ...

    def confirm_write(self, settings: ServoSettings, found: FoundServo, /) -> bool:
        """Return whether this servo may be written."""
        ...

    def report(self, configured: ConfiguredServo, /, *, last: bool) -> None:
        """Report that a servo is done; unless it is the last, request that it be unplugged."""
        ...


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


def commission(
    model: Model, port: str | None, helper: SetupPrompt, *, start: str | None, wait_s: float
) -> list[ConfiguredServo]:
    """Give each servo of an arm its id, baud rate and settings.

    Args:
        model: The arm.
        port: See ``choose_port``.
        helper: The dialogue with the user.
        start: The joint to start with; the first if None.
        wait_s: How long to wait for each servo to be plugged in or out.

    Raises:
        UnknownNameError: The arm has no joint ``start``.
        PortError: No port, or it is lost.
        ServoSilentError: No servo was plugged in, or several are.
        CalibrationError: A servo is of another model.
        BusError: A servo did not keep a written value.
    """
    todo = _remaining_from(planned_settings(model), start)
    done: list[ConfiguredServo] = []
    with open_port(resolve_port(model, port), model.baud_rate) as opened_port:
        for settings in todo:
            configured = _configure_servo(opened_port, settings, helper, wait_s)
            last = settings is todo[-1]
            done.append(configured)
            helper.report(configured, last=last)
            if not last:
                now = _found_now(settings, configured.found)
                wait_until_unplugged(opened_port, now, wait_s)
    return done


def _configure_servo(
    port: Port, settings: ServoSettings, helper: SetupPrompt, wait_s: float
) -> ConfiguredServo:
    helper.request_servo(settings)
    found = wait_for_servo(
        port,
        settings.servo.table,
        settings.baud_rate,
        wait_s,
        helper.show_found,
        helper.show_search,
    )
    check_model(found, settings)
    if not helper.confirm_write(settings, found):
        raise IkservoError("Cancelled; this servo was not changed.")
    return ConfiguredServo(settings.servo, found, provision(port, found, settings))


def _remaining_from(todo: Sequence[ServoSettings], start: str | None) -> Sequence[ServoSettings]:
    names = [settings.servo.name for settings in todo]
    if start is None:
        return todo
    if start not in names:
        raise UnknownNameError("joint", start, names)
    return todo[names.index(start) :]


def _found_now(settings: ServoSettings, found: FoundServo) -> FoundServo:
    return FoundServo(settings.servo.id, settings.baud_rate, found.protocol, found.table)
