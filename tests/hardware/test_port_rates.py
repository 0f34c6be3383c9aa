"""Every listed baud rate, on a real terminal device of the system."""

from __future__ import annotations

import sys

import pytest

from ikservo.errors import PortError
from ikservo.hardware import open_port
from ikservo.hardware.scan import scan_rate
from ikservo.registers import MODELS

RATES = sorted({rate for table in MODELS.values() for rate in table.baud_rates.values()})
SPECIAL = [76_800, 250_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000]

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals take any rate")


def test_non_standard_baud_rates_are_listed():
    assert set(SPECIAL) <= set(RATES)


@linux_only
@pytest.mark.parametrize("rate", RATES)
def test_port_opens_at_every_listed_baud_rate(pty_name, rate):
    with open_port(pty_name, rate) as port:
        assert port.getBaudRate() == rate
        assert port.wire_s(1) == pytest.approx(10 / rate)


@linux_only
@pytest.mark.parametrize("rate", RATES)
def test_open_port_changes_to_every_listed_baud_rate(pty_name, rate):
    with open_port(pty_name, 57_600) as port:
        assert port.setBaudRate(rate)
        assert port.transport.baudrate == rate


def test_baud_rate_refused_by_adapter_keeps_old_one(port, line):
    def refuse(self, rate):
        if rate == 4_500_000:
            raise ValueError("invalid rate")

    type(line).baudrate = property(lambda self: 1_000_000, refuse)
    try:
        with pytest.raises(PortError, match="cannot be set to 4500000 baud"):
            port.setBaudRate(4_500_000)
    finally:
        del type(line).baudrate
    assert port.getBaudRate() == 1_000_000


def test_scan_skips_baud_rate_that_adapter_refuses(port, line):
    def refuse(self, rate):
        if rate == 4_500_000:
            raise ValueError("invalid rate")

    type(line).baudrate = property(lambda self: 1_000_000, refuse)
    try:
        assert scan_rate(port, 4_500_000) == []
    finally:
        del type(line).baudrate
