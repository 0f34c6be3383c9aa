"""``ikservo servo``: registers of servos with and without an arm, on the command line."""

import json
import math

import pytest

from ikservo.apps.workbench.servo_plot import block_curve
from ikservo.errors import ExitCode
from servosim.faults import Fault
from tests.cli.fixtures_ports import change_bus

ELBOW = "--arm so101 --port sim --id elbow_flex"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def ports(monkeypatch):
    return change_bus(monkeypatch, lambda line: None)


def held(ports, servo_id=3):
    return ports[-1].line.servos[servo_id]


def test_servo_table_has_row_for_each_register(run_cli, ports):
    lines = run_cli(f"servo table {ELBOW}").out.splitlines()
    rows = {line.split()[0]: line for line in lines[1:]}
    assert len(rows) == len(held(ports).table.by_name)
    assert "70 °C" in rows["max_temperature_limit"]
    assert "0…254" in rows["p_gain"]


def test_servo_read_prints_raw_numbers_and_quantities(run_cli):
    answer = run_cli(f"servo read present_voltage id {ELBOW} --json").json
    voltage, own_id = answer["registers"]
    assert (answer["schema"], answer["joint"]) == ("ikservo/servo-registers/1", "elbow_flex")
    assert (voltage["raw"], voltage["value"], voltage["unit"]) == (74, pytest.approx(7.4), "V")
    assert (own_id["raw"], own_id["range"], own_id["area"]) == (3, [0, 253], "EEPROM")


def test_servo_write_writes_only_differences_and_locks_eeprom(run_cli, ports):
    result = run_cli(f"servo write p_gain=20 d_gain=32 max_torque=60% {ELBOW} --yes")
    assert result.code == 0
    assert result.out.strip() == "✓ elbow_flex (id 3): p_gain 32 → 20, max_torque 1000 → 600"
    assert [held(ports).read(name) for name in ("p_gain", "max_torque", "lock")] == [20, 600, 1]


def test_servo_write_dry_run_writes_nothing(run_cli, ports):
    result = run_cli(f"servo write p_gain=20 {ELBOW} --dry-run")
    assert result.out.strip() == "would write elbow_flex (id 3): p_gain 32 → 20"
    assert held(ports).read("p_gain") == 32


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (f"servo polish {ELBOW}", ExitCode.USAGE, "polish"),
        (f"servo write p_gain=255 {ELBOW} --yes", ExitCode.FAILED, "255 is outside 0 to 254"),
        (f"servo write present_load=3 {ELBOW} --yes", ExitCode.FAILED, "read-only"),
        (f"servo write p_gain=20 {ELBOW}", ExitCode.USAGE, "--yes"),
        (f"servo write p_gain {ELBOW}", ExitCode.USAGE, "has no value"),
        (f"servo write id=4 {ELBOW} --yes", ExitCode.USAGE, "belongs to another servo"),
        (f"servo write goal_position=2048 {ELBOW} --yes", ExitCode.FAILED, "torque is off"),
        (f"servo read p_gian {ELBOW}", ExitCode.USAGE, "p_gain"),
        (f"servo read {ELBOW}", ExitCode.USAGE, "Missing argument 'REGISTER...'"),
        (f"servo table p_gain {ELBOW}", ExitCode.USAGE, "unexpected extra argument"),
        ("servo table --arm so101 --port sim", ExitCode.USAGE, "Name one by its id"),
        ("servo table --arm so101 --port sim --id 9", ExitCode.USAGE, "9"),
        ("servo table --port sim --id 3", ExitCode.USAGE, "--arm"),
        (f"servo table {ELBOW} --model STS3215", ExitCode.USAGE, "Omit --arm"),
        ("servo restore nothing.toml --arm so101 --port sim", ExitCode.USAGE, "nothing.toml"),
        (f"servo table {ELBOW} --dry-run", ExitCode.USAGE, "No such option: --dry-run"),
        (f"servo reboot {ELBOW} --yes", ExitCode.SILENT, "does not support reboot"),
    ],
)
def test_wrong_servo_command_gives_one_error_and_writes_nothing(run_cli, ports, words, code, said):
    result = run_cli(words)
    assert result.code == code, result.err
    assert said in result.err
    assert result.out == ""
    if ports:
        assert held(ports).read("p_gain") == 32


