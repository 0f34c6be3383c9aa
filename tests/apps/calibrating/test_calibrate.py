"""``ikservo calibrate`` on an arm without a description, and the motions after it."""

import json
import math
import sys

import pytest

from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.calibration.calibration_file import (
    dump_calibration,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.paths import journal_path
from ikservo.calibration.transaction import Journal, dump_journal
from ikservo.files.writing import write_atomic
from tests.calibration.mounted_arms import load_model, make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator
from tests.calibration.test_calibration_file import GEOMETRY
from tests.cli.fixtures_mounted_arm import connect_arm, write_calibration
from tests.cli.fixtures_ports import PortInfo, set_ports

PORT = "/dev/ttyBENCH"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    set_ports(monkeypatch, [PortInfo(PORT, serial_number="58FA083")])
    return tmp_path / "home"


@pytest.fixture
def mount_arm(monkeypatch):
    """Return a function that mounts a hidden arm on the simulated line."""

    def connect_arm(name="planar2", seed=7, **how):
        arm = make_mounted_arm(name, seed, pose="home", **how)

        def open_transport(port, baud_rate):
            arm.port.is_open = True
            return arm.port

        monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
        return arm

    return connect_arm


def hands_on(arm, skipped=()):
    with arm.open_bus() as bus:
        subjects = TorqueOffArm(load_model(arm.name), bus).make_subjects("home")
    schedule_operator(arm, subjects, skipped)


def calibrated(arm, run_cli, *more):
    put_home(arm)
    hands_on(arm)
    words = f"calibrate {arm.name} --port {PORT} --pose home --margin 0.3 --yes"
    done = run_cli(" ".join([words, *more]))
    assert done.code == 0, done.err
    arm.world.hands.clear()
    put_home(arm)
    return done


def put_home(arm):
    for name, position in load_model(arm.name).pose("home").items():
        arm.world.place(name, position)


def file_of(home, name="planar2"):
    return home / "arms" / f"{name}-58FA083.toml"


def test_calibration_dialogue_saves_calibration_file(mount_arm, run_cli, home):
    done = calibrated(mount_arm(), run_cli)
    assert done.out == f"Saved to {file_of(home)}\n"
    calibration = read_calibration(file_of(home))
    assert (calibration.arm, calibration.usb_serial_number) == ("planar2", "58FA083")
    assert [joint.swept for joint in calibration.joints] == ["by hand", "by hand"]


def test_calibration_without_terminal_prints_one_line_per_step(mount_arm, run_cli):
    lines = calibrated(mount_arm(sign=1), run_cli).err.splitlines()
    assert [line for line in lines if line.startswith("Step ")] == [
        'Step 1 of 5: Put the arm in the pose "home". Hold it still …',
        'Step 1 of 5: Put the arm in the pose "home". The arm is still; continue.',
        "Step 2 of 5: Move joint1 so that the tool moves to the right (seen from behind the base)"
        "; hold the others. Its ends are measured later.",
        "Step 3 of 5: Move joint2 so that the tool moves to the left (seen from behind the base)"
        "; hold the others. Its ends are measured later.",
        "Step 4 of 5: Move every joint gently to both end stops.",
        "Step 4 of 5: Move every joint gently to both end stops."
        " Continue once all have touched them.",
        "Step 5 of 5: Review and save.",
    ]


def shown_before_saving(done):
    """Return the printed lines of what would be saved and how it differs from the old file."""
    lines = done.err.splitlines()
    review = lines[lines.index("Step 5 of 5: Review and save.") + 1 :]
    joints = [line for line in review if ": zero at tick" in line]
    return joints, [line for line in review if "replaces" in line or " was " in line]


def test_calibration_is_shown_before_it_is_saved(mount_arm, run_cli, home):
    joints, changed = shown_before_saving(calibrated(mount_arm(), run_cli))
    saved = read_calibration(file_of(home))
    assert len(joints) == len(saved.joints)
    for line, joint in zip(joints, saved.joints, strict=True):
        way = "with the joint" if joint.sign == 1 else "against it"
        assert f"{joint.name}: zero at tick {joint.zero_tick:g}, servo counts {way}" in line
        assert f"{joint.lower_deg:.1f}° to {joint.upper_deg:.1f}° (by hand)" in line
    assert changed == []


def test_changes_from_previous_calibration_are_shown(mount_arm, run_cli, home):
    arm = mount_arm()
    calibrated(arm, run_cli)
    first = read_calibration(file_of(home))
    spoiled = first.joints[0].model_copy(update={"zero_tick": first.joints[0].zero_tick + 7})
    other = first.model_copy(update={"joints": (spoiled, *first.joints[1:])})
    write_atomic(file_of(home), dump_calibration(other))
    _, changed = shown_before_saving(calibrated(arm, run_cli))
    assert changed[0].startswith(f"This replaces the calibration from {first.written:%Y-%m-%d}")
    assert f"joint1: zero was tick {spoiled.zero_tick:g}, is now tick " in changed[1]


@pytest.mark.full
def test_calibrate_says_that_it_replaces_damaged_file(mount_arm, run_cli, home):
    arm = mount_arm()
    calibrated(arm, run_cli)
    text = file_of(home).read_text()
    file_of(home).write_text(text.replace("format = 1", "format = 9"))
    _, changed = shown_before_saving(calibrated(arm, run_cli))
    assert "is damaged" in changed[0]


def test_calibrate_json_is_one_object_with_every_joint(mount_arm, run_cli, home):
    answer = calibrated(mount_arm(), run_cli, "--json").json
    assert answer["schema"] == "ikservo/calibrate/1"
    assert answer["path"] == str(file_of(home))
    assert [joint["name"] for joint in answer["joints"]] == ["joint1", "joint2"]


def test_where_after_calibration_gives_true_angles_and_source(mount_arm, run_cli):
    arm = mount_arm()
    calibrated(arm, run_cli)
    answer = run_cli(f"where --arm planar2 --port {PORT} --json").json
    by_hand = [j for j in answer["joints"] if "hand sweep of" in j["limit_from"]]
    assert by_hand
    for joint in answer["joints"]:
        truth = arm.true_position(joint["name"])
        assert joint["position_rad"] == pytest.approx(truth, abs=math.radians(0.3))


@pytest.mark.campaign
def test_calibrated_arm_reaches_target_within_3_mm(mount_arm, run_cli):
    arm = mount_arm()
    calibrated(arm, run_cli)
    done = run_cli(f"move 0.18 0.05 0.05 --arm planar2 --port {PORT} --yes --json --no-collision")
    assert done.code == 0, done.err
    reach = load_model("planar2").chain.forward(
        [arm.true_position(name) for name in ("joint1", "joint2")]
    )[:2, 3]
    assert reach == pytest.approx((0.18, 0.05), abs=3e-3)


def test_servo_limits_are_written_only_if_asked(mount_arm, run_cli):
    arm = mount_arm(spoiled=False)
    calibrated(arm, run_cli)
    assert arm.register(1, "min_position_limit") == 0
    calibrated(arm, run_cli, "--write-limits")
    assert arm.register(1, "min_position_limit") > 0


def test_calibration_script_skips_a_joint(mount_arm, run_cli, home, tmp_path):
    script = tmp_path / "answers"
    script.write_text("accept\nskip joint1\naccept\naccept\n")
    arm = mount_arm()
    hands_on(arm, skipped=["joint1"])
    done = run_cli(f"calibrate planar2 --port {PORT} --pose home --from-script {script}")
    assert done.code == 0, done.err
    assert "joint1 was skipped" in done.err
    assert [j.swept for j in read_calibration(file_of(home)).joints] == ["not swept", "by hand"]


def test_user_limit_narrows_range_and_is_reported_as_user(mount_arm, run_cli):
    arm = mount_arm()
    calibrated(arm, run_cli, "--limit joint1=-30:40")
    joints = run_cli(f"where --arm planar2 --port {PORT} --json").json["joints"]
    assert joints[0]["limit_from"] == "user"
    assert math.degrees(joints[0]["upper_rad"]) == pytest.approx(40.0)


def test_warning_names_rest_pose_outside_user_limit(mount_arm, run_cli):
    arm = mount_arm()
    hands_on(arm)
    done = run_cli(
        f"calibrate {arm.name} --port {PORT} --pose home --margin 0.3 --limit joint2=-90:90 --yes"
    )
    assert done.code == 0, done.err
    assert "joint2: the rest pose is at -150.0°, outside its limit of -90.0° (user)" in done.err


@pytest.mark.parametrize("text", ["joint1", "joint1=3", "joint3=1:2", "joint1=a:b", "joint1=3:1"])
def test_invalid_limit_option_saves_nothing(mount_arm, run_cli, home, text):
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --limit {text} --yes")
    assert done.code in (2, 6)
    assert not file_of(home).exists()


def test_calibrate_error_without_terminal_names_needed_options(mount_arm, run_cli, home):
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --pose home --no-input")
    assert done.code == 2
    assert "--yes" in done.err
    assert "--from-script" in done.err


def test_calibrate_without_operator_reports_unmoved_joint(mount_arm, run_cli, home, monkeypatch):
    monkeypatch.setattr("ikservo.maintenance.dialogue._TIMEOUT_S", 3.0)
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --pose home --yes")
    assert done.code == 6
    assert "joint1 has not been moved yet" in done.err
    assert not file_of(home).exists()


def test_calibrate_asks_before_it_switches_torque_off(mount_arm, run_cli, home):
    arm = mount_arm()
    arm.line.servos[1].write("torque_enable", 1)
    done = run_cli(f"calibrate planar2 --port {PORT} --pose home --no-input")
    assert "Torque will be switched off" in done.err
    assert done.code == 1
    assert arm.register(1, "torque_enable") == 1


def test_unknown_pose_error_of_calibrate_lists_known_poses(mount_arm, run_cli):
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --pose folded --yes")
    assert done.code == 2
    assert "home, rest, zero" in done.err


def test_warning_names_servo_limits_narrower_than_range(mount_arm, run_cli):
    arm = mount_arm(spoiled=False, zero=2048, sign=1)
    arm.line.servos[2].write("lock", 0)
    arm.line.servos[2].write("max_position_limit", 2100)
    result = calibrated(arm, run_cli).err
    assert "joint2: its servo's own limits, 0 to 2100, are narrower than the range found" in result
    assert "--write-limits" in result


# --- without a calibration ---


def test_uncalibrated_arm_refuses_tip_move_on_real_port(mount_arm, run_cli):
    done = run_cli(f"move 0.18 0.05 0.05 --arm planar2 --port {mount_arm() and PORT} --yes")
    assert done.code == 6
    assert "planar2 is not calibrated" in done.err
    assert "ikservo calibrate planar2" in done.err


def test_uncalibrated_arm_allows_only_small_confirmed_steps(mount_arm, run_cli):
    arm = mount_arm(zero=2048, sign=1)
    words = f"joints joint1={{}} --arm planar2 --port {PORT} --no-collision"
    here = math.degrees(arm.true_position("joint1"))
    far = run_cli(words.format(here - 12) + " --yes")
    assert (far.code, "more than 10°" in far.err) == (6, True)
    unasked = run_cli(words.format(here - 5))
    assert (unasked.code, "--yes" in unasked.err) == (2, True)
    near = run_cli(words.format(here - 5) + " --yes")
    assert near.code == 0, near.err
    assert math.degrees(arm.true_position("joint1")) == pytest.approx(here - 5, abs=0.5)


def test_uncalibrated_arm_relaxes_in_place_after_confirmation(mount_arm, run_cli):
    arm = mount_arm()
    arm.line.servos[1].write("torque_enable", 1)
    assert run_cli(f"relax --arm planar2 --port {PORT}").code == 1
    assert arm.register(1, "torque_enable") == 1
    assert run_cli(f"relax --arm planar2 --port {PORT} --yes").code == 0
    assert arm.register(1, "torque_enable") == 0


@pytest.mark.full
def test_uncalibrated_option_uses_nominal_zeros(mount_arm, run_cli):
    arm = mount_arm(zero=2048, sign=1, spoiled=False)
    words = f"move 0.18 0.05 0.05 --arm planar2 --port {PORT} --yes --no-collision"
    done = run_cli(f"{words} --uncalibrated")
    assert done.code == 0, done.err
    assert "Not calibrated: using nominal zeros" in done.err
    assert arm.true_position("joint1") != pytest.approx(0.785, abs=0.1)


# --- file and servos ---


def test_changed_servo_offset_is_refused_with_both_values(mount_arm, run_cli, home):
    arm = mount_arm()
    calibrated(arm, run_cli)
    held = read_calibration(file_of(home)).joints[0].servo.holds["homing_offset"]
    arm.line.servos[1].write("lock", 0)
    arm.line.servos[1].write("homing_offset", 77)
    done = run_cli(f"where --arm planar2 --port {PORT}")
    assert done.code == 6
    result = f"homing_offset of joint1 (id 1) is 77 in the servo and {held} in the calibration"
    assert result in done.err
    assert "ikservo calibration push" in done.err


def changed(arm, run_cli):
    """Calibrate, then let another program change a servo's offset a little."""
    calibrated(arm, run_cli)
    servo = arm.line.servos[1]
    servo.write("lock", 0)
    offset = servo.read("homing_offset")
    servo.write("homing_offset", offset - 20 if offset > 0 else offset + 20)
    servo.write("lock", 1)
    return offset


@pytest.mark.full
def test_calibration_diff_lists_registers_and_exits_with_6(mount_arm, run_cli):
    arm = mount_arm()
    calibrated(arm, run_cli)
    same = run_cli(f"calibration diff planar2 --port {PORT}")
    assert (same.code, same.out) == (0, "Servos and calibration file agree.\n")
    offset = changed(arm, run_cli)
    done = run_cli(f"calibration diff planar2 --port {PORT} --json")
    assert done.code == 6
    (row,) = done.json["differences"]
    assert (row["register"], row["expected"]) == ("homing_offset", str(offset))


def test_calibration_push_writes_file_values_to_servos(mount_arm, run_cli):
    arm = mount_arm()
    offset = changed(arm, run_cli)
    assert run_cli(f"calibration push planar2 --port {PORT}").code == 1
    assert run_cli(f"calibration push planar2 --port {PORT} --yes").code == 0
    assert arm.register(1, "homing_offset") == offset
    assert run_cli(f"where --arm planar2 --port {PORT}").code == 0


def test_calibration_pull_updates_file_and_keeps_zeros(mount_arm, run_cli):
    arm = mount_arm()
    changed(arm, run_cli)
    assert run_cli(f"calibration pull planar2 --port {PORT} --yes").code == 0
    joint = run_cli(f"where --arm planar2 --port {PORT} --json").json["joints"][0]
    assert joint["position_rad"] == pytest.approx(arm.true_position("joint1"), abs=0.006)


TURNED = [("planar2", "phase", 1), ("planar2", "operating_mode", 1), ("koch", "drive_mode", 1)]
IGNORED = [("koch", "homing_offset", 1500)]


@pytest.mark.parametrize(("name", "register", "flips"), TURNED + IGNORED)
def test_calibration_pull_refuses_other_count_direction(
    monkeypatch, run_cli, name, register, flips
):
    arm = connect_arm(monkeypatch, name, spoiled=False, zero=2048, sign=1)
    write_calibration(arm)
    servo = arm.line.servos[2]
    if name == "planar2":
        servo.write("lock", 0)
    servo.write(register, servo.read(register) ^ flips)
    done = run_cli(f"calibration pull {name} --port {PORT} --yes")
    is_reported = "counts in the opposite direction from when it was calibrated" in done.err
    assert (done.code, is_reported) == (6, True)
    assert run_cli(f"calibration diff {name} --port {PORT}").code == 6


@pytest.mark.sample(2)
@pytest.mark.parametrize("action", ["push", "pull"])
@pytest.mark.parametrize("other", [{"id": 7}, {"model": "STS3250"}], ids=str)
def test_calibration_push_and_pull_refuse_file_of_other_servos(
    mount_arm, run_cli, home, action, other
):
    calibrated(mount_arm(), run_cli)
    calibration = read_calibration(file_of(home))
    first, second = calibration.joints
    servo = second.servo.model_copy(update=other)
    joints = (first, second.model_copy(update={"servo": servo}))
    text = dump_calibration(calibration.model_copy(update={"joints": joints}))
    file_of(home).write_text(text)
    done = run_cli(f"calibration {action} planar2 --port {PORT} --yes")
    assert (done.code, "in the arm file" in done.err) == (6, True)
    assert file_of(home).read_text() == text


def test_calibration_push_refuses_uncalibrated_arm(mount_arm, run_cli):
    done = run_cli(f"calibration push planar2 --port {mount_arm() and PORT} --yes")
    assert done.code == 6
    assert "is not calibrated" in done.err


def test_calibration_resume_after_success_does_nothing(mount_arm, run_cli):
    done = run_cli(f"calibration resume planar2 --port {mount_arm() and PORT}")
    assert (done.code, done.out) == (0, "No interrupted write; nothing to do.\n")


def holding(arm):
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 1)
    return lambda: all(servo.drive.torque_on for servo in arm.line.servos.values())


