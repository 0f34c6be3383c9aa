"""``ikservo scan`` finds every servo on the bus, and detects two servos with one id."""

import pytest

from servosim.faults import Fault
from tests.cli.fixtures_ports import change_bus

SCAN = "scan --port sim"


def test_scan_finds_every_servo_with_its_health(run_cli):
    result = run_cli(f"{SCAN} --arm so101")
    assert result.code == 0
    assert [line.split() for line in result.out.splitlines()[1:]] == [
        [str(i), "STS3215", "1000000", "3.10", "7.4", "25", "Feetech", "and", "Dynamixel", "1.0"]
        for i in range(1, 7)
    ]


def test_scan_json_lists_each_servo_with_units(run_cli):
    answer = run_cli(f"{SCAN} --arm koch --json").json
    assert answer["schema"] == "ikservo/scan/1"
    assert answer["servos"][2] == {
        "id": 3, "model": "XL330-M288", "model_number": 1200, "baud_rate": 1_000_000,
        "protocol": "Dynamixel 2.0", "firmware": "52", "voltage_v": 5.0, "temperature_c": 25.0,
        "alarms": [], "shares_id": False,
    }  # fmt: skip


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_scan_reports_two_servos_sharing_an_id(run_cli, monkeypatch, arm):
    change_bus(monkeypatch, lambda line: line.servos[3].memory.put("id", 2))
    result = run_cli(f"{SCAN} --arm {arm} --json")
    assert result.code == 1
    assert [s["id"] for s in result.json["servos"] if s["shares_id"]] == [2]
    assert [s["id"] for s in result.json["servos"] if not s["shares_id"]] == [1, 4, 5, 6]
    assert result.err.splitlines()[0] == "Several servos answer at id 2."


@pytest.mark.parametrize(
    ("arm", "register"), [("so101", "return_delay"), ("koch", "return_delay_time")]
)
def test_scan_reports_shared_id_despite_different_delays(run_cli, monkeypatch, arm, register):
    def change(line):
        line.servos[2].memory.put(register, 0)
        line.servos[3].memory.put(register, 250)
        line.servos[3].memory.put("id", 2)

    change_bus(monkeypatch, change)
    servos = run_cli(f"{SCAN} --arm {arm} --json").json["servos"]
    assert [s["id"] for s in servos if s["shares_id"]] == [2]


def test_scan_reports_six_new_servos_sharing_id_1(run_cli, monkeypatch):
    def change(line):
        for servo in line.world.servos:
            servo.memory.put("id", 1)

    change_bus(monkeypatch, change)
    servos = run_cli(f"{SCAN} --arm so101 --json").json["servos"]
    assert [(s["id"], s["shares_id"]) for s in servos] == [(1, True)]


def test_scan_finds_servo_at_another_baud_rate(run_cli, monkeypatch):
    def change(line):
        for servo in line.world.servos:
            servo.memory.put("baud_rate", 2)  # 115,200

    change_bus(monkeypatch, change)
    servos = run_cli(f"{SCAN} --arm koch --json").json["servos"]
    assert {s["baud_rate"] for s in servos} == {115_200}


def strangers(line):
    line.servos[6].memory.put("baud_rate", 1)  # 57,600, as it comes from the box


def test_scan_ends_at_first_baud_rate_with_servos(run_cli, monkeypatch):
    change_bus(monkeypatch, strangers)
    assert [s["id"] for s in run_cli(f"{SCAN} --arm koch --json").json["servos"]] == [1, 2, 3, 4, 5]


def test_scan_all_continues_to_last_baud_rate(run_cli, monkeypatch):
    change_bus(monkeypatch, strangers)
    servos = run_cli(f"{SCAN} --arm koch --all --json").json["servos"]
    assert [(s["id"], s["baud_rate"]) for s in servos][-1] == (6, 57_600)
    assert len(servos) == 6


def test_scan_with_repeated_baud_rate_lists_each_servo_once(run_cli):
    servos = run_cli(f"{SCAN} --arm so101 --baud 1000000 --baud 1000000 --json").json["servos"]
    assert [s["id"] for s in servos] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("rate", ["99999999999999999999", "1", "٣"])
