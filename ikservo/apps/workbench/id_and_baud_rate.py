"""Give one servo its id and baud rate; wait until it is plugged in or unplugged."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product
from pathlib import Path

from ikservo.errors import (
    BadValueError,
    BusError,
    CalibrationError,
    InputError,
    ServoRejectedError,
    ServoSilentError,
    shown,
)
from ikservo.files.writing import write_atomic
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import backup_path, backup_text, update_eeprom
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, framing_of
from ikservo.hardware.port import Port
from ikservo.hardware.register_batches import RegisterRef
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, identify, scan_rate
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import ControlTable, Register, RegisterName


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """The desired settings of a servo.

    Attributes:
        servo: The servo, with its id, table and joint.
        baud_rate: The desired baud rate.
        eeprom: Raw numbers of further registers, by register name.
    """

    servo: ServoSpec
    baud_rate: int
    eeprom: Mapping[str, int]

    @property
    def baud_code(self) -> int:
        """Code of the rate in the baud rate register.

        Raises:
            BadValueError: The model does not support this rate.
        """
        rates = self.servo.table.baud_rates
        codes = {rate: code for code, rate in rates.items()}
        if self.baud_rate not in codes:
            known = ", ".join(map(str, sorted(codes)))
            raise BadValueError(f"The baud rate of {self.servo}", self.baud_rate, f"one of {known}")
        return codes[self.baud_rate]


def provision(
    port: Port, found: FoundServo, settings: ServoSettings, owner: str = ""
) -> tuple[str, ...]:
    """Configure the only servo on a line; return descriptions of the writes.

    Values that are already right are not written. The EEPROM is always locked at the end. The first
    EEPROM copy is made before any write, under the new id. This copy is in the folder ``owner``;
    if ``owner`` is empty, no copy is made. Afterwards the port has the servo's new rate.

    Raises:
        CalibrationError: The servo is a different model; nothing was written.
        BadValueError: The servo does not support the rate or a register; nothing was written.
        ServoRejectedError: A number was not stored.
        BusError: The servo does not reply.
        FileWriteError: The copy cannot be written; nothing was changed.
    """
    check_model(found, settings)
    table = settings.servo.table
    missing = [name for name in settings.eeprom if name not in table.registers]
    if missing:
        known = ", ".join(table.registers)
        raise BadValueError(f"A register of {settings.servo}", shown(missing[0]), f"one of {known}")
    expected: dict[RegisterRef, int] = {}
    if RegisterName.RETURN_DELAY not in table.missing:
        expected[table.return_delay] = 0
    expected |= {table.registers[name]: number for name, number in settings.eeprom.items()}
    code = settings.baud_code
    with _ServoBeingProvisioned(port, found, settings) as servo:
        if owner and not (copy := backup_path(owner, settings.servo)).exists():
            servo.back_up(copy)
        servo.set_id_and_rate(settings.servo.id, code)
        servo.write_registers(expected)
    return tuple(servo.written)


def change_address(port: Port, servo: ServoSpec, new_id: int, new_rate: int) -> None:
    """Give one servo on a line a new id and baud rate, and verify both.

    The servo replies at the port's rate, and its torque goes off; the port gets the new rate.

    Raises:
        InputError: Another servo has this id; nothing was written.
        BadValueError: The servo does not support the rate; nothing was written.
        ServoRejectedError: A number was not stored.
        BusError: The servo does not reply.
    """
    settings = ServoSettings(replace(servo, id=new_id), new_rate, {})
    code = settings.baud_code
    check_address_is_free(port, servo, new_id, new_rate)
    found = FoundServo(servo.id, port.baudrate, "", servo.table)
    with _ServoBeingProvisioned(port, found, settings) as changing:
        changing.set_id_and_rate(new_id, code)


def check_address_is_free(port: Port, servo: ServoSpec, new_id: int, new_rate: int) -> None:
    """Check that no other servo replies at an id, at the port's rate or at a new rate.

    Raises:
        InputError: Another servo replies; nothing was written.
    """
    present_rate, framing = port.baudrate, framing_of(servo.table.family)
    for rate in dict.fromkeys((present_rate, new_rate)):
        if (new_id, rate) == (servo.id, present_rate):
            continue
        try:
            port.setBaudRate(rate)
            taken = identify(port, framing, new_id)
        finally:
            port.setBaudRate(present_rate)
        if taken:
            raise InputError(
                f"Id {new_id} belongs to another servo on this line, at {rate} baud.",
                "Choose a free id, or unplug that servo. Nothing was written.",
            )


def check_model(found: FoundServo, settings: ServoSettings) -> None:
    """Compare the servo on the line with the model that the arm file names.

    Raises:
        CalibrationError: The servo is a different model, perhaps from another family.
    """
    servo = settings.servo
    if found.table is not servo.table:
        raise CalibrationError(
            f"{servo} must be a {servo.table.model_name}, but a {found} is connected.",
            "Connect the right servo, or choose another arm. Nothing was written.",
        )


class _ServoBeingProvisioned:
    """The servo that is being configured, addressed at its current id and rate."""

    def __init__(self, port: Port, found: FoundServo, settings: ServoSettings) -> None:
        self._port, self._settings = port, settings
        self._table: type[ControlTable] = settings.servo.table
        self._id, self._rate = found.id, found.baud_rate
        self.written: list[str] = []

    def __enter__(self) -> _ServoBeingProvisioned:
        self._port.setBaudRate(self._rate)
        self._bus.write(self._id, RegisterName.TORQUE_ENABLE, 0, raw=True)
        return self

    def __exit__(self, kind: object, error: object, at: object) -> None:
        """Lock the memory in any case; an earlier error takes precedence over a failure to lock."""
        lock = self._table.eeprom_lock
        if lock is None:
            return
        with contextlib.suppress(BusError) if error else contextlib.nullcontext():
            self._bus.write(self._id, lock, 1, raw=True)
            self._verify_register(lock, 1)

    @property
    def _bus(self) -> ServoBus:
        return ServoBus(self._port, [ServoSpec(self._id, self._table, self._settings.servo.name)])

    def back_up(self, path: Path) -> None:
        """Copy the EEPROM to a file."""
        write_atomic(path, backup_text(self._bus, self._id, self._settings.servo.id))

    def set_id_and_rate(self, servo_id: int, baud_code: int) -> None:
        """Set the id, then the rate; the servo may reply at the old or new values."""
        if self._id != servo_id:
            self._unlock_eeprom()
            self._write_unconfirmed(self._table.id, servo_id)
            self._id = servo_id
            self._verify_register(self._table.id, servo_id)
        if self._rate != self._settings.baud_rate:
            self._unlock_eeprom()
            self._write_unconfirmed(self._table.baud_rate, baud_code)
            self._rate = self._settings.baud_rate
            self.written[-1] += f" ({self._rate} baud)"
            self._port.setBaudRate(self._rate)
        self._verify_register(self._table.baud_rate, baud_code)

    def write_registers(self, expected: Mapping[RegisterRef, int]) -> None:
        """Write all other registers that differ, and verify them."""
        for change in update_eeprom(self._bus, self._id, expected):
            self.written.append(str(change))

    def _unlock_eeprom(self) -> None:
        lock = self._table.eeprom_lock
        if lock is not None:
            self._bus.write(self._id, lock, 0, raw=True)

    def _write_unconfirmed(self, register: Register, number: int) -> None:
        """Write once and ignore the reply; the caller reads the register afterwards."""
        spec = ServoSpec(self._id, self._table, self._settings.servo.name)
        before = self._bus.read(self._id, register, raw=True)
        with contextlib.suppress(BusError):
            ServoBus(self._port, [spec], retries=0).write(self._id, register, number, raw=True)
        self.written.append(f"{register} {before} → {number}")

    def _verify_register(self, register: Register, number: int) -> None:
        found = self._bus.read(self._id, register, raw=True)
        if found != number:
            raise ServoRejectedError(
                f"holds {register} = {found} after {number} was written",
                "Its EEPROM may be worn out or locked.",
                servo=str(self._settings.servo),
                servo_id=self._id,
                port=self._port.name,
            )


_FACTORY_RATES = (1_000_000, 57_600)  # rates of new servos of Feetech and of ROBOTIS
_LOW_IDS = range(21)  # ids of new servos and most arms, quick to try at all rates
_PERIOD_STEPS = 4  # in 4 scans, one tries low ids at all rates and one all ids at all rates
_PAUSE_S = 0.1
Place = tuple[int, Framing]
"""A baud rate, and the framing of packets at that rate."""


def wait_for_servo(
    port: Port,
    table: type[ControlTable],
    rate: int,
    wait_s: float,
) -> Generator[int | Sequence[FoundServo], None, FoundServo]:
    """Return the only servo that replies, as soon as it has replied twice in a row.

    It may have any known baud rate and belong to any family; the protocol of ``table`` is tried
    most often, at ``rate`` and at the rates of a new servo. The wait continues while several
    servos reply, even with the same id. Yields each baud rate before it is tried, and the replying
    servos when they change.

    Raises:
        ServoSilentError: No servo replies, or several do.
        PortLostError: The port is lost.
    """
    before: list[FoundServo] = []
    last: list[FoundServo] = []
    give_up_s = port.clock.now_s() + wait_s
    for attempt in count():
        found: list[FoundServo] = []
        places = _search_places(table, rate, before, attempt)
        for place in places:
            yield place[0]
            # A long search looks again and again where a new servo replies.
            for place_rate, framing in (place, *(_new_servo_places(table) if places[9:] else ())):
                seen = scan_rate(port, place_rate, [framing])  # some places are searched twice
                found += [each for each in seen if _places_of([each])[0] not in _places_of(found)]
            if not before and any(servo.baud_rate in _FACTORY_RATES for servo in found):
                break
        if _places_of(found) != _places_of(before):
            yield found
        if len(found) == 1 and not found[0].shares_id and _places_of(found) == _places_of(before):
            return found[0]
        before, last = found, found or last
        if port.clock.now_s() > give_up_s:
            raise _timeout_error(port, last, wait_s)
        _pause_scan(port)
    raise AssertionError  # count() never ends


def wait_until_unplugged(port: Port, found: FoundServo, wait_s: float) -> Generator[None]:
    """Wait until a servo no longer replies; others may reply. Yields after each attempt.

    Raises:
        ServoSilentError: The servo was not unplugged in time.
        PortLostError: The port is lost.
    """
    give_up_s = port.clock.now_s() + wait_s
    assert found.table is not None  # noqa: S101  # a servo of an unknown model is never set up
    framing = framing_of(found.table.family)
    port.setBaudRate(found.baud_rate)
    while identify(port, framing, found.id):
        if port.clock.now_s() > give_up_s:
            still = f"still has a servo with id {found.id} after {wait_s:.0f} s"
            raise ServoSilentError(still, "Unplug the finished servo.", port=port.name)
        yield
        _pause_scan(port)


def _search_places(
    table: type[ControlTable], rate: int, before: Sequence[FoundServo], attempt: int
) -> list[Place]:
    """Return the rates and framings to scan next, beginning with the rates of the last replies.

    A servo that has replied is thus confirmed at once, without the long search at all rates.
    """
    own = framing_of(table.family)
    places = [
        (found.baud_rate, next(framing for framing in FRAMINGS if framing.name == found.protocol))
        for found in before
    ]
    known = set(table.baud_rates.values())
    places += [(r, own) for r in (rate, *_FACTORY_RATES) if r in known or r == rate]
    if not before and attempt % _PERIOD_STEPS == 1:
        places += product(
            candidate_baud_rates(), [replace(framing, ids=_LOW_IDS) for framing in FRAMINGS]
        )
    if not before and attempt % _PERIOD_STEPS == _PERIOD_STEPS - 1:
        places += product(candidate_baud_rates(), [own])
        places += product(candidate_baud_rates(), FRAMINGS)
    return list(dict.fromkeys(places))


def _new_servo_places(table: type[ControlTable]) -> list[Place]:
    """Return where a new servo replies; this is quick to try."""
    framing = replace(framing_of(table.family), ids=_LOW_IDS)
    return [(rate, framing) for rate in _FACTORY_RATES if rate in table.baud_rates.values()]


def _places_of(found: Sequence[FoundServo]) -> list[tuple[int, int, bool]]:
    return [(servo.id, servo.baud_rate, servo.shares_id) for servo in found]


def _timeout_error(port: Port, last: Sequence[FoundServo], wait_s: float) -> ServoSilentError:
    """Return an error that names the servos that replied last, if any."""
    hint = "Check its plug and its power supply."
    if not last:
        rates = len(candidate_baud_rates())
        found = f"has no servo within {wait_s:.0f} s (all ids, {rates} baud rates)"
    elif len(last) == 1 and not last[0].shares_id:
        found = f"has {last[0]}, which did not answer reliably for {wait_s:.0f} s"
    else:
        what = "several servos that share one id" if len(last) == 1 else f"{len(last)} servos"
        hint = "Leave only one servo plugged in; otherwise the others would be changed, too."
        found = f"had {what} for {wait_s:.0f} s; only one at a time can be set up"
    return ServoSilentError(found, hint, port=port.name)


def _pause_scan(port: Port) -> None:
    port.clock.sleep_until(port.clock.now_s() + _PAUSE_S)
