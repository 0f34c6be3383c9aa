"""Many reads of registers with known contents, on a bus with every kind of fault."""

from __future__ import annotations

import random
from dataclasses import dataclass

import dynamixel_sdk
import scservo_sdk

from ikservo.errors import BusError
from ikservo.registers import RegisterName

from .factories import add_faults, make_bus, simulated_servos

FEETECH = dict.fromkeys(range(1, 7), "STS3215")
DYNAMIXEL = {1: "XL430-W250", 2: "XL430-W250", **dict.fromkeys(range(3, 7), "XL330-M288")}

# 2 % late by 5 to 200 ms, 2 % doubled with the second copy up to 200 ms behind, 2 % damaged, and
# a little of everything else.
LATE = [("late", {"probability": 0.005, "delay_s": s}) for s in (0.005, 0.02, 0.08, 0.2)]
DOUBLED = [("duplicated", {"probability": 0.005, "delay_s": s}) for s in (1e-4, 0.005, 0.05, 0.2)]
DAMAGED = [("flipped", {"probability": 0.01}), ("checksum", {"probability": 0.01})]
OTHERS = [(k, {"probability": 0.002}) for k in ("silent", "short", "garbage", "truncated", "lost")]
SOON_DOUBLED = [("duplicated", {"probability": 0.01, "delay_s": s}) for s in (1e-4, 0.005)]
EVERYTHING = [*LATE, *DOUBLED, *DAMAGED, *OTHERS]

# Values that change by themselves cannot be read twice, so second copies 50 ms and more behind are
# left out.
EVERYTHING_SOON = [*LATE, *SOON_DOUBLED, *DAMAGED, *OTHERS]

_CHANGED_BY_READING = {"goal_position", "torque_enable", "lock"}


@dataclass
class Outcome:
    """Counts of a campaign's reads."""

    reads: int = 0
    wrong: int = 0  # returned as good, but different from the register
    lost: int = 0  # reported as an error
    retried: int = 0

    def __str__(self):
        share = 100 * self.wrong / self.reads
        return (
            f"{self.reads} reads: {self.wrong} wrong as good ({share:.2f} %), "
            f"{self.lost} reported lost ({self.retried} requests repeated)"
        )


def known_registers(bus):
    """Return the constant registers and their values, from the servos' memory."""
    return {
        (servo.id, register): simulated_servos(bus)[servo.id].read(register.name)
        for servo in bus.servos.values()
        for register in servo.table.registers.values()
        if register.steady and register.name not in _CHANGED_BY_READING
    }


def ours(models, reads, seed, faults=EVERYTHING):
    """Read with `ServoBus`: half of the reads from one servo, half from groups."""
    bus = make_bus(models, seed=seed)
    known, chance, outcome = known_registers(bus), random.Random(seed), Outcome()
    add_faults(bus, *faults)
    keys = list(known)
    shared = sorted({r for _, r in keys if all((i, r) in known for i in models)}, key=str)
    while outcome.reads < reads:
        if chance.random() < 0.5 or not shared:
            _one(bus, known, chance.choice(keys), outcome)
        else:
            _group(bus, known, chance.choice(shared), outcome)
    outcome.retried = sum(counts.retried for counts in bus.statistics.values())
    return outcome


def ours_moving(models, reads, seed, faults=EVERYTHING_SOON):
    """Read positions that change at each request: half from one servo, half from groups."""
    bus = make_bus(models, seed=seed)
    requests, chance, outcome = _move_at_each_request(bus), random.Random(seed), Outcome()
    add_faults(bus, *faults)
    while outcome.reads < reads:
        number = next(requests)
        known = {(i, RegisterName.PRESENT_POSITION): _tick(i, number) for i in models}
        if chance.random() < 0.5:
            _one(bus, known, chance.choice(list(known)), outcome)
        else:
            _group(bus, known, RegisterName.PRESENT_POSITION, outcome)
    outcome.retried = sum(counts.retried for counts in bus.statistics.values())
    return outcome


def _move_at_each_request(bus):
    """Yield the number of the next request; every position changes with it."""
    number = 0
    for servo_id, servo in simulated_servos(bus).items():
        servo.live["present_position"] = lambda servo_id=servo_id: _tick(servo_id, number)
    while True:
        number += 1
        yield number


def _tick(servo_id, number):
    return (8 * number + servo_id) % 4000


def _one(bus, known, key, outcome):
    outcome.reads += 1
    try:
        outcome.wrong += bus.read(*key, raw=True) != known[key]
    except BusError:
        outcome.lost += 1


def _group(bus, known, register, outcome):
    readings = bus.sync_read(bus.servos, register, raw=True)
    outcome.reads += len(bus.servos)
    outcome.lost += len(readings.errors)
    outcome.wrong += sum(known[i, register] != found for i, found in readings.values.items())


def stock(models, reads, seed, faults=EVERYTHING):
    """Read with the vendor's SDK: its packets and its port handler."""
    bus = make_bus(models, seed=seed)
    known, chance, outcome = known_registers(bus), random.Random(seed), Outcome()
    add_faults(bus, *faults)
    read = _stock_reader(bus)
    for servo_id, register in chance.choices(list(known), k=reads):
        outcome.reads += 1
        found = read(servo_id, register)
        if found is None:
            outcome.lost += 1
        else:
            outcome.wrong += register.decode(found) != known[servo_id, register]
    return outcome


def _stock_reader(bus):
    feetech = "STS" in next(iter(bus.servos.values())).table.model_name
    sdk = scservo_sdk if feetech else dynamixel_sdk
    handler = sdk.PacketHandler(0 if feetech else 2.0)
    port = _on_line(sdk.PortHandler, bus.port.transport)

    def read(servo_id, register):
        data, result, error = handler.readTxRx(port, servo_id, register.address, register.size)
        return bytes(data) if result == sdk.COMM_SUCCESS and not error and data else None

    return read


def _on_line(port_handler, transport):
    class OnLine(port_handler):
        def setupPort(self, _):  # noqa: N802
            self.ser, self.is_open = transport, True
            self.tx_time_per_byte = 0.01
            transport.timeout = 0
            return True

        def getCurrentTime(self):  # noqa: N802
            return transport.clock.now_s() * 1000

    port = OnLine("campaign")
    port.openPort()
    return port
