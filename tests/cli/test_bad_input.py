"""Wrong input gives one clear message and the right exit code, and nothing moves."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.oracle import CONFIGS

SIM = "--arm so101 --port sim"


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (f"move 0.9 0 0.1 {SIM}", 7, "cannot be reached"),
        (f"move nan 0 0.1 {SIM}", 2, "'nan' is not a length"),
        (f"move 0.2 -inf 0.1 {SIM}", 2, "'-inf' is not a length"),
        (f"move 0.2 1e400 0.1 {SIM}", 2, "'1e400' is not finite"),
        (f"move 1e308 0 0.1 {SIM}", 2, "not a number within"),
        (f"joints elbow_flex=1e308 {SIM}", 2, "Expected a number within"),
        (f"move 0.2 0 10deg {SIM}", 2, "'10deg' is not a length"),
        (f"move 0.2 0 {SIM}", 2, "Missing argument"),
        (f"move 0.2 0 0.1 0.4 {SIM}", 2, "unexpected extra argument"),
        (f"move 0.2 0 0.1 {SIM} --speed warp", 2, "no speed named 'warp'"),
        (f"move 0.2 0 0.1 {SIM} --jsno", 2, "No such option"),
        ("move 0.2 0 0.1 --arm so1o1 --port sim", 2, "Did you mean so101?"),
        ("move 0.2 0 0.1 --arm ../so101 --port sim", 2, "no arm or arm file named"),
        ("move 0.2 0 0.1 --arm so101 --port /dev/ttyNONE7", 3, "/dev/ttyNONE7"),
        ("where --arm so101 --port sim:?nonsense=1", 2, "has no option 'nonsense'; known: "),
        ("where --arm so101 --port sim:?noise=2", 2, "noise is a probability from 0 to 1, not 2"),
        ("where --arm so101 --port sim:?pose=nowhere", 2, "no such pose; has: rest, home"),
        ("where --arm so101 --port sim:px100", 2, "name the arm with --arm"),
        ("move 0.2 0 0.1 --arm configs/so101/arm.urdf --port sim", 2, "which link is the tool"),
        (f"joints elbow_flex=130 {SIM}", 8, "above its upper limit 96.8° (arm file)"),
        (f"joints elbow=10 {SIM}", 2, "Did you mean elbow_flex?"),
        (f"joints elbow_flex {SIM}", 2, "JOINT=POSITION"),
        (f"joints elbow_flex=30 elbow_flex=40 {SIM}", 2, "given twice"),
        (f"joints elbow_flex=nan {SIM}", 2, "is not an angle"),
        (
            f"joints elbow_flex=10 wrist_flex=200 {SIM}",
            8,
            "wrist_flex target 200.0° is above its upper limit",
        ),
        (f"pose hom {SIM}", 2, "Did you mean home?"),
        ("solve 0.2 0 0.1 --arm so101 --method magic", 2, "no method named 'magic'"),
        ("sim so1o1", 2, "Did you mean so101?"),
    ],
)
def test_invalid_input_gives_one_message_and_exit_code(run_cli, words, code, message):
    result = run_cli(words)
    assert result.code == code
    assert message in result.err
    assert result.out == ""
    assert "Traceback" not in result.err


def test_error_with_json_option_is_one_json_object(run_cli):
    result = run_cli(f"move 0.9 0 0.1 {SIM} --json")
    assert result.code == 7
    assert result.json["exit_code"] == 7
    assert "cannot be reached" in result.json["error"]
    assert "Try: ikservo move" in result.json["hint"]


@pytest.mark.campaign
def test_nearest_point_suggested_by_hint_can_be_reached(run_cli):
    hint = run_cli(f"move 0.9 0 0.1 {SIM} --json").json["hint"]
    assert run_cli(hint.split("ikservo ")[1] + f" {SIM}").code == 0


def test_usage_error_with_json_option_is_one_json_object(run_cli):
    result = run_cli(f"move nan 0 0.1 {SIM} --json")
    assert result.json["exit_code"] == 2


def test_missing_port_suggests_the_simulator(run_cli, monkeypatch):
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    result = run_cli("where --arm so101")
    assert result.code == 3
    assert "--port sim" in result.err


@pytest.fixture
def own_arm(tmp_path):
    """Return a folder with a copy of an arm that a test may damage."""
    for name in ("arm.toml", "arm.urdf"):
        (tmp_path / name).write_text((CONFIGS / "so101" / name).read_text())
    return tmp_path


def spoil(path: Path, old: str, new: str):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.full
def test_command_accepts_path_to_arm_file(run_cli, own_arm):
    result = run_cli(f"move 0.25 0.05 0.15 --arm {own_arm}/arm.toml --port sim --json")
    assert result.json["reached"] is True


@pytest.mark.parametrize(
    ("file", "old", "new", "place"),
    [
        ("arm.toml", "format = 1", "format = ", "line 1"),
        ("arm.toml", "sign = 1", "sign = 2", "joints[0].servo.sign"),
        ("arm.toml", "baud   =", "baudx   =", "bus.baudx"),
        ("arm.toml", "id = 2", "id = 1", "joints[1].servo.id"),
        ("arm.toml", 'tip    = "gripper_frame"', 'tip = "nose"', "tip"),
        ("arm.toml", 'model = "STS3215"', 'model = "STS9999"', "joints[0].servo.model"),
        ("arm.toml", "elbow_flex = 45.0", "elbow_flex = 145.0", "poses.home.deg.elbow_flex"),
        ("arm.toml", 'urdf   = "arm.urdf"', 'urdf = "../arm.urdf"', "urdf"),
        ("arm.urdf", "<robot", "<robit", "line"),
        ("arm.urdf", 'type="revolute"', 'type="floating"', "line"),
        ("arm.urdf", "</robot>", "", "line"),
    ],
)
def test_malformed_arm_file_error_names_file_and_position(run_cli, own_arm, file, old, new, place):
    spoil(own_arm / file, old, new)
    result = run_cli(f"move 0.25 0.05 0.15 --arm {own_arm}/arm.toml --port sim --json")
    assert result.code == 2
    assert file in result.json["error"]
    assert place in result.json["error"]


def test_urdf_with_xml_entities_is_refused(run_cli, own_arm):
    urdf = own_arm / "arm.urdf"
    bomb = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'
    urdf.write_text(bomb + urdf.read_text().partition("?>")[2])
    result = run_cli(f"solve 0.2 0 0.1 --arm {own_arm}/arm.toml")
    assert result.code == 2
    assert "line 1" in result.err


def test_urdf_external_entity_does_not_read_a_file(run_cli, own_arm):
    secret = own_arm / "secret.txt"
    secret.write_text("swordfish")
    urdf = own_arm / "arm.urdf"
    trick = f'<!DOCTYPE robot [<!ENTITY x SYSTEM "file://{secret}">]><robot name="&x;"/>'
    urdf.write_text(trick)
    result = run_cli(f"solve 0.2 0 0.1 --arm {own_arm}/arm.toml")
    assert result.code == 2
    assert "swordfish" not in result.err + result.out


@pytest.mark.parametrize("number", [1e-320, -0.0])
def test_solve_command_accepts_tiny_numbers(run_cli, number):
    assert math.isfinite(number)
    result = run_cli(f"solve {0.25 + number} {number} 0.15 --arm so101 --json")
    assert json.loads(result.out)["reached"] is True


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has a full disk at hand")
def test_unwritable_output_gives_one_error_line():
    command = [sys.executable, "-c", "import sys; from ikservo.cli import main; sys.exit(main())"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*command, "arms"], stdout=full, stderr=subprocess.PIPE, text=True,
                              check=False)  # fmt: skip
    assert done.returncode == 1
    assert "could not be written" in done.stderr
    assert "Traceback" not in done.stderr


def run_for_a_reader_that_has_exited(words, unbuffered):
    """Run a command whose stdout nobody reads; return its exit code and stderr."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stdout:
        done = subprocess.run(
            [sys.executable, "-m", "ikservo", *words.split()],
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            stdout=stdout, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    return done.returncode, done.stderr


@pytest.mark.sample(1)
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("as_json", ["", "--json"])
def test_closed_output_pipe_ends_command_silently(unbuffered, as_json):
    assert run_for_a_reader_that_has_exited(f"where {SIM} {as_json}", unbuffered) == (1, "")


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_closed_output_pipe_keeps_exit_code_of_an_error(unbuffered):
    code, err = run_for_a_reader_that_has_exited(f"move 0.9 0 0.1 {SIM} --json", unbuffered)
    assert code == 7
    assert "cannot be reached" in err
    assert "Traceback" not in err
