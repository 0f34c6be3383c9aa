"""A sweep pings 253 ids without waiting for each; late, doubled and damaged replies count."""

from pathlib import Path

import pytest

from ikservo.hardware import open_port
from ikservo.hardware.ping_sweep import FRAMINGS, ping_ids

CONFIGS = Path(__file__).parents[2] / "configs"
ONE, TWO = FRAMINGS


@pytest.fixture
def on_line():
    """Open a simulated line; return the port."""
    ports = []

    def open_line(arm, query=""):
        ports.append(open_port(f"sim:{CONFIGS / arm / 'arm.toml'}{query}", 1_000_000))
        return ports[-1]

    yield open_line
    for port in ports:
        port.close()


@pytest.mark.parametrize(
    ("framing", "servo_id", "ping"),
    [(ONE, 1, "ff ff 01 02 01 fb"), (TWO, 1, "ff ff fd 00 01 03 00 01 19 4e")],
)
def test_ping_bytes_match_manual(framing, servo_id, ping):
    assert framing.make_scanner().ping(servo_id).hex(" ") == ping
    assert framing.ping_bytes == len(bytes.fromhex(ping))


@pytest.mark.parametrize("latency_ms", [0, 4, 16])
@pytest.mark.parametrize(("arm", "framing"), [("so101", ONE), ("koch", TWO)])
def test_ping_sweep_receives_replies_delayed_by_adapter(on_line, arm, framing, latency_ms):
    port = on_line(arm, f"?latency_ms={latency_ms}&usb_frame_ms=1")
    found_ids = ping_ids(port, framing, framing.ids)
    assert sorted(found_ids.frames) == [1, 2, 3, 4, 5, 6]
    assert found_ids.junk == 0


def test_ping_sweep_in_wrong_protocol_finds_no_servo(on_line):
    assert ping_ids(on_line("so101"), TWO, TWO.ids).frames == {}


def test_ping_sweep_recognises_echo_and_does_not_count_it(on_line):
    found_ids = ping_ids(on_line("so101", "?echo=1"), ONE, ONE.ids)
    assert found_ids.echoes
    assert sorted(found_ids.frames) == [1, 2, 3, 4, 5, 6]


def test_ping_sweep_accepts_alarm_reply_that_looks_like_echo(on_line):
    port = on_line("so101")
    port.transport.line.servos[4].inject_alarm(0x01)
    found_ids = ping_ids(port, ONE, ONE.ids)
    assert not found_ids.echoes
    assert sorted(found_ids.frames) == [1, 2, 3, 4, 5, 6]


def test_ping_sweep_marks_duplicate_id_as_suspect(on_line):
    port = on_line("so101")
    port.transport.line.servos[3].memory.put("id", 2)
    found_ids = ping_ids(port, ONE, ONE.ids)
    assert 2 in found_ids.suspects
    assert found_ids.junk


def test_ping_sweep_reports_progress_per_ping(on_line):
    counts = []
    ping_ids(on_line("so101"), ONE, range(10), counts.append)
    assert counts == list(range(1, 11))


def test_one_by_one_sweep_skips_silent_id_after_three_pings(on_line):
    counts = []
    ping_ids(on_line("so101"), ONE, [99] * 8, counts.append, echoes=False, one_by_one=True)
    assert counts == [1, 2, 3]
