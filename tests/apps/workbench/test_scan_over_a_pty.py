"""A scan in real time over a pseudo-terminal, as over a serial port."""

import sys
import time

import pytest

from ikservo.hardware.scan import scan_port
from tests.cli.test_over_a_pty import served

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")


@pytest.fixture(scope="module")
def port():
    with served("so101") as (port, _):
        yield port


@pytest.mark.full
def test_scan_of_253_silent_ids_does_not_wait_for_each_one(port):
    started_s = time.monotonic()
    assert scan_port(port, [500_000]) == []
    assert time.monotonic() - started_s < 10.0  # one after the other takes longer on any machine


@pytest.mark.campaign
def test_scan_finds_every_servo(run_cli, port):
    done = run_cli(f"scan {port}")
    assert done.code == 0, done.err
    assert [line.split()[:2] for line in done.out.splitlines()[1:]] == [
        [str(i), "STS3215"] for i in range(1, 7)
    ]
