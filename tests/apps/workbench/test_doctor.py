"""``ikservo doctor`` reports each problem in a line and changes nothing."""

import re

import pytest

from ikservo.apps.workbench.line_quality import LineQuality
from ikservo.hardware.serial_ports import installed_rules, read_rules
from tests.cli.fixtures_ports import PortInfo, change_bus, run_command, set_ports

SIM = "--arm so101 --port sim"
WELL = """\
✓ port      sim:{path} can be opened; no other program uses it
✓ servos    all 6 answer at 1000000 baud
✓ latency   a read takes 0.16 ms (median), … ms (p99)
✓ loss      0 of 1000 reads lost
✓ models    6 STS3215
✓ supply    7.4 V, inside every servo's limits
✓ heat      25 °C
✓ firmware  STS3215 3.10
✓ alarms    none
✓ delay     servos answer without delay
"""


@pytest.fixture(autouse=True)
def few_reads(monkeypatch):
    """Let the thousand reads happen only once; the other tests need only their result."""
    monkeypatch.setattr("ikservo.apps.workbench.doctor.READS", 60)


@pytest.fixture(scope="module")
def well():
    return run_command(f"doctor {SIM}")


def test_doctor_shows_healthy_arm_with_check_marks_only(well):
    path = well.out.partition("sim:")[2].partition(" ")[0]
    out = re.sub(r"[\d.]+ ms \(p99\)", "… ms (p99)", well.out)
    assert out == WELL.format(path=path)
    assert (well.code, well.err) == (0, "")


def lines_of(result, topic):
    return [line for line in result.out.splitlines() if line[2:].startswith(topic)]


@pytest.mark.parametrize(
    ("change", "topic", "line"),
    [
        (lambda s: s[3].inject_alarm(0x20), "alarms", "✗ alarms    elbow_flex (id 3): overload"),
        (lambda s: s[3].memory.put("model_number", 2825), "models",
         "✗ models    elbow_flex (id 3) is a STS3250, not a STS3215"),
        (lambda s: s[3].memory.put("model_number", 9), "models",
         "✗ models    elbow_flex (id 3) is a servo of unknown model 9, not a STS3215"),
        (lambda s: s[3].memory.put("max_voltage_limit", 60), "supply",
         "✗ supply    elbow_flex (id 3) has a supply voltage of 7.4 V; "
         "the allowed range is 4.0 to 6.0 V"),
        (lambda s: setattr(s[3].motor.heat, "temperature_c", 64.0), "heat",
         "! heat      elbow_flex (id 3) is at 63 °C"),
        (lambda s: setattr(s[3].motor.heat, "temperature_c", 68.0), "heat",
         "✗ heat      elbow_flex (id 3) is at 67 °C"),
        (lambda s: setattr(s[3].motor.heat, "temperature_c", 90.0), "heat",
         "✗ heat      elbow_flex (id 3) is at 89 °C"),
        (lambda s: s[3].memory.put("firmware_minor", 9), "firmware",
         "! firmware  STS3215 servos differ: 3.9: elbow_flex (id 3); 3.10: shoulder_pan (id 1), "
         "shoulder_lift (id 2), wrist_flex (id 4), wrist_roll (id 5), gripper (id 6); "
         "stored settings: the same"),
        (lambda s: [s[3].memory.put(*each) for each in (("firmware_minor", 9), ("i_gain", 4))],
         "firmware",
         "! firmware  STS3215 servos differ: 3.9: elbow_flex (id 3); 3.10: shoulder_pan (id 1), "
         "shoulder_lift (id 2), wrist_flex (id 4), wrist_roll (id 5), gripper (id 6); "
         "stored settings: i_gain 4 / 0"),
        (lambda s: s[3].memory.put("return_delay", 250), "delay",
         "! delay     return delays take 0.5 ms per cycle (elbow_flex (id 3))"),
        (lambda s: s[3].memory.put("lock", 0), "lock",
         "! lock      elbow_flex (id 3) has its EEPROM unlocked"),
        (lambda s: setattr(s[6], "powered", False), "servos",
         "✗ servos    no answer from gripper (id 6)"),
    ],
)  # fmt: skip
def test_doctor_prints_one_line_per_fault(run_cli, monkeypatch, change, topic, line):
    change_bus(monkeypatch, lambda on_line: change(on_line.servos))
    result = run_cli(f"doctor {SIM}")
    assert lines_of(result, topic)[0] == line
    assert result.code == (1 if line.startswith("✗") else 0)


