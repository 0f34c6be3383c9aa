"""The port: its names, refusals and time-outs."""

from __future__ import annotations

import os
import socket
import sys
from types import SimpleNamespace

import pytest
import serial

from ikservo.clock import RealClock
from ikservo.errors import InputError, NoPortError, PortBusyError, PortError, PortLostError
from ikservo.hardware import Port, open_port, serial_ports, transport


class TestOpening:
    """Messages if a port cannot be opened."""

    def test_missing_device_error_lists_existing_ports(self, monkeypatch):
        monkeypatch.setattr(serial_ports, "list_devices", lambda: ["/dev/ttyACM7"])
        with pytest.raises(NoPortError, match=r"Ports found: /dev/ttyACM7\. .*port=\"sim\""):
            open_port("/dev/ttyNOTHERE", 1_000_000)

    def test_empty_port_name_error_offers_simulator(self):
        with pytest.raises(NoPortError, match='port="sim"'):
            open_port("", 1_000_000)

    def test_regular_file_as_port_is_refused(self, tmp_path):
        file = tmp_path / "notes.txt"
        file.touch()
        with pytest.raises(PortError, match="Cannot open"):
            open_port(str(file), 1_000_000)

    @pytest.mark.skipif(sys.platform == "win32", reason="these are names of Unix")
    @pytest.mark.parametrize("name", ["/", "/dev/null", "/dev/zero", __file__])
    def test_device_that_is_not_serial_gives_one_clear_error(self, name):
        with pytest.raises(NoPortError, match=r": not a serial port\.\nPorts found: "):
            open_port(name, 1_000_000)

    @pytest.mark.parametrize(
        "name", ["socket://", "socket://host", "socket://h:99999", "rfc2217://"]
    )
    def test_incomplete_port_url_error_shows_example(self, name):
        with pytest.raises(NoPortError, match=r"written as socket://192\.168\.1\.5:4000"):
            open_port(name, 1_000_000)

    @pytest.mark.parametrize(
        ("name", "why"),
        [
            ("loop://?x=1", "unknown option: 'x'"),
            ("loop://?logging=loud", "an option of this address"),
            ("socket://127.0.0.1:1?logging=loud", "an option of this address"),
            ("alt:///dev/null?class=os", "an option of this address"),
            ("hwgrep://(", "unterminated"),
        ],
    )
    def test_open_port_reports_url_that_pyserial_refuses(self, name, why):
        with pytest.raises(NoPortError, match=why):
            open_port(name, 1_000_000)

    @pytest.mark.skipif(sys.platform == "win32", reason="these are errors of Unix")
    def test_open_port_reports_name_that_the_system_refuses(self, tmp_path):
        link = tmp_path / "arm"
        link.symlink_to(link)
        refused = {
            str(link): "too many levels of symbolic links",
            "/dev/\0": "null byte",
            "/dev/" + 5000 * "a": "file name too long",
        }
        for name, why in refused.items():
            with pytest.raises(NoPortError, match=why):
                open_port(name, 1_000_000)
        assert serial_ports.find_adapter(str(link)) is None
        with pytest.raises(NoPortError, match=refused[str(link)]):
            open_port(str(link), 1_000_000, arm="pan", servo_ids=[1])

    @pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
    def test_spy_port_logs_sent_bytes(self, pty_name, capsys):
        with open_port(f"spy://{pty_name}", 1_000_000) as port:
            port.writePort(b"\xff\xff\x01")
        assert "TX   0000  FF FF 01" in capsys.readouterr().err

    @pytest.mark.parametrize("rate", [2**31, 2**64])
    def test_baud_rate_too_large_is_refused(self, pty_name, rate):
        with pytest.raises(PortError, match=f"does not support {rate} baud"):
            open_port(pty_name, rate)

    def test_permission_error_names_group_to_join(self, monkeypatch):
        self._fail_with(monkeypatch, serial.SerialException(13, "Permission denied"))
        with pytest.raises(PortError, match="usermod -aG"):
            open_port("/dev/null", 1_000_000)

    def test_windows_access_denied_reports_missing_permission(self, monkeypatch):
        words = "could not open port 'COM3': PermissionError(13, 'Access is denied.')"
        self._fail_with(monkeypatch, serial.SerialException(words))
        with pytest.raises(PortError, match="No permission"):
            open_port("COM3", 1_000_000)

    def test_port_locked_by_pyserial_is_busy(self, pty_name):
        with serial.Serial(pty_name, exclusive=True), pytest.raises(PortBusyError):
            open_port(pty_name, 1_000_000)

    def test_open_port_reports_refused_socket_connection(self):
        with socket.socket() as closed_socket:
            closed_socket.bind(("127.0.0.1", 0))  # bound and not listening
            url = f"socket://127.0.0.1:{closed_socket.getsockname()[1]}"
            with pytest.raises(NoPortError, match="Cannot open"):
                open_port(url, 1_000_000)

    def test_socket_url_is_opened_as_port(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            url = f"socket://127.0.0.1:{server.getsockname()[1]}"
            with open_port(url, 1_000_000) as port, server.accept()[0] as far_end:
                far_end.sendall(b"hello")
                assert port.read_until(5, port.clock.now_s() + 10) == b"hello"

    def test_port_plugin_opens_urls_of_its_scheme(self, line, monkeypatch):
        class EntryPoint:
            def load(self):
                return lambda url: line if url == "echo:loud" else pytest.fail(url)

        def entry_points(*, group, name):
            return [EntryPoint()] if (group, name) == ("ikservo.ports", "echo") else []

        monkeypatch.setattr(transport, "entry_points", entry_points)
        with open_port("echo:loud", 57_600) as port:
            assert port.clock is line.clock
        assert line.baudrate == 57_600

    @pytest.mark.parametrize(
        ("error", "expected"), [(ValueError("of 5"), InputError), (OSError("busy"), NoPortError)]
    )
    def test_port_plugin_error_is_reported_with_url(self, monkeypatch, error, expected):
        def opener(_):
            raise error

        plug_in = SimpleNamespace(load=lambda: opener)
        monkeypatch.setattr(transport, "entry_points", lambda **_: [plug_in])
        transport._find_plug_ins.cache_clear()
        with pytest.raises(expected, match="fails:5"):
            open_port("fails:5", 57_600)

    @staticmethod
    def _fail_with(monkeypatch, error):
        def failing(*_, **__):
            raise error

        monkeypatch.setattr(serial, "serial_for_url", failing)


class TestLosing:
    """Errors after the adapter is gone."""

    @pytest.fixture
    def orphan(self):
        pty = pytest.importorskip("pty", reason="pseudo-terminals are a Unix thing")
        master, slave = pty.openpty()
        port = open_port(os.ttyname(slave), 1_000_000)
        os.close(slave)
        os.close(master)
        yield port
        port.close()

    def test_read_after_unplug_raises_port_lost_error(self, orphan):
        with pytest.raises(PortLostError, match="Lost connection"):
            orphan.read_until(1, orphan.clock.now_s() + 10)

    def test_write_after_unplug_raises_port_lost_error(self, orphan):
        with pytest.raises(PortLostError, match="Lost connection"):
            orphan.writePort(b"hello")

    def test_clear_after_unplug_raises_port_lost_error(self, orphan):
        with pytest.raises(PortLostError, match="Lost connection"):
            orphan.clearPort()

    def test_closing_lost_port_raises_no_error(self, orphan):
        orphan.close()
        assert not orphan.is_open


class TestTime:
    """Waits are as long as the request needs, on the port's own clock."""

    def test_hardware_port_uses_real_clock(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            assert isinstance(port.clock, RealClock)

    def test_reply_time_includes_transmission_and_return_delay(self, line):
        port = Port(line, "scripted", 57_600)
        line.expect("00 00 00 00 00 00 00 00 00 00")
        port.writePort(bytes(10))
        needed_s = port.expected_at_s(90, delays_s=0.003) - line.clock.now_s()
        assert needed_s == pytest.approx(100 * 10 / 57_600 + 0.003)

    def test_port_read_returns_as_soon_as_all_bytes_are_there(self, port, line):
        line.add_stale("01 02", at_s=0.001)
        port.read_until(2, 1.0)
        assert line.clock.now_s() == 0.001

    def test_port_read_past_deadline_returns_available_bytes(self, port, line):
        line.add_stale("01 02")
        assert port.read_until(5, -1.0) == b"\x01\x02"

    def test_port_time_out_is_set_only_when_it_changes(self, port, line):
        times = []
        type(line).timeout = property(
            lambda self: times and times[-1], lambda self, s: times.append(s)
        )
        try:
            for _ in range(3):
                port.read_until(1, line.clock.now_s() + 0.0028)
        finally:
            del type(line).timeout
        assert times == [0.0028]

    def test_sdk_packet_time_out_grows_with_packet_length(self, port, line):
        port.setPacketTimeout(100)
        line.clock.sleep_until(0.0019)
        assert not port.isPacketTimeout()
        line.clock.sleep_until(0.0021)
        assert port.isPacketTimeout()

    def test_expected_reply_time_starts_at_last_written_byte(self, line):
        port = Port(line, "scripted", 57_600)
        line.expect("00 " * 100).expect("00 " * 8)
        port.writePort(bytes(100))
        port.writePort(bytes(8))
        left_s = 108 * 10 / 57_600
        assert port.expected_at_s(0, 0.0) == pytest.approx(left_s)


class TestTimeout:
    """The time-out shrinks to a multiple of the slowest recent reply."""

    def test_reply_time_out_starts_at_40_ms(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            assert port.reply_timeout.timeout_s == 0.040

    def test_reply_time_out_shrinks_to_2_ms_with_quick_replies(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            for _ in range(16):
                port.reply_timeout.on_reply(0.0001)
            assert port.reply_timeout.timeout_s == 0.002

    def test_reply_time_out_stays_after_two_time_outs(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            for _ in range(16):
                port.reply_timeout.on_reply(0.0001)
            for _ in range(2):
                port.reply_timeout.on_timeout()
            assert port.reply_timeout.timeout_s == 0.002

    def test_reply_time_out_grows_to_16_ms_after_five_time_outs(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            for _ in range(16):
                port.reply_timeout.on_reply(0.0001)
            for _ in range(5):
                port.reply_timeout.on_timeout()
            assert port.reply_timeout.timeout_s == 0.016

    def test_reply_time_out_grows_at_once_if_many_are_silent(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            for _ in range(16):
                port.reply_timeout.on_reply(0.0001)
            port.reply_timeout.on_timeout(many=True)
            assert port.reply_timeout.timeout_s == 0.008

    def test_reply_time_out_grows_to_12_ms_after_slow_reply(self, pty_name):
        with open_port(pty_name, 1_000_000) as port:
            for overhead_s in [0.001] * 16 + [0.008]:
                port.reply_timeout.on_reply(overhead_s)
            assert port.reply_timeout.timeout_s == 0.012


def test_built_in_serial_ports_are_not_listed(monkeypatch):
    ports = [SimpleNamespace(device=f"/dev/{name}") for name in ("ttyS0", "ttyUSB0", "ttyAMA0")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    assert serial_ports.list_devices() == ["/dev/ttyAMA0", "/dev/ttyUSB0"]
