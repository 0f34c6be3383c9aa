"""Third-party software exchanges packets with the servos over the pseudo-terminal."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import dynamixel_sdk
import pytest
import scservo_sdk

SERVE = "import sys, servosim; sys.exit(servosim.serve(sys.argv[1:]))"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Start servers of arms; each returns (process, link to its port)."""
    configs = Path(__file__).parents[2] / "configs"
    running = []

    def start(name, *options):
        link = tmp_path_factory.mktemp("port") / name
        arm = str(configs / name / "arm.toml")
        command = [sys.executable, "-c", SERVE, arm, "--link", str(link), *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stdout.readline().startswith("/dev/")
        return process, link

    yield start
    for process in running:
        process.terminate()
        process.wait(10)
        process.stdout.close()


@pytest.fixture(scope="module")
def feetech(server):
    port = scservo_sdk.PortHandler(str(server("so101", "--pose", "home")[1]))
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    yield port, scservo_sdk.PacketHandler(0)
    port.closePort()


@pytest.fixture(scope="module")
def dynamixel(server):
    port = dynamixel_sdk.PortHandler(str(server("koch", "--pose", "home")[1]))
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    yield port, dynamixel_sdk.PacketHandler(2.0)
    port.closePort()


TIMEOUT_S = 10.0  # the SDKs give up after 34 ms and less; a busy machine is away for longer


def first_reply(ask, *request):
    """Repeat a request until the answer comes: the machine may be busy."""
    end_s, tries = time.monotonic() + TIMEOUT_S, 0
    while tries < 5 or time.monotonic() < end_s:
        answer = ask(*request)
        if succeeded(answer):
            return answer
        tries += 1
        time.sleep(0.01 * tries)  # what is late comes now; the SDKs would take it for the next
        (request[0] if request else ask.__self__.port).ser.reset_input_buffer()
    return "no answer"


def succeeded(answer):
    """Return whether an SDK's answer means success: (..., result, error), or a result alone."""
    return (answer[-2] if isinstance(answer, tuple) else answer) == 0


def settle(read, goal, within, timeout_s=5.0):
    """Read until the position is at the goal; return every position on the path."""
    way, end_s = [read()], time.monotonic() + timeout_s
    while abs(way[-1] - goal) > within and time.monotonic() < end_s:
        way.append(read())
    return way


class TestFeetechSdk:
    def test_scservo_sdk_pings_all_servos(self, feetech):
        port, packets = feetech
        assert [first_reply(packets.ping, port, k) for k in range(1, 7)] == [(777, 0, 0)] * 6

    def test_scservo_sdk_reads_one_and_two_bytes(self, feetech):
        port, packets = feetech
        answers = (
            first_reply(packets.read1ByteTxRx, port, 1, 5),
            first_reply(packets.read2ByteTxRx, port, 1, 3),
        )
        assert answers == ((1, 0, 0), (777, 0, 0))

    def test_scservo_sdk_writes_and_reads_back(self, feetech):
        port, packets = feetech
        wrote = (
            first_reply(packets.write1ByteTxRx, port, 1, 41, 30),
            first_reply(packets.write2ByteTxRx, port, 1, 46, 900),
        )
        read = (
            first_reply(packets.read1ByteTxRx, port, 1, 41),
            first_reply(packets.read2ByteTxRx, port, 1, 46),
        )
        assert (wrote, read) == (((0, 0), (0, 0)), ((30, 0, 0), (900, 0, 0)))

    def test_scservo_sdk_sync_reads_all_positions(self, feetech):
        port, packets = feetech
        group = scservo_sdk.GroupSyncRead(port, packets, 56, 2)
        for k in range(1, 7):
            group.addParam(k)
        assert first_reply(group.txRxPacket) == 0
        assert group.getData(1, 56, 2) == pytest.approx(2048, abs=3)

    def test_scservo_sdk_follows_motion_to_its_end(self, feetech):
        port, packets = feetech
        for id_ in (1, 5):
            first_reply(packets.write1ByteTxRx, port, id_, 41, 50)
            first_reply(packets.write2ByteTxRx, port, id_, 46, 1000)
            first_reply(packets.write2ByteTxRx, port, id_, 42, 2048)
            first_reply(packets.write1ByteTxRx, port, id_, 40, 1)
        group = scservo_sdk.GroupSyncWrite(port, packets, 42, 2)
        group.addParam(1, (2348).to_bytes(2, "little"))
        group.addParam(5, (1748).to_bytes(2, "little"))
        group.txPacket()
        way = settle(lambda: first_reply(packets.read2ByteTxRx, port, 1, 56)[0], 2348, 4)
        assert way == sorted(way)
        assert way[-1] == pytest.approx(2348, abs=4)
        assert (
            settle(lambda: first_reply(packets.read2ByteTxRx, port, 5, 56)[0], 1748, 4)[-1] < 1760
        )

    def test_scservo_sdk_does_not_get_reply_at_other_baud_rate(self, feetech):
        port, packets = feetech
        assert port.setBaudRate(115_200)
        answer = packets.ping(port, 1)
        port.setBaudRate(1_000_000)
        assert answer[1] == scservo_sdk.COMM_RX_TIMEOUT

    def test_scservo_sdk_changes_servo_id(self, feetech):
        port, packets = feetech
        first_reply(packets.write1ByteTxRx, port, 6, 55, 0)
        first_reply(packets.write1ByteTxRx, port, 6, 5, 66)
        answers = (
            first_reply(packets.ping, port, 66),
            first_reply(packets.write1ByteTxRx, port, 66, 5, 6),
        )
        assert answers == ((777, 0, 0), (0, 0))


def everybody(found, result):
    """Return ids and result of a broadcast ping, which ends with the servos that answer in time."""
    return sorted(found), result if len(found) == 6 else -1, 0


class TestDynamixelSdk:
    def test_dynamixel_sdk_finds_all_servos_by_broadcast_ping(self, dynamixel):
        port, packets = dynamixel
        found, *_ = first_reply(lambda port: everybody(*packets.broadcastPing(port)), port)
        assert found == [1, 2, 3, 4, 5, 6]

    def test_dynamixel_sdk_pings_one_servo(self, dynamixel):
        port, packets = dynamixel
        assert first_reply(packets.ping, port, 1) == (1060, 0, 0)

    def test_dynamixel_sdk_reads_one_two_and_four_bytes(self, dynamixel):
        port, packets = dynamixel
        answers = (
            first_reply(packets.read1ByteTxRx, port, 1, 7),
            first_reply(packets.read2ByteTxRx, port, 1, 0),
            first_reply(packets.read4ByteTxRx, port, 1, 48),
        )
        assert answers == ((1, 0, 0), (1060, 0, 0), (4095, 0, 0))

    def test_dynamixel_sdk_receives_range_error(self, dynamixel):
        port, packets = dynamixel
        assert first_reply(packets.write4ByteTxRx, port, 1, 116, 5000) == (0, 4)

    @pytest.mark.parametrize("fast", [False, True])
    def test_dynamixel_sdk_sync_reads_all_positions(self, dynamixel, fast):
        port, packets = dynamixel
        group = dynamixel_sdk.GroupSyncRead(port, packets, 132, 4)
        for k in range(1, 7):
            group.addParam(k)
        assert first_reply(group.fastSyncRead if fast else group.txRxPacket) == 0
        assert group.getData(1, 132, 4) == pytest.approx(2048, abs=10)

    @pytest.mark.parametrize("fast", [False, True])
    def test_dynamixel_sdk_bulk_reads_different_registers(self, dynamixel, fast):
        port, packets = dynamixel
        group = dynamixel_sdk.GroupBulkRead(port, packets)
        group.addParam(1, 7, 1)
        group.addParam(3, 0, 2)
        assert first_reply(group.fastBulkRead if fast else group.txRxPacket) == 0
        assert (group.getData(1, 7, 1), group.getData(3, 0, 2)) == (1, 1200)

    def test_dynamixel_sdk_bulk_writes_different_registers(self, dynamixel):
        port, packets = dynamixel
        group = dynamixel_sdk.GroupBulkWrite(port, packets)
        group.addParam(5, 65, 1, [1])
        group.addParam(6, 112, 4, [77, 0, 0, 0])
        assert group.txPacket() == 0
        read = (
            first_reply(packets.read1ByteTxRx, port, 5, 65),
            first_reply(packets.read4ByteTxRx, port, 6, 112),
        )
        assert read == ((1, 0, 0), (77, 0, 0))

    def test_dynamixel_sdk_follows_motion_to_its_end(self, dynamixel):
        port, packets = dynamixel
        first_reply(packets.write4ByteTxRx, port, 5, 112, 60)
        first_reply(packets.write4ByteTxRx, port, 5, 108, 10)
        first_reply(packets.write1ByteTxRx, port, 5, 64, 1)
        first_reply(packets.write4ByteTxRx, port, 5, 116, 2348)
        way = settle(lambda: first_reply(packets.read4ByteTxRx, port, 5, 132)[0], 2348, 6)
        assert way == sorted(way)
        assert way[-1] == pytest.approx(2348, abs=6)

    def test_dynamixel_sdk_reboots_servo(self, dynamixel):
        port, packets = dynamixel
        first_reply(packets.write1ByteTxRx, port, 4, 65, 1)
        assert first_reply(packets.reboot, port, 4) == (0, 0)
        first_reply(packets.ping, port, 4)
        assert first_reply(packets.read1ByteTxRx, port, 4, 65) == (0, 0, 0)

    def test_dynamixel_sdk_does_not_get_reply_at_other_baud_rate(self, dynamixel):
        port, packets = dynamixel
        port.setBaudRate(57_600)
        answer = packets.ping(port, 1)
        port.setBaudRate(1_000_000)
        assert answer[1] == dynamixel_sdk.COMM_RX_TIMEOUT

    @pytest.mark.full
    def test_dynamixel_sdk_changes_id_and_baud_rate(self, dynamixel):
        port, packets = dynamixel
        first_reply(packets.write1ByteTxRx, port, 6, 7, 60)
        first_reply(packets.write1ByteTxRx, port, 60, 8, 2)
        port.setBaudRate(115_200)
        answer = first_reply(packets.ping, port, 60)
        first_reply(packets.write1ByteTxRx, port, 60, 8, 3)
        port.setBaudRate(1_000_000)
        first_reply(packets.write1ByteTxRx, port, 60, 7, 6)
        assert (answer, first_reply(packets.ping, port, 6)) == ((1200, 0, 0), (1200, 0, 0))


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_simulator_server_cleanly(server, number):
    process, link = server("so101")
    process.send_signal(number)
    assert (process.wait(10), link.is_symlink()) == (0, False)


@pytest.mark.full
def test_closed_sim_server_looks_like_unplugged_cable(server):
    process, link = server("so101")
    port = scservo_sdk.PortHandler(str(link))
    port.openPort()
    process.terminate()
    process.wait(10)
    with pytest.raises(OSError, match="readiness"):
        port.ser.read(1) or port.ser.read(1)
    port.ser.close()
