"""Time one peer that reads six positions and writes six goals on a port; ``bus.py`` runs this.

``python line_peers.py PEER PORT BAUD FAMILY CYCLES`` prints one JSON object: the duration of each
cycle and the processor time of all of them. Only the standard library and the peer are imported.
"""

# The peers have no type hints, and each is imported only where it is measured.
# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false
# ruff: noqa: PLC0415

from __future__ import annotations

import atexit
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

IDS = [1, 2, 3, 4, 5, 6]
WARM_UP = 40
Cycle = Callable[[], bool]


def ikservo(port: str, baud: int, family: str) -> Cycle:
    """Use our own bus."""
    from ikservo.hardware import ServoBus, ServoSpec, open_port, torque_on
    from ikservo.registers import RegisterName, control_table

    table = control_table("STS3215" if family == "feetech_sts" else "XL330-M288")
    bus = ServoBus(open_port(port, baud), [ServoSpec(i, table) for i in IDS])
    bus.load_return_delays()
    goals = {servo_id: torque_on(bus, servo_id) for servo_id in IDS}

    def cycle() -> bool:
        readings = bus.sync_read(IDS, RegisterName.PRESENT_POSITION, raw=True)
        bus.sync_write(RegisterName.GOAL_POSITION, goals, raw=True)
        return not readings.errors

    return cycle


def ikservo_recorded(port: str, baud: int, family: str) -> Cycle:
    """Use our own bus, while every packet is recorded in a file."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    os.environ["IKSERVO_PACKETS"] = str(folder / "packets.pcapng")
    return ikservo(port, baud, family)


def rustypot(port: str, baud: int, family: str) -> Cycle:
    """Use the Rust library with Python bindings."""
    import rustypot

    feetech = family == "feetech_sts"
    make = rustypot.Sts3215PyController if feetech else rustypot.Xl330PyController
    bus = make(serial_port=port, baudrate=baud, timeout=0.05)
    goals = list(bus.sync_read_raw_present_position(IDS))

    def cycle() -> bool:
        found = bus.sync_read_raw_present_position(IDS)
        bus.sync_write_raw_goal_position(IDS, goals)
        return len(found) == len(IDS)

    return cycle


def scservo_sdk(port: str, baud: int, family: str) -> Cycle:
    """Use Feetech's own SDK, unmodified."""
    import scservo_sdk as sdk

    handler, packets = sdk.PortHandler(port), sdk.PacketHandler(0)
    handler.openPort()
    handler.setBaudRate(baud)
    read = sdk.GroupSyncRead(handler, packets, 56, 2)
    write = sdk.GroupSyncWrite(handler, packets, 42, 2)
    return _stock_cycle(read, write, 56, 2, read.txRxPacket)


def dynamixel_sdk(port: str, baud: int, family: str) -> Cycle:
    """Use ROBOTIS' own SDK, unmodified."""
    read, write = _dynamixel(port, baud)
    return _stock_cycle(read, write, 132, 4, read.txRxPacket)


def dynamixel_sdk_fast(port: str, baud: int, family: str) -> Cycle:
    """Use ROBOTIS' own SDK with fast sync read."""
    read, write = _dynamixel(port, baud)
    return _stock_cycle(read, write, 132, 4, read.fastSyncRead)


def _dynamixel(port: str, baud: int):  # noqa: ANN202
    import dynamixel_sdk as sdk

    handler, packets = sdk.PortHandler(port), sdk.PacketHandler(2.0)
    handler.openPort()
    handler.setBaudRate(baud)
    return sdk.GroupSyncRead(handler, packets, 132, 4), sdk.GroupSyncWrite(handler, packets, 116, 4)


def _stock_cycle(read, write, address: int, size: int, ask: Callable[[], int]) -> Cycle:  # noqa: ANN001
    for servo_id in IDS:
        read.addParam(servo_id)
    ask()
    for servo_id in IDS:
        tick = read.getData(servo_id, address, size)
        write.addParam(servo_id, list(tick.to_bytes(size, "little")))

    def cycle() -> bool:
        result = ask()
        for servo_id in IDS:
            read.getData(servo_id, address, size)
        write.txPacket()
        return result == 0

    return cycle


PEERS = (ikservo, ikservo_recorded, rustypot, scservo_sdk, dynamixel_sdk, dynamixel_sdk_fast)


def main() -> None:
    """Measure one peer."""
    name, port, baud, family, cycles = sys.argv[1:]
    (make,) = [peer for peer in PEERS if peer.__name__ == name]
    cycle = make(port, int(baud), family)
    for _ in range(WARM_UP):
        cycle()
    took_s, failed = [], 0
    busy_s = time.process_time()
    for _ in range(int(cycles)):
        started_s = time.perf_counter()
        failed += not cycle()
        took_s.append(time.perf_counter() - started_s)
    busy_s = time.process_time() - busy_s
    print(json.dumps({"took_s": took_s, "busy_s": busy_s / int(cycles), "failed": failed}))


if __name__ == "__main__":
    main()
