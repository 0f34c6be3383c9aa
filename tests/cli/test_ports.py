"""``ikservo ports``: connected adapters, changes, and the choice of a port."""

import json
import os

import pytest

from ikservo.errors import NoPortError
from ikservo.files.reading import config_dir
from ikservo.hardware.port_choice import choose_port, remember_port
from tests.cli.fixtures_ports import PortInfo, set_ports

FEETECH = PortInfo("/dev/ttyACM0")
U2D2 = PortInfo("/dev/ttyUSB0", 0x0403, 0x6014, "FT4THVXD", "USB <-> Serial Converter")
UART = PortInfo("/dev/ttyS0", None, None, None, None)


@pytest.fixture(autouse=True)
def own_home(monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("IKSERVO_PORT", raising=False)


def test_ports_lists_adapter_with_chip_and_serial_number(run_cli, monkeypatch):
    set_ports(monkeypatch, [U2D2, FEETECH, UART])
    lines = run_cli("ports").out.splitlines()
    assert lines[0].split() == ["port", "chip", "usb", "serial", "number", "used", "by", "by", "id"]
    assert "/dev/ttyACM0  CH343 (Feetech, Waveshare)  1a86:55d3  58FA083        -" in lines[1]
    assert "/dev/ttyUSB0  FT232H (U2D2)               0403:6014  FT4THVXD       -" in lines[2]
    assert len(lines) == 3


def test_ports_json_has_chip_and_serial_number(run_cli, monkeypatch):
    set_ports(monkeypatch, [FEETECH])
    assert run_cli("ports --json").json == {
        "schema": "ikservo/ports/1",
        "ports": [
            {"device": "/dev/ttyACM0", "by_id": "", "chip": "CH343 (Feetech, Waveshare)",
             "usb": "1a86:55d3", "serial_number": "58FA083", "holder": ""}
        ],
    }  # fmt: skip


def test_ports_command_shows_by_id_name(run_cli, monkeypatch, tmp_path):
    device, folder = tmp_path / "ttyACM0", tmp_path / "by-id"
    device.touch()
    folder.mkdir()
    (folder / "usb-1a86_USB_Single_Serial").symlink_to(device)
    monkeypatch.setattr("ikservo.hardware.serial_ports._BY_ID", folder)
    set_ports(monkeypatch, [PortInfo(str(device))])
    assert (
        run_cli("ports --json").json["ports"][0]["by_id"] == f"{folder}/usb-1a86_USB_Single_Serial"
    )


def test_ports_shows_the_process_that_holds_a_port(run_cli, monkeypatch, tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    set_ports(monkeypatch, [PortInfo(str(device))])
    with device.open():
        holder = run_cli("ports --json").json["ports"][0]["holder"]
    assert "(process " in holder


def test_ports_without_adapter_suggests_the_simulator(run_cli, monkeypatch):
    set_ports(monkeypatch, [])
    result = run_cli("ports")
    assert (result.code, result.out) == (0, "")
    assert result.err == "No USB serial adapter found. Without an arm: --port sim\n"


@pytest.mark.parametrize(
    ("vid", "pid", "product", "chip"),
    [
        (0x0403, 0x1234, "Something", "FTDI"),
        (0x2F5D, 0x2202, "OpenRB-150", "ROBOTIS"),
        (0x1234, 0x5678, "Teapot", "Teapot"),
        (0x1234, 0x5678, None, "unknown"),
    ],
)
def test_ports_names_unknown_chip_by_vendor_or_product(
    run_cli, monkeypatch, vid, pid, product, chip
):
    set_ports(monkeypatch, [PortInfo("/dev/ttyACM0", vid, pid, None, product)])
    assert run_cli("ports --json").json["ports"][0]["chip"] == chip


# --- watching ---


@pytest.fixture
def no_waiting(monkeypatch):
    monkeypatch.setattr("ikservo.clock.RealClock.sleep_until", lambda *_: None)


@pytest.mark.usefixtures("no_waiting")
def test_ports_watch_option_names_unplugged_adapter(run_cli, monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2], [FEETECH, U2D2], [FEETECH, U2D2], [FEETECH])
    result = run_cli("ports --watch --events 1")
    assert result.out == "unplugged  /dev/ttyUSB0  FT232H (U2D2)\n"
    assert result.err.startswith("Plugged in now: /dev/ttyACM0, /dev/ttyUSB0.\n")


@pytest.mark.usefixtures("no_waiting")
def test_ports_watch_json_prints_one_object_per_line(run_cli, monkeypatch):
    set_ports(monkeypatch, [FEETECH], [FEETECH], [], [FEETECH])
    events = [
        json.loads(line) for line in run_cli("ports --watch --events 2 --json").out.splitlines()
    ]
    assert [event["event"] for event in events] == ["unplugged", "plugged"]
    assert {event["port"]["device"] for event in events} == {"/dev/ttyACM0"}


@pytest.mark.usefixtures("no_waiting")
def test_ports_watch_ends_on_ctrl_c_with_130(run_cli, monkeypatch):
    def pull_the_plug(*_):
        raise KeyboardInterrupt

    set_ports(monkeypatch, [FEETECH])
    monkeypatch.setattr("ikservo.clock.RealClock.sleep_until", pull_the_plug)
    assert run_cli("ports --watch").code == 130


# --- which port is meant ---


def test_port_option_has_priority_over_other_port_sources(monkeypatch):
    set_ports(monkeypatch, [FEETECH])
    monkeypatch.setenv("IKSERVO_PORT", "/dev/ttyUSB9")
    assert choose_port("/dev/ttyUSB7", "so101") == "/dev/ttyUSB7"


def test_port_variable_has_priority_over_remembered_port(monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2])
    remember_port("so101", "/dev/ttyACM0")
    monkeypatch.setenv("IKSERVO_PORT", "/dev/ttyUSB9")
    assert choose_port(None, "so101") == "/dev/ttyUSB9"