def test_doctor_names_cable_after_last_replying_servo(run_cli, monkeypatch):
    def change(line):
        for number in (4, 5, 6):
            line.servos[number].powered = False

    change_bus(monkeypatch, change)
    assert "Check the cable from elbow_flex to wrist_flex." in run_cli(f"doctor {SIM}").out


def test_doctor_counts_lost_reads(run_cli, monkeypatch):
    from servosim.faults import Fault

    change_bus(monkeypatch, lambda line: line.faults.add(Fault("silent", id=4, at_s=0.11, count=3)))
    (line,) = lines_of(run_cli(f"doctor {SIM}"), "loss")
    assert line == "✗ loss      3 of 60 reads lost (wrist_flex (id 4): 3)"


def test_doctor_reports_adapter_with_high_latency(run_cli, monkeypatch):
    slow = LineQuality(1000, {}, (0.0160,) * 900 + (0.0165,) * 100)
    monkeypatch.setattr("ikservo.apps.workbench.doctor.measure_line_quality", lambda *_: slow)
    result = run_cli(f"doctor {SIM}")
    assert lines_of(result, "latency") == [
        "! latency   a read takes 16.00 ms (median), 16.50 ms (p99)"
    ]
    assert result.code == 0


@pytest.mark.full
def test_doctor_finds_arm_at_another_baud_rate(run_cli, monkeypatch):
    def change(line):
        for servo in line.world.servos:
            servo.memory.put("baud_rate", 4)

    change_bus(monkeypatch, change)
    result = run_cli(f"doctor {SIM}")
    assert result.code == 1
    assert (
        "none of this arm's servos answers; on the bus: STS3215 at id 1, 115200 baud" in result.out
    )


@pytest.mark.full
def test_doctor_suggests_power_supply_if_no_servo_answers(run_cli, monkeypatch):
    def change(line):
        for servo in line.world.servos:
            servo.powered = False

    change_bus(monkeypatch, change)
    result = run_cli(f"doctor {SIM}")
    assert "✗ servos    no servo answers, at 1000000 baud or any other" in result.out
    assert "Check that the servos' power supply is on" in result.out


def test_doctor_compares_eeprom_with_arm_file(run_cli, monkeypatch):
    change_bus(monkeypatch, lambda line: line.servos[13].memory.put("drive_mode", 0))
    result = run_cli("doctor --arm open_manipulator_x --port sim")
    assert result.code == 1
    assert lines_of(result, "eeprom") == [
        "✗ eeprom    joint3 (id 13): drive_mode is 0, 4 in the arm file"
    ]


def test_doctor_writes_nothing(run_cli, monkeypatch):
    def change(line):
        for servo in line.world.servos:
            servo.memory.put("return_delay_time", 100)
            servo.memory.put("drive_mode", 1)

    ports = change_bus(monkeypatch, change)
    before = []
    change_bus(
        monkeypatch, lambda line: before.extend(bytes(s.memory.image) for s in line.world.servos)
    )
    run_cli("doctor --arm open_manipulator_x --port sim")
    after = [bytes(servo.memory.image) for servo in ports[0].line.world.servos]
    writable = [row for row in ports[0].line.servos[11].table.registers if row.writable]
    for old, new in zip(before, after, strict=True):
        assert [old[r.address : r.end] for r in writable] == [
            new[r.address : r.end] for r in writable
        ]


def test_doctor_write_eeprom_writes_arm_file_values(run_cli, monkeypatch):
    def change(line):
        line.servos[13].memory.put("drive_mode", 0)
        line.servos[12].memory.put("return_delay_time", 100)

    ports = change_bus(monkeypatch, change)
    result = run_cli("doctor --arm open_manipulator_x --port sim --write-eeprom")
    assert "joint3 (id 13): drive_mode 0 → 4" in result.err
    assert ports[0].line.servos[12].read("return_delay_time") == 0


def test_doctor_write_eeprom_keeps_registers_of_calibration(run_cli, monkeypatch):
    def change(line):
        line.servos[12].memory.put("max_position_limit", 3000)
        line.servos[12].memory.put("return_delay_time", 100)

    monkeypatch.setattr(
        "ikservo.apps.workbench.servo_checks.load_calibration", lambda arm, serial: object()
    )
    ports = change_bus(monkeypatch, change)
    result = run_cli("doctor --arm open_manipulator_x --port sim --write-eeprom")
    assert "max_position_limit" not in result.err
    assert ports[0].line.servos[12].read("max_position_limit") == 3000
    assert ports[0].line.servos[12].read("return_delay_time") == 0


