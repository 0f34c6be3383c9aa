"""Every command accepts its arm by --arm and by its bare name."""

import pytest

from ikservo.cli.command_group import all_commands, load_command

NEEDED = {
    "solve": "0.2 0 0.1", "move": "0.2 0 0.1", "arc": "0.2 0 0.1", "look": "3 4", "pick": "3 4",
    "scene check": "f.toml", "scene show": "f.toml",
    "program new": "f.toml", "program check": "f.toml", "program run": "f.toml",
    "servo read": "p_gain",
    "servo write": "p_gain=16", "servo restore": "f.toml", "servo packets": "f.pcapng",
    "bench": "bus",
    "import dataset": "d", "import lerobot": "my_arm", "import recording": "f.mcap",
    "export": "csv", "draw": "f.svg", "joints": "elbow_flex=3",
    "jog": "elbow_flex", "teach": "rest", "record": "f.jsonl", "replay": "f.jsonl",
    "follow": "leader.toml", "camera": "check",
}  # fmt: skip
NAMES = [name for name, each in all_commands().items() if each.module]
WITHOUT_ARM = {"arms", "arms new", "ports", "fleet", "scene show", "net keys", "net acknowledge"}
AS_ARGUMENT = {"setup": "arm", "test": "arm", "calibrate": "arm",
               "camera": "file", "serve": "arm", "ros": "arm", "sim": "arguments"}  # fmt: skip


AS_ARGUMENT |= {name: "arm" for name in NAMES if name.startswith("calibration ")}


def parsed(name, words):
    command = load_command(name, all_commands()[name])
    values = command.make_context(name, words.split()).params
    arm = values[AS_ARGUMENT.get(name, "arm")]
    return arm if isinstance(arm, str | None) else arm[0]


@pytest.mark.parametrize("name", sorted(set(NAMES) - WITHOUT_ARM))
def test_command_accepts_arm_as_option(name, monkeypatch):
    monkeypatch.setenv("IKSERVO_ARM", "px100")
    words = NEEDED.get(name, "")
    assert parsed(name, f"{words} --arm so101") == "so101"
    assert parsed(name, f"--arm=so101 {words}") == "so101"


@pytest.mark.parametrize("name", sorted(set(NAMES) - WITHOUT_ARM - {"view", *AS_ARGUMENT}))
def test_command_accepts_arm_as_positional_name(name):
    words = NEEDED.get(name, "")
    assert parsed(name, f"so101 {words}") == "so101"
    assert parsed(name, f"{words} --json" if name == "where" else words) is None


def test_positional_arm_name_after_option_is_found():
    assert parsed("doctor", "--port sim so101") == "so101"


@pytest.mark.parametrize("words", ["record so101", "teach so101", "replay so101", "draw so101"])
def test_file_or_pose_may_have_same_name_as_arm(words):
    name, word = words.split()
    assert parsed(name, word) is None


def test_arm_given_as_option_and_name_is_refused(run_cli):
    done = run_cli("calibrate koch --arm so101 --port sim")
    assert (done.code, "given twice" in done.err) == (2, True), done.err


def test_doctor_checks_arm_given_as_positional_name(run_cli):
    done = run_cli("doctor so101 --port sim")
    assert done.code == 0, done.err
