"""Our port in place of the vendors' port handlers provides everything that they call."""

from __future__ import annotations

import dynamixel_sdk
import pytest
import scservo_sdk
from dynamixel_sdk.robotis_def import COMM_RX_TIMEOUT, COMM_SUCCESS

from ikservo.hardware import Port

CALLED = """clearPort closePort getBaudRate getBytesAvailable getPortName isPacketTimeout openPort
readPort setBaudRate setPacketTimeout setPacketTimeoutMillis setPortName writePort"""


@pytest.mark.parametrize("handler", [scservo_sdk.PortHandler, dynamixel_sdk.PortHandler, Port])
def test_port_has_every_method_that_packet_handlers_call(handler):
    assert [name for name in CALLED.split() if not callable(getattr(handler, name, None))] == []


def test_feetech_sdk_reads_through_port(port, line):
    line.expect("FF FF 01 04 02 38 02 BE", "FF FF 01 04 00 00 08 F2")
    handler = scservo_sdk.PacketHandler(0)
    assert handler.read2ByteTxRx(port, 1, 56) == (2048, COMM_SUCCESS, 0)


def test_dynamixel_sdk_reads_through_port(port, line):
    line.expect(
        "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
    )
    handler = dynamixel_sdk.PacketHandler(2.0)
    assert handler.read4ByteTxRx(port, 1, 132) == (166, COMM_SUCCESS, 0)


def test_dynamixel_sdk_through_port_times_out_under_5_ms(port, line):
    line.expect("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
    result = dynamixel_sdk.PacketHandler(2.0).read4ByteTxRx(port, 1, 132)[1]
    assert result == COMM_RX_TIMEOUT
    assert line.clock.now_s() < 0.005


def test_dynamixel_sdk_broadcast_ping_works_through_port(port, line):
    line.expect("FF FF FD 00 FE 03 00 01 31 42", "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
    found, result = dynamixel_sdk.PacketHandler(2.0).broadcastPing(port)
    assert (found, result) == ({1: [1030, 38]}, COMM_SUCCESS)