def test_doctor_json_is_one_object_with_every_check(run_cli):
    answer = run_cli(f"doctor {SIM} --json").json
    assert (answer["schema"], answer["healthy"]) == ("ikservo/doctor/1", True)
    assert [check["topic"] for check in answer["checks"]][:3] == ["port", "servos", "latency"]
    assert set(answer["checks"][0]) == {"level", "topic", "text", "fix"}


# --- adapter, permission, rules ---


def test_doctor_without_arm_checks_servos_that_reply(run_cli, monkeypatch):
    from tests.oracle import CONFIGS

    result = run_cli(f"doctor --port sim:{CONFIGS / 'koch' / 'arm.toml'}")
    assert result.code == 0
    assert lines_of(result, "servos")[0].startswith("✓ servos    6 answer at 1000000 baud: XL430")
    assert lines_of(result, "models") == ["✓ models    2 XL430-W250, 4 XL330-M288"]


def test_doctor_reports_missing_adapter(run_cli, monkeypatch):
    set_ports(monkeypatch, [])
    result = run_cli("doctor --arm so101")
    assert result.code == 1
    assert (
        result.out.splitlines()[0] == "✗ port      No serial port given and no USB adapter found."
    )


def test_doctor_names_group_if_port_permission_is_missing(run_cli, monkeypatch, tmp_path):
    def forbidden(*_, **__):
        raise PermissionError(13, "Permission denied")

    device = tmp_path / "ttyACM0"
    device.touch()
    set_ports(monkeypatch, [PortInfo(str(device))])
    monkeypatch.setattr("serial.serial_for_url", forbidden)
    result = run_cli("doctor --arm so101")
    assert result.code == 1
    assert "No permission to open" in result.out
    assert "usermod -aG" in result.out
    assert lines_of(result, "adapter")[0].startswith("✓ adapter   CH343 (Feetech, Waveshare) at ")


@pytest.mark.skipif(installed_rules() is not None, reason="the rule is installed here")
def test_doctor_names_command_for_missing_udev_rule(run_cli, monkeypatch):
    set_ports(monkeypatch, [])
    monkeypatch.setattr("sys.platform", "linux")
    result = run_cli("doctor")
    assert lines_of(result, "udev")[0].startswith("! udev      60-ikservo.rules is not installed")
    assert "ikservo doctor --rules" in result.out
    assert not any(rule in result.out for rule in read_rules().splitlines() if rule)


def test_doctor_accepts_installed_udev_rule(run_cli, monkeypatch, tmp_path):
    (tmp_path / "60-ikservo.rules").touch()
    set_ports(monkeypatch, [])
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("ikservo.hardware.serial_ports._FOLDERS", (tmp_path,))
    assert lines_of(run_cli("doctor"), "udev") == [
        f"✓ udev      {tmp_path}/60-ikservo.rules is installed"
    ]


def test_doctor_rules_prints_only_udev_rule(run_cli):
    assert run_cli("doctor --rules").out == read_rules()


@pytest.mark.parametrize(
    "fragment",
    ['ATTRS{idVendor}=="1a86", ATTRS{idProduct}=="55d3"', 'ATTRS{idVendor}=="0403"',
     'TAG+="uaccess"', 'SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'],
)  # fmt: skip
def test_udev_rule_names_adapters(fragment):
    assert fragment in read_rules()
    assert "666" not in read_rules()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("doctor --port sim", "No arm given for the simulator."),
        ("doctor --arm so1o1 --port sim", "Did you mean so101?"),
        ("doctor --write-eeprom --port sim", "No arm given."),
    ],
)
def test_bad_doctor_command_gives_one_clear_error(run_cli, words, message):
    result = run_cli(words)
    assert result.code == 2
    assert message in result.err
    assert result.out == ""


def test_doctor_reports_wrong_supply_of_all_servos_once(run_cli, tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "voltage"\nvolts = 12.0\nfor_s = 1000.0\n')
    done = run_cli(f"doctor --arm so101 --port sim:?faults={faults}")
    bad = [line for line in done.out.splitlines() if line.startswith("✗")]
    assert bad == [
        "✗ supply    all 6 servos have a supply voltage of 12.0 V; "
        "the allowed range is 4.0 to 8.0 V"
    ]
