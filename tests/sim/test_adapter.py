"""The host's adapter: echo, USB frames, latency timer, noise."""

from __future__ import annotations

import pytest

from servosim.adapter import AdapterOptions

PING = bytes.fromhex("FFFF010201FB")
PONG = bytes.fromhex("FFFF010200FC")


def test_simulated_adapter_sends_echo_before_reply(make_port):
    port = make_port("STS3215", adapter=AdapterOptions(echo=True))
    port.write(PING)
    assert port.read(12) == PING + PONG


def test_simulated_reply_waits_for_next_usb_frame(make_port):
    port = make_port("STS3215", adapter=AdapterOptions(usb_frame_s=0.001))
    port.clock.sleep_until(0.0103)
    port.write(PING)
    port.read(6)
    assert port.clock.now_s() == pytest.approx(0.012)


def test_simulated_short_reply_waits_for_latency_timer(make_port):
    port = make_port("STS3215", adapter=AdapterOptions(latency_s=0.016))
    port.write(PING)
    port.read(6)
    assert port.clock.now_s() == pytest.approx(0.016, abs=2e-4)


def test_simulated_full_usb_packet_is_sent_without_latency(make_port):
    port = make_port("STS3215", adapter=AdapterOptions(latency_s=0.016))
    port.write(bytes.fromhex("FFFF 01 04 02 00 50 A8".replace(" ", "")))
    assert len(port.read(62)) == 62
    assert port.clock.now_s() < 0.001


def test_simulated_noise_damages_some_replies_but_not_all(make_port):
    port = make_port("STS3215", noise=0.02)
    received = []
    for _ in range(60):
        port.write(PING)
        received.append(port.read(6) == PONG)
    assert 10 < sum(received) < 60