def test_servo_restore_returns_registers_to_backup(run_cli, monkeypatch):
    assert run_cli(f"servo backup {ELBOW} --to first.toml").code == 0
    assert run_cli(f"servo backup {ELBOW} --to first.toml").code == ExitCode.USAGE

    def spoil(line):
        for name, raw in {"p_gain": 40, "homing_offset": -100}.items():
            line.servos[3].memory.put(name, raw)
            line.servos[3].memory.persist_value(name)

    ports = change_bus(monkeypatch, spoil)
    result = run_cli("servo restore first.toml --arm so101 --port sim --yes")
    assert "homing_offset -100 → 0" in result.out
    restored = held(ports)
    assert [restored.read(n) for n in ("p_gain", "homing_offset", "lock")] == [32, 0, 1]


def test_servo_ping_names_every_servo(run_cli):
    servos = run_cli("servo ping --arm koch --port sim --json").json["servos"]
    assert [servo["model"] for servo in servos] == ["XL430-W250"] * 2 + ["XL330-M288"] * 4


def test_servo_without_arm_is_found_at_any_baud_rate(run_cli, monkeypatch):
    from servosim import open_port

    transport = open_port(f"sim:{_arm_file('koch')}")
    transport.line.servos[3].memory.put("baud_rate", 1)
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda *_, **__: transport)
    result = run_cli("servo read id baud_rate --port /dev/ttyUSB7 --id 3 --json")
    assert [one["raw"] for one in result.json["registers"]] == [3, 1]


def _arm_file(name):
    from ikservo.model import load_model

    return load_model(name).path.resolve()