SLIPS = [
    "calibrate planar2 --pose folded --yes",
    "calibrate planar2 --skip joint9 --yes",
    "calibrate planar2 --continuous joint9 --yes",
    "calibrate planar2 --limit joint1=400:500 --yes",
    "calibrate planar2 --limit joint1=3:1 --yes",
    "calibrate planar2 --from-script /nowhere",
    "calibrate planar2 --auto --yes --skip joint9",
    "calibration resume planar2",
    "calibration revert planar2",
]


@pytest.mark.parametrize("words", SLIPS)
def test_invalid_calibration_command_keeps_torque_on(mount_arm, run_cli, words):
    holds = holding(mount_arm())
    run_cli(f"{words} --port {PORT}")
    assert holds()


def test_calibrate_keeps_torque_if_folder_cannot_be_written(mount_arm, run_cli, home):
    home.write_text("no folder")
    holds = holding(mount_arm())
    done = run_cli(f"calibrate planar2 --port {PORT} --pose home --yes")
    assert (done.code, "cannot be written" in done.err) == (1, True)
    assert holds()


@pytest.mark.parametrize("action", ["resume", "revert"])
def test_calibration_resume_and_revert_ask_before_torque_off(mount_arm, run_cli, action):
    holds = holding(mount_arm())
    journal = Journal(format=1, path="x", old_text="", new_text="", changes=())
    write_atomic(journal_path("planar2", "58FA083"), dump_journal(journal))
    done = run_cli(f"calibration {action} planar2 --port {PORT}")
    assert (done.code, "Torque will be switched off" in done.err) == (1, True)
    assert holds()


