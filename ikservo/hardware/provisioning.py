"""Give one servo its id and baud rate; wait until it is plugged in or unplugged."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product

from ikservo.errors import (
    BadValueError,
    BusError,
    CalibrationError,
    ServoRejectedError,
    ServoSilentError,
)
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import update_eeprom
from ikservo.hardware.ping_sweep import FRAMINGS, Framing, framing_of
from ikservo.hardware.port import Port
from ikservo.hardware.read_plan import RegisterRef
from ikservo.hardware.scan import FoundServo, candidate_baud_rates, identify, scan_rate
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import ControlTable, Register, RegisterName

__all__ = ["ServoSettings", "check_model", "provision", "wait_for_servo", "wait_until_unplugged"]


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """What a servo shall be.

    Attributes:
        servo: Its id, table and joint.
        baud_rate: At which it shall answer.
        eeprom: Raw numbers that it must hold besides, by register name.
    """

    servo: ServoSpec
    baud_rate: int
    eeprom: Mapping[str, int]

    @property
    def baud_code(self) -> int:
        """Return what stands in the baud rate register for this rate.

        Raises:
            BadValueError: The model cannot talk at this rate.
        """
        rates = self.servo.table.baud_rates
        codes = {rate: code for code, rate in rates.items()}
        if self.baud_rate not in codes:
            known = ", ".join(map(str, sorted(codes)))
            raise BadValueError(f"The baud rate of {self.servo}", self.baud_rate, f"one of {known}")
        return codes[self.baud_rate]


def provision(port: Port, found: FoundServo, wish: ServoSettings) -> tuple[str, ...]:
    """Make the only servo on a line what it shall be; return what was written, in words.

    Nothing is written that holds already. Its EEPROM is locked again, also after a failure.

    Args:
        port: The line; afterwards at the servo's new rate.
        found: Who answers, and where.
        wish: What it shall be.

    Raises:
        CalibrationError: It is of another model; nothing was written.
        BadValueError: It cannot talk at the wanted rate, or lacks a register; nothing was written.
        ServoRefusedError: It did not keep a number.
        BusError: It does not answer.
    """
    check_model(found, wish)
    wanted = _expected_registers(wish)
    code = wish.baud_code
    with _ServoBeingProvisioned(port, found, wish) as servo:
        servo.set_id_and_rate(wish.servo.id, code)
        servo.write_registers(wanted)
    return tuple(servo.written)


def check_model(found: FoundServo, wish: ServoSettings) -> None:
    """Compare the servo on the line with the model that the arm file names.

    Raises:
        CalibrationError: It is of another model, perhaps of another family.
    """
    if found.table is not wish.servo.table:
        raise CalibrationError(
            f"{wish.servo} must be a {wish.servo.table.model_name}, but a {found} is connected.",
            "Connect the right servo, or choose another arm. Nothing was written.",
        )


def _expected_registers(wish: ServoSettings) -> dict[RegisterRef, int]:
    """Return the registers that are not id and baud rate, and what must stand in them.

    Raises:
        BadValueError: The model has no register of some name.
    """
    table = wish.servo.table
    missing = [name for name in wish.eeprom if name not in table.registers]
    if missing:
        known = ", ".join(table.registers)
        raise BadValueError(f"A register of {wish.servo}", repr(missing[0]), f"one of {known}")
    delay: dict[RegisterRef, int] = (
        {} if RegisterName.RETURN_DELAY in table.missing else {table.return_delay: 0}
    )
    return delay | {table.registers[name]: number for name, number in wish.eeprom.items()}


class _ServoBeingProvisioned:
    """The servo under treatment: wherever it answers, it is spoken to there."""

    def __init__(self, port: Port, found: FoundServo, wish: ServoSettings) -> None:
        self._port, self._wish = port, wish
        self._table: type[ControlTable] = wish.servo.table
        self._id, self._rate = found.id, found.baud_rate
        self.written: list[str] = []

    def __enter__(self) -> _ServoBeingProvisioned:
        self._port.setBaudRate(self._rate)
        self._make_bus.write(self._id, RegisterName.TORQUE_ENABLE, 0, raw=True)
        return self

    def __exit__(self, kind: object, error: object, at: object) -> None:
        """Lock the memory, whatever happened; a failure on the way is the one to tell."""
        lock = self._table.eeprom_lock
        if lock is None:
            return
        with contextlib.suppress(BusError) if error else contextlib.nullcontext():
            self._make_bus.write(self._id, lock, 1, raw=True)
            self._verify_register(lock, 1)

    @property
    def _make_bus(self) -> ServoBus:
        return ServoBus(self._port, [ServoSpec(self._id, self._table, self._wish.servo.name)])

    def set_id_and_rate(self, servo_id: int, baud_code: int) -> None:
        """Give it its id, then its rate; it answers with the one or the other, old or new."""
        if self._id != servo_id:
            self._unlock_eeprom()
            self._write_unconfirmed(self._table.id, servo_id)
            self._id = servo_id
            self._verify_register(self._table.id, servo_id)
        if self._rate != self._wish.baud_rate:
            self._unlock_eeprom()
            self._write_unconfirmed(self._table.baud_rate, baud_code)
            self._rate = self._wish.baud_rate
            self._port.setBaudRate(self._rate)
        self._verify_register(self._table.baud_rate, baud_code)

    def write_registers(self, wanted: Mapping[RegisterRef, int]) -> None:
        """Write what differs of everything else, and verify it."""
        for change in update_eeprom(self._make_bus, self._id, wanted):
            self.written.append(f"{change.register} {change.found} → {change.wanted}")

    def _unlock_eeprom(self) -> None:
        lock = self._table.eeprom_lock
        if lock is not None:
            self._make_bus.write(self._id, lock, 0, raw=True)

    def _write_unconfirmed(self, register: Register, number: int) -> None:
        """Write once, without minding the answer: whether it was taken is asked afterwards."""
        spec = ServoSpec(self._id, self._table, self._wish.servo.name)
        before = self._make_bus.read(self._id, register, raw=True)
        with contextlib.suppress(BusError):
            ServoBus(self._port, [spec], retries=0).write(self._id, register, number, raw=True)
        self.written.append(f"{register} {before} → {number}")

    def _verify_register(self, register: Register, number: int) -> None:
        found = self._make_bus.read(self._id, register, raw=True)
        if found != number:
            raise ServoRejectedError(
                f"holds {register} = {found} after {number} was written",
                "Its EEPROM may be worn out or locked.",
                servo=str(self._wish.servo),
                servo_id=self._id,
                port=self._port.name,
            )


_FACTORY_RATES = (1_000_000, 57_600)  # Feetech's and ROBOTIS'
_LOW_IDS = range(21)  # what servos are delivered with and most arms use: quick to try everywhere
_PERIOD_STEPS = 4  # looks, of which one tries every rate at low ids and one every rate at every id
_PAUSE_S = 0.1

OnStatus = Callable[[Sequence[FoundServo]], None]
TellRate = Callable[[int], None]
Place = tuple[int, Framing]
"""A baud rate and the framing of packets at it."""


def wait_for_servo(
    port: Port,
    table: type[ControlTable],
    rate: int,
    wait_s: float,
    tell: OnStatus,
    tell_rate: TellRate | None = None,
) -> FoundServo:
    """Return the one servo that answers, once the same has answered twice in a row.

    It may have any known baud rate and be of any family. While several answer, which two servos
    at one id do as well, it goes on waiting.

    Args:
        port: The line.
        table: What is expected; its protocol is tried most often.
        rate: At which it may answer already, besides those of a new servo.
        wait_s: How long to wait.
        tell: Told who answers each time that changes.
        tell_rate: Told each baud rate before it is tried.

    Raises:
        ServoSilentError: No servo came, or several stayed.
        PortLostError: The line is gone.
    """
    before: list[FoundServo] = []
    last: list[FoundServo] = []
    give_up_s = port.clock.now_s() + wait_s
    for look in count():
        found = _scan_places(port, _search_places(table, rate, before, look), tell_rate)
        if _places_of(found) != _places_of(before):
            tell(found)
        if len(found) == 1 and not found[0].shares_id and _places_of(found) == _places_of(before):
            return found[0]
        before, last = found, found or last
        if port.clock.now_s() > give_up_s:
            raise _timeout_error(port, last, wait_s)
        _pause_scan(port)
    raise AssertionError  # count() has no end


def wait_until_unplugged(port: Port, found: FoundServo, wait_s: float) -> None:
    """Return once a servo does not answer any more; others may.

    Raises:
        ServoSilentError: It was not pulled out in time.
        PortLostError: The line is gone.
    """
    give_up_s = port.clock.now_s() + wait_s
    assert found.table is not None  # noqa: S101  # a servo of no known model is never set up
    framing = framing_of(found.table.family)
    port.setBaudRate(found.baud_rate)
    while identify(port, framing, found.id):
        if port.clock.now_s() > give_up_s:
            still = f"still has a servo with id {found.id} after {wait_s:.0f} s"
            raise ServoSilentError(still, "Unplug the servo that is done.", port=port.name)
        _pause_scan(port)


def _scan_places(
    port: Port, places: Iterable[Place], tell_rate: TellRate | None
) -> list[FoundServo]:
    found: list[FoundServo] = []
    for rate, framing in places:
        if tell_rate:
            tell_rate(rate)
        found += scan_rate(port, rate, [framing])
    return found


def _search_places(
    table: type[ControlTable], rate: int, before: Sequence[FoundServo], look: int
) -> list[Place]:
    """Return where to look this time: always where somebody answered the last time.

    That one is confirmed at once, without the long search through all rates.
    """
    own = framing_of(table.family)
    places = [(found.baud_rate, _framing_named(found.protocol)) for found in before]
    known = set(table.baud_rates.values())
    places += [(r, own) for r in (rate, *_FACTORY_RATES) if r in known or r == rate]
    if not before and look % _PERIOD_STEPS == 1:
        places += product(
            candidate_baud_rates(), [replace(framing, ids=_LOW_IDS) for framing in FRAMINGS]
        )
    if not before and look % _PERIOD_STEPS == _PERIOD_STEPS - 1:
        places += product(candidate_baud_rates(), [own])
        places += product(candidate_baud_rates(), FRAMINGS)
    return list(dict.fromkeys(places))


def _framing_named(name: str) -> Framing:
    return next(framing for framing in FRAMINGS if framing.name == name)


def _places_of(found: Sequence[FoundServo]) -> list[tuple[int, int, bool]]:
    return [(servo.id, servo.baud_rate, servo.shares_id) for servo in found]


def _timeout_error(port: Port, last: Sequence[FoundServo], wait_s: float) -> ServoSilentError:
    """Return the error that says who answered last, if anybody did."""
    if not last:
        rates = len(candidate_baud_rates())
        found = f"brings no servo within {wait_s:.0f} s (all ids, {rates} baud rates)"
        return ServoSilentError(found, "Check its plug and its power supply.", port=port.name)
    if len(last) == 1 and not last[0].shares_id:
        found = f"brings answers of {last[0]}, but not steadily, for {wait_s:.0f} s"
        return ServoSilentError(found, "Check its plug and its power supply.", port=port.name)
    what = "several servos at one id" if len(last) == 1 else f"{len(last)} servos"
    hint = "Leave only one plugged in: the others would be changed with it."
    return ServoSilentError(
        f"brings {what} instead of one, for {wait_s:.0f} s", hint, port=port.name
    )


def _pause_scan(port: Port) -> None:
    port.clock.sleep_until(port.clock.now_s() + _PAUSE_S)