def test_servo_packets_prints_recorded_packets(run_cli, monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_PACKETS", str(tmp_path / "log.pcapng"))
    assert run_cli("where --arm so101 --port sim").code == 0
    monkeypatch.delenv("IKSERVO_PACKETS")
    result = run_cli("servo packets log.pcapng --arm so101 --id elbow_flex")
    assert result.err.endswith("packets, 0 with an error.\n")
    assert "position = 3118" in result.out
    assert {line.split()[4] for line in result.out.splitlines() if " ms " in line} == {"3", "all"}
    assert run_cli("servo packets log.pcapng --errors").out == ""
    (tmp_path / "log.pcapng").write_bytes(b"text")
    assert run_cli("servo packets log.pcapng").code == ExitCode.USAGE


@pytest.mark.full
def test_servo_tune_compares_gains_and_says_how_to_keep_best(run_cli, ports):
    result = run_cli("servo tune position_p_gain=1500 --arm koch --port sim:?pose=home --id 2")
    assert result.code == 0, result.err
    rows = result.out.splitlines()
    assert len(rows) == 3
    assert "position_p_gain 1500" in rows[2]
    assert "ikservo servo write position_p_gain=1500" in result.err or "present gains" in result.err
    assert held(ports, 2).read("position_p_gain") != 1500


@pytest.mark.campaign
def test_servo_tune_sine_prints_amplitude_and_phase(run_cli, ports):
    words = f"servo tune cw_dead_zone=3 --sine 2 --step 1 {ELBOW}".replace("sim", "sim:?pose=home")
    answer = run_cli(f"{words} --json").json
    assert [point["gains"]["cw_dead_zone"] for point in answer["points"]] == [1, 3]
    assert all(0.5 < point["amplitude_ratio"] < 1.5 for point in answer["points"])
    assert held(ports).read("cw_dead_zone") == 1


@pytest.mark.parametrize(
    "more", ["--sine x", "--sine 1,2,3", "--sine 4,1", "--sine 99", "--sine 2 --suggest"]
)
def test_servo_tune_refuses_invalid_sine(run_cli, ports, more):
    words = f"servo tune {more} {ELBOW}".replace("sim", "sim:?pose=home")
    result = run_cli(words)
    assert (result.code, result.out) == (ExitCode.USAGE, "")
    assert not ports or held(ports).read("p_gain") == 32


@pytest.mark.parametrize("word", ["p_gain", "p_gain=999", "max_torque=500", "goal_position=5"])
def test_servo_tune_accepts_only_gains(run_cli, ports, word):
    result = run_cli(f"servo tune {word} {ELBOW}")
    assert (result.code, result.out) == (ExitCode.USAGE, "")
    assert held(ports).read("torque_enable") == 0, "nothing moves for bad input"


@pytest.mark.parametrize("more", ["", "--sine 2"])
def test_servo_tune_refuses_step_of_zero(run_cli, ports, more):
    result = run_cli(f"servo tune --step 0 {more} {ELBOW}".replace("sim", "sim:?pose=home"))
    assert (result.code, result.out) == (ExitCode.USAGE, "")
    assert "at least" in result.err


def test_servo_tune_without_room_suggests_only_valid_options(run_cli):
    # At rest the links of an SO-101 lie on each other.
    result = run_cli("servo tune --step 20 --arm so101 --port sim --id shoulder_lift")
    assert result.code == ExitCode.REFUSED
    assert "more room" in result.err
    assert "--via" not in result.err


FAST = "--port sim:?paced=0"


def test_servo_plot_prints_csv_to_a_pipe(run_cli):
    result = run_cli(f"servo plot --arm so101 {FAST} --id 3,wrist_roll --duration 1 --period 50ms")
    head, *rows = result.out.splitlines()
    columns = head.split(",")
    assert columns[0] == "time_s"
    assert columns[2] == "elbow_flex.present_position [rad]"
    assert {column.partition(".")[0] for column in columns[1:]} == {"elbow_flex", "wrist_roll"}
    assert len(rows) == 21
    assert [float(row.split(",")[0]) for row in rows][-1] == pytest.approx(1.0, abs=1e-3)
    assert float(rows[-1].split(",")[columns.index("wrist_roll.present_voltage [V]")]) == 7.4


def test_servo_plot_of_joint_prints_its_angle_in_degrees(run_cli, ports):
    words = f"servo plot elbow_flex present_position --arm so101 {FAST} --duration 2"
    head, *rows = run_cli(words).out.splitlines()
    assert head == "time_s,elbow_flex.angle [deg],elbow_flex.present_position [rad]"
    joint = next(each for each in ports[-1].line.world.joints if each.name == "elbow_flex")
    assert float(rows[-1].split(",")[1]) == pytest.approx(math.degrees(joint.position), abs=0.2)


@pytest.mark.parametrize(
    ("name", "key"), [("so101", "angle_deg"), ("open_manipulator_x", "position_mm")]
)
def test_servo_plot_of_joint_states_unit_in_json(run_cli, name, key):
    words = f"servo plot gripper --arm {name} {FAST} --duration 50ms --json"
    (servo,) = json.loads(run_cli(words).out)["servos"]
    assert list(servo["values"]) == [key]


@pytest.mark.parametrize("word", ["elbow", "elbow_felx"])
def test_servo_plot_of_unknown_name_suggests_joint(run_cli, word):
    result = run_cli(f"servo plot {word} --arm so101 {FAST} --duration 50ms")
    assert result.code == ExitCode.USAGE
    assert "Did you mean the joint elbow_flex?" in result.err


def test_servo_given_twice_is_plotted_once(run_cli):
    result = run_cli(
        f"servo plot present_position {FAST} --arm so101 --id 3,elbow_flex --duration 1"
    )
    assert result.out.splitlines()[0] == "time_s,elbow_flex.present_position [rad]"


def test_servo_plot_json_has_line_for_each_sample(run_cli, ports):
    lines = run_cli(
        f"servo plot position_p_gain --arm koch {FAST} --duration 200ms --json"
    ).out.splitlines()
    samples = [json.loads(line) for line in lines]
    assert [len(sample["servos"]) for sample in samples] == [6, 6, 6]
    last = samples[-1]["servos"][1]
    assert last["values"] == {"position_p_gain": held(ports, 2).read("position_p_gain")}


def test_silent_servo_has_empty_cells_in_plot(run_cli, monkeypatch):
    change_bus(monkeypatch, lambda line: line.faults.add(Fault("silent", id=3, at_s=0.5)))
    result = run_cli(f"servo plot present_voltage --arm so101 {FAST} --id 2,3 --duration 1")
    cells = [row.split(",")[1:] for row in result.out.splitlines()[1:]]
    assert cells[0] == ["7.4", "7.4"]
    assert cells[-1] == ["7.4", ""]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("servo plot p_gian --arm so101 {fast}", "p_gain"),
        ("servo plot --arm so101 {fast} --id 3,9", "named '9'"),
        ("servo plot --arm so101 {fast} --id 3,,4", "named ''"),
        ("servo plot --arm so101 {fast} --period 0", "above 0"),
        ("servo read id --arm so101 {fast} --id 3 --duration 3", "No such option: --duration"),
    ],
)
def test_invalid_servo_plot_is_refused(run_cli, words, said):
    result = run_cli(words.format(fast=FAST))
    assert (result.code, result.out) == (ExitCode.USAGE, "")
    assert said in result.err


def test_text_curve_of_servo_plot_spans_its_values():
    assert block_curve([0.0, 1.0, 2.0, None, 7.0], 1) == ["▁▂▃ █"]
    assert block_curve([0.0, 15.0], 2) == [" █", "▁█"]
    assert block_curve([3.0, 3.0], 1) == ["▁▁"]
    assert block_curve([None], 1) == [" "]
