"""Recorded packets: every byte is decoded in words; damaged files and full disks."""

import contextlib
import errno
import os
import socket
import warnings

import pytest

from ikservo.apps.workbench import packet_decoding
from ikservo.apps.workbench.packet_decoding import decode_packets
from ikservo.errors import FileFormatError
from ikservo.files.writing import FileWriteError
from ikservo.hardware import Port, ServoBus, ServoSpec, torque_on
from ikservo.hardware.packet_log import LoggedBytes, read_packet_log, recorded_transport
from ikservo.hardware.port import open_port
from ikservo.registers import RegisterName, control_table
from servosim.faults import Fault
from tests.hardware.factories import BAUD, make_transport

MODELS = ("STS3215", "SCS0009", "XL430-W250", "AX-12A", "MX-28")


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_PACKETS", str(tmp_path / "log.pcapng"))
    return tmp_path / "log.pcapng"


def recorded_bus(model, *faults):
    transport = make_transport(dict.fromkeys((1, 7), model))
    for fault in faults:
        transport.line.faults.add(fault)
    port = Port(
        recorded_transport(transport, os.environ["IKSERVO_PACKETS"], "bench"), "bench", BAUD
    )
    return ServoBus(port, [ServoSpec(i, control_table(model)) for i in (1, 7)]), transport


def decoded(path, model):
    return list(decode_packets(read_packet_log(path), dict.fromkeys((1, 7), control_table(model))))


@pytest.mark.parametrize("model", MODELS)
def test_packet_log_decodes_instructions_and_replies(path, model):
    bus, _ = recorded_bus(model)
    table = control_table(model)
    position = bus.read(7, RegisterName.PRESENT_POSITION, raw=True)
    bus.write(7, table.max_temperature_limit, 60, raw=True)
    ticks = bus.sync_read([1, 7], RegisterName.PRESENT_POSITION, raw=True).require_all()
    goal = torque_on(bus, 7)
    bus.sync_write(RegisterName.GOAL_POSITION, {7: goal}, raw=True)
    bus.close()
    texts = [packet.meaning for packet in decoded(path, model)]
    said = " | ".join(texts)
    assert f"{table.present_position.name} = {position}" in said
    assert f"write {table.max_temperature_limit.name} = 60" in said
    assert f"{table.present_position.name} = {ticks[1]}" in said
    assert f"7: {table.goal_position.name} = {goal}" in said


@pytest.mark.parametrize("model", MODELS)
def test_packet_log_contains_every_byte(path, model):
    bus, transport = recorded_bus(model)
    sent, received = bytearray(), bytearray()
    write, read = transport.write, transport.read
    transport.write = lambda data: sent.extend(data) or write(data)
    transport.read = lambda size=1: (data := read(size), received.extend(data))[0]
    for _ in range(500):
        bus.sync_read_many([1, 7], (RegisterName.PRESENT_POSITION, RegisterName.PRESENT_LOAD))
    bus.close()
    packets = decoded(path, model)
    assert b"".join(p.data for p in packets if p.sent) == sent
    assert b"".join(p.data for p in packets if not p.sent) == received
    assert not [p.error for p in packets if p.error]
    times_s = [p.time_s for p in packets]
    assert times_s == sorted(times_s)


@pytest.mark.parametrize("kind", ["checksum", "truncated", "garbage"])
def test_packet_log_marks_communication_errors(path, kind):
    bus, _ = recorded_bus("STS3215", Fault(kind, id=7))
    bus.sync_read([1, 7], RegisterName.PRESENT_POSITION)
    bus.close()
    packets = decoded(path, "STS3215")
    assert [p for p in packets if p.error == "no packet"]
    assert [p for p in packets if not p.sent and p.servo_id == 1 and not p.error]


def test_packets_are_logged_only_if_ikservo_packets_is_set(monkeypatch):
    def record(*_):
        raise AssertionError("the packets are recorded")

    monkeypatch.delenv("IKSERVO_PACKETS", raising=False)
    monkeypatch.setattr("ikservo.hardware.packet_log.recorded_transport", record)
    monkeypatch.setattr(
        "ikservo.hardware.port.open_transport", lambda *_: make_transport({1: "STS3215"})
    )
    open_port("bench", BAUD).close()


def test_packet_log_contains_several_openings_of_port(path):
    for _ in range(3):
        bus, _ = recorded_bus("STS3215")
        bus.ping(7)
        bus.close()
    assert {each.opening for each in read_packet_log(path)} == {1, 2, 3}


def test_full_disk_ends_packet_log_but_not_communication(path, monkeypatch):
    bus, _ = recorded_bus("STS3215")
    bus.ping(7)

    def full(_file, _data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert bus.ping(7).id == bus.ping(1).id + 6
    assert [str(each.message) for each in said if "no longer recorded" in str(each.message)]
    monkeypatch.undo()
    assert len(list(read_packet_log(path))) >= 2


def test_unwritable_packet_log_gives_one_clear_error(tmp_path):
    path = str(tmp_path / "none" / "log.pcapng")
    with pytest.raises(FileWriteError, match="cannot be written"):
        recorded_transport(make_transport({1: "STS3215"}), path, "bench")


def test_refused_packet_log_does_not_leave_port_open(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_PACKETS", str(tmp_path))
    transport = make_transport({1: "STS3215"})
    closed = []
    monkeypatch.setattr(transport, "close", lambda: closed.append(True))
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda *_: transport)
    with pytest.raises(FileFormatError):
        open_port("bench", BAUD)
    assert closed == [True]


def test_packet_log_refuses_folder_pipe_socket_and_device(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(tmp_path)  # the path of a socket has at most 107 bytes
        server.bind("socket")
        for name in (tmp_path, tmp_path / "fifo", "socket", os.devnull):
            with pytest.raises(FileFormatError, match=r"is a folder|is not a regular file"):
                recorded_transport(make_transport({1: "STS3215"}), str(name), "bench")


def test_truncated_or_damaged_packet_log_is_read_without_hang(path):
    bus, _ = recorded_bus("STS3215")
    bus.ping(7)
    bus.close()
    whole = path.read_bytes()
    complete = list(read_packet_log(path))
    for end in range(1, len(whole)):
        path.write_bytes(whole[:end])
        try:
            found = list(read_packet_log(path))
        except FileFormatError:
            continue
        assert found == complete[: len(found)]
    for at in range(0, len(whole), 3):
        damaged = bytearray(whole)
        damaged[at] ^= 0xFF
        path.write_bytes(damaged)
        with contextlib.suppress(FileFormatError):
            decoded(path, "STS3215")


@pytest.mark.parametrize("length_hex", ["F403", "F00F"])
@pytest.mark.parametrize("chunk_bytes", [10, 1000])
def test_packet_decoding_time_is_linear_in_damaged_bytes(length_hex, chunk_bytes, monkeypatch):
    checked_bytes = 0
    crc = packet_decoding.crc

    def counting_crc(start, packet, count):
        nonlocal checked_bytes
        checked_bytes += count
        return crc(start, packet, count)

    monkeypatch.setattr(packet_decoding, "crc", counting_crc)
    false_header = bytes.fromhex(f"FFFFFD0001{length_hex}550000")
    data = false_header * 2000
    chunks = [
        LoggedBytes(0.0, False, data[at : at + chunk_bytes], 1)
        for at in range(0, len(data), chunk_bytes)
    ]
    assert b"".join(packet.data for packet in decode_packets(chunks, {})) == data
    assert checked_bytes <= 210 * len(data)  # two checks of 1 KiB for each header of 10 bytes