@pytest.mark.full
def test_calibrate_says_that_touch_off_corrections_are_dropped(mount_arm, run_cli, home):
    arm = mount_arm()
    calibrated(arm, run_cli)
    calibration = read_calibration(file_of(home))
    save_calibration(calibration.model_copy(update={"geometry": GEOMETRY}))
    assert (
        "  The link and base corrections of the touch-off of 2026-11-03"
        in calibrated(arm, run_cli).err
    )
    assert read_calibration(file_of(home)).geometry is None


def test_calibrate_refuses_closed_stdin(mount_arm, run_cli, monkeypatch):
    monkeypatch.setattr("sys.stdin", None)
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --pose home")
    sys.stdin.close()
    assert (done.code, "input is not a terminal" in done.err) == (2, True)


def test_unknown_calibration_action_suggests_known_one(mount_arm, run_cli):
    done = run_cli(f"calibration pul planar2 --port {mount_arm() and PORT}")
    assert done.code == 2
    assert "Did you mean pull?" in done.err


def test_where_command_refuses_damaged_calibration_file(mount_arm, run_cli, home):
    arm = mount_arm()
    calibrated(arm, run_cli)
    text = file_of(home).read_text()
    file_of(home).write_text(text.replace("sign = 1", "sign = -1").replace("sign = -1", "sign = 1"))
    done = run_cli(f"where --arm planar2 --port {PORT}")
    assert done.code == 2
    assert "is damaged: its checksum does not match its content" in done.err
    assert len(done.err.splitlines()) == 2


def test_calibration_file_of_another_arm_is_refused(mount_arm, run_cli, home):
    calibrated(mount_arm("planar2"), run_cli)
    file_of(home).rename(file_of(home, "planar3"))
    done = run_cli(f"where --arm planar3 --port {mount_arm('planar3') and PORT}")
    assert done.code == 6
    assert "belongs to planar2" in done.err


def test_calibrate_error_is_one_json_object(mount_arm, run_cli):
    done = run_cli(f"calibrate planar2 --port {mount_arm() and PORT} --no-input --json")
    assert json.loads(done.out)["exit_code"] == 2