def test_scan_refuses_impossible_baud_rate(run_cli, rate):
    result = run_cli(f"{SCAN} --arm so101 --baud {rate}")
    assert result.code == 2
    assert "--baud" in result.err


@pytest.mark.full
@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_scan_finds_models_behind_adapter_with_16_ms_latency(run_cli, arm):
    slow = run_cli(f"scan sim:?latency_ms=16&usb_frame_ms=1 --arm {arm} --json").json["servos"]
    assert slow == run_cli(f"{SCAN} --arm {arm} --json").json["servos"]


@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_scan_finds_servo_whose_first_reply_is_lost(run_cli, monkeypatch, arm):
    change_bus(monkeypatch, lambda line: line.faults.add(Fault("silent", id=4, count=1)))
    servos = run_cli(f"{SCAN} --arm {arm} --json").json["servos"]
    assert [s["id"] for s in servos] == [1, 2, 3, 4, 5, 6]


def test_scan_tries_only_requested_baud_rate(run_cli):
    result = run_cli(f"{SCAN} --arm koch --baud 57600")
    assert result.code == 4
    assert "(all ids, 57600 baud)." in result.err
    assert result.out == ""


@pytest.mark.sample(1)
@pytest.mark.parametrize("echo", ["?echo=1", "?echo=1&usb_frame_ms=1"])
@pytest.mark.parametrize("arm", ["so101", "koch"])
def test_scan_through_echoing_adapter_finds_only_real_servos(run_cli, arm, echo):
    servos = run_cli(f"scan sim:{echo} --arm {arm} --json").json["servos"]
    assert [(s["id"], s["shares_id"]) for s in servos] == [(i, False) for i in range(1, 7)]


def test_scan_with_noise_finds_only_real_servos(run_cli):
    servos = run_cli("scan sim:?noise=0.002&seed=5 --arm so101 --json").json["servos"]
    assert [s["id"] for s in servos] == [1, 2, 3, 4, 5, 6]


def test_scan_reports_alarm_of_servo(run_cli, monkeypatch):
    change_bus(monkeypatch, lambda line: line.servos[4].inject_alarm(0x20))
    servos = run_cli(f"{SCAN} --arm so101 --json").json["servos"]
    assert servos[3]["alarms"] == ["overload"]


def test_scan_shows_unknown_model_by_number(run_cli, monkeypatch):
    change_bus(monkeypatch, lambda line: line.servos[4].memory.put("model_number", 4242))
    row = run_cli(f"{SCAN} --arm so101 --json").json["servos"][3]
    assert (row["id"], row["model"], row["model_number"]) == (4, None, 4242)


@pytest.mark.parametrize("protocol", ["so101", "koch"])
def test_scan_of_253_silent_ids_takes_less_than_2_s_of_bus_time(run_cli, monkeypatch, protocol):
    def silence(line):
        for servo in line.world.servos:
            servo.powered = False

    ports = change_bus(monkeypatch, silence)
    result = run_cli(f"{SCAN} --arm {protocol} --baud 1000000")
    assert result.code == 4
    assert ports[0].clock.now_s() < 2.0


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("scan --port sim", 2, "No arm given for the simulator."),
        ("scan --port sim --arm so1o1", 2, "Did you mean so101?"),
        ("scan --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
        ("scan --baud 3 --port sim --arm so101", 2, "Invalid value for '--baud'"),
        ("scan a b", 2, "unexpected extra argument"),
    ],
)
def test_bad_scan_command_gives_one_clear_error(run_cli, words, code, message):
    result = run_cli(words)
    assert result.code == code
    assert message in result.err
    assert result.out == ""


def test_scan_without_port_suggests_simulator(run_cli, monkeypatch):
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    result = run_cli("scan")
    assert result.code == 3
    assert "--port sim" in result.err


@pytest.mark.full
@pytest.mark.parametrize(("option", "is_said"), [("", True), ("--all", False)])
def test_scan_says_that_it_skipped_later_baud_rates(run_cli, option, is_said):
    result = run_cli(f"scan --port sim --arm so101 {option}")
    assert ("The search ended at the first rate with servos" in result.err) == is_said