def test_remembered_adapter_is_found_at_another_usb_socket(monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2])
    remember_port("so101", "/dev/ttyACM0")
    set_ports(monkeypatch, [PortInfo("/dev/ttyACM5"), U2D2])
    assert choose_port(None, "so101") == "/dev/ttyACM5"


def test_last_used_port_is_remembered_per_arm(monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2])
    remember_port("so101", "/dev/ttyACM0")
    remember_port("koch", "/dev/ttyUSB0")
    assert [choose_port(None, arm) for arm in ("so101", "koch")] == ["/dev/ttyACM0", "/dev/ttyUSB0"]


def test_only_connected_port_is_chosen_if_none_is_remembered(monkeypatch):
    set_ports(monkeypatch, [U2D2, UART])
    assert choose_port(None, "so101") == "/dev/ttyUSB0"


def test_port_is_not_chosen_between_two_unknown_adapters(monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2])
    with pytest.raises(
        NoPortError, match=r"several adapters.*\n.*ttyACM0, /dev/ttyUSB0.*port=\"sim\""
    ):
        choose_port(None, "so101")


def test_port_without_serial_number_is_not_remembered(monkeypatch):
    set_ports(monkeypatch, [PortInfo("/dev/ttyUSB1", 0x1A86, 0x7523, None)])
    remember_port("so101", "/dev/ttyUSB1")
    assert not (config_dir() / "ports.toml").exists()


@pytest.mark.parametrize(
    "text",
    ["", "format = 2\n[serial_numbers]\nso101 = 'FT4THVXD'\n", "a = [", "\0", "a = " + "[" * 9000],
)
def test_damaged_file_of_remembered_ports_is_replaced(monkeypatch, text):
    set_ports(monkeypatch, [FEETECH, U2D2])
    config_dir().mkdir(parents=True)
    (config_dir() / "ports.toml").write_text(text)
    with pytest.raises(NoPortError):
        choose_port(None, "so101")
    remember_port("so101", "/dev/ttyUSB0")
    assert choose_port(None, "so101") == "/dev/ttyUSB0"


def test_remembered_ports_file_that_is_a_pipe_is_ignored(monkeypatch):
    set_ports(monkeypatch, [FEETECH, U2D2])
    config_dir().mkdir(parents=True)
    os.mkfifo(config_dir() / "ports.toml")
    with pytest.raises(NoPortError):
        choose_port(None, "so101")


def test_port_is_chosen_even_if_it_cannot_be_remembered(monkeypatch, tmp_path):
    set_ports(monkeypatch, [FEETECH])
    (tmp_path / "file").touch()
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "file"))
    remember_port("so101", "/dev/ttyACM0")
    assert choose_port(None, "so101") == "/dev/ttyACM0"
