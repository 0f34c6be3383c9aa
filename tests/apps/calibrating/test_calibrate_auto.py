"""``ikservo calibrate --auto``: the arm finds its stops gently and reports contacts."""

import contextlib
import math
import re
import signal
from concurrent.futures import ThreadPoolExecutor, wait

import pytest

from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path, partial_path
from ikservo.errors import StoppedError
from ikservo.serving.control_client import request_stop
from servosim.joint import Hand, glide
from tests.calibration.mounted_arms import Operator, load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration

MARGIN_DEG = 0.3
SEARCH = math.radians(25 + 20)  # past the ends of the arm file


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def arm(monkeypatch, narrow):
    return connect_arm(monkeypatch, narrow, sign=1)


def auto(run_cli, narrow, *more):
    words = f"calibrate {narrow} --port {PORT} --pose home --margin {MARGIN_DEG} --auto --yes"
    return run_cli(" ".join([words, *more]))


def saved():
    path = calibration_path("narrow", SERIAL)
    return read_calibration(path) if path.exists() else None


def watch(arm):
    """Record the range of the goals and the torque limits of the servos, fifty times a second."""
    seen = {"goals": [], "limits": []}

    def look():
        for joint in arm.world.joints:
            servo = joint.servos[0]
            if servo.drive.torque_on:
                tick = (servo.read("goal_position") + servo.read("homing_offset")) % 4096
                turns = (tick - servo.shaft.zero_tick + 2048) % 4096 - 2048
                seen["goals"].append(servo.shaft.sign * turns * math.tau / 4096)
                seen["limits"].append(servo.read("torque_limit"))
        arm.world.schedule(arm.world.time_s + 0.02, look)

    look()
    return seen


@pytest.mark.full
def test_auto_calibration_finds_stops_within_0_6_degrees(arm, narrow, run_cli):
    set_stops(arm, "joint1", -0.4, 0.4)  # inside the arm file's range
    arm.stops["joint1"] = (-0.4, 0.4)
    seen = watch(arm)
    done = auto(run_cli, narrow)
    assert done.code == 0, done.err
    for joint in saved().joints:
        low, high = arm.stops[joint.name]
        swept = joint.recorded_range()
        assert joint.swept == "by itself"
        assert 0.0 <= swept[0] - low <= math.radians(0.6), joint.name
        assert 0.0 <= high - swept[1] <= math.radians(0.6), joint.name
    assert max(map(abs, seen["goals"])) <= SEARCH + 0.002
    assert 300 in seen["limits"]
    assert not any(servo.drive.torque_on for servo in arm.line.servos.values())
    where = run_cli(f"where --arm {narrow} --port {PORT} --json").json["joints"]
    assert any("the arm's own sweep of" in joint["limit_from"] for joint in where)


def set_stops(arm, name, low, high):
    motor = arm.joint(name).servos[0].motor
    motor.lower_stop_rad, motor.upper_stop_rad = low, high


@pytest.mark.full
def test_obstacle_before_end_stop_is_refused_and_not_saved(arm, narrow, run_cli):
    set_stops(arm, "joint2", -0.1, 0.436)
    done = auto(run_cli, narrow)
    assert done.code == 6
    assert re.search(
        r"joint2 hit something at -[56]\.\d°; its end stop is expected at -25", done.err
    )
    assert "--skip joint2" in done.err
    assert saved() is None
    assert all(servo.drive.torque_on for servo in arm.line.servos.values())
    assert {servo.read("torque_limit") for servo in arm.line.servos.values()} == {1000}


@pytest.mark.full
def test_joints_calibrated_before_failure_are_kept_for_next_run(arm, narrow, run_cli):
    set_stops(arm, "joint1", -0.1, 0.436)
    assert "Measured and kept for the next run: joint2." in auto(run_cli, narrow).err
    set_stops(arm, "joint1", -0.436, 0.436)
    back_to_the_pose(arm)
    done = auto(run_cli, narrow)
    assert (done.code, "joint2: searching" in done.err) == (0, False), done.err
    assert re.search(r"joint1: searching for its end stop near .* \(joint 2 of 2\)", done.err)
    assert [joint.swept for joint in saved().joints] == ["by itself", "by itself"]
    low, high = saved().joint("joint2").recorded_range()
    assert 0.0 <= low - arm.stops["joint2"][0] <= math.radians(0.6)
    assert 0.0 <= arm.stops["joint2"][1] - high <= math.radians(0.6)
    assert not partial_path("narrow", SERIAL).exists()


def back_to_the_pose(arm):
    """Switch torque off and lead the arm back to the pose before the run."""
    for joint in arm.world.joints:
        joint.servos[0].write("torque_enable", 0)
        arm.world.grasp(joint.name, Hand(glide(joint.position, math.radians(5.0), 0.5), limit=60.0))
    arm.port.clock.sleep_until(arm.port.clock.now_s() + 3.0)
    for joint in arm.world.joints:
        arm.world.release(joint.name)


@pytest.mark.campaign
@pytest.mark.parametrize(
    "text", ["no table", *(pytest.param(t, marks=pytest.mark.campaign) for t in ("", "format = 2"))]
)
def test_damaged_partial_file_does_not_stop_auto_calibration(arm, narrow, run_cli, text):
    path = partial_path("narrow", SERIAL)
    path.parent.mkdir(parents=True)
    path.write_text(text)
    assert auto(run_cli, narrow, "--skip joint1").code == 0


@pytest.mark.full
def test_auto_search_of_joint_without_end_stop_ends(arm, narrow, run_cli):
    set_stops(arm, "joint2", -math.inf, math.inf)
    done = auto(run_cli, narrow)
    assert (done.code, "joint2 has no end stop up to" in done.err) == (6, True)
    assert "--continuous joint2" in done.err
    assert saved() is None


@pytest.mark.full
def test_ctrl_c_in_auto_calibration_stops_and_holds(arm, narrow, run_cli):
    arm.world.schedule(arm.world.time_s + 7.0, lambda: signal.raise_signal(signal.SIGINT))
    done = auto(run_cli, narrow)
    assert done.code == 130
    assert saved() is None
    assert all(servo.drive.torque_on for servo in arm.line.servos.values())


@pytest.mark.full
@pytest.mark.parametrize("after_s", [0.5, 7.0])
def test_stop_request_ends_auto_calibration(arm, narrow, run_cli, after_s):
    with ThreadPoolExecutor(1) as other:
        asked = []

        def ask():
            asked.append(other.submit(request_stop, PORT, "narrow"))
            if after_s < 1.0:  # limp: the arm's time stands until the stop has come
                wait(asked, timeout=60.0)

        arm.world.schedule(arm.world.time_s + after_s, ask)
        done = auto(run_cli, narrow)
    assert (done.code, saved()) == (130, None), done.err
    assert asked[0].result().arm == "narrow"
    assert "Stopped from another terminal" in done.err
    torques = {servo.drive.torque_on for servo in arm.line.servos.values()}
    assert torques == {after_s > 1.0}  # a limp arm gets no torque


def eeproms(arm):
    return [
        {
            name: servo.read(name)
            for name in ("homing_offset", "operating_mode", "max_position_limit")
        }
        for servo in arm.line.servos.values()
    ]


@pytest.fixture
def killed(arm, narrow, run_cli, monkeypatch):
    """Return the registers before a search that ended without a message."""
    for servo in arm.line.servos.values():
        servo.memory.put("max_position_limit", 4000)  # which the search takes away
    before = eeproms(arm)
    with monkeypatch.context() as patch:
        patch.setattr(
            "ikservo.apps.calibrating.calibrate_auto.restore_encoders",
            lambda *_: contextlib.nullcontext(),
        )
        arm.world.schedule(arm.world.time_s + 3.0, lambda: signal.raise_signal(signal.SIGINT))
        assert auto(run_cli, narrow).code == 130
    assert eeproms(arm) != before
    return before


@pytest.mark.full
def test_killed_end_stop_search_is_reported_while_torque_is_on(arm, narrow, run_cli, killed):
    where = run_cli(f"where --arm {narrow} --port {PORT} --uncalibrated")
    assert (where.code, "ikservo calibration revert" in where.err) == (6, True), where.err
    doctor = run_cli(f"doctor --arm {narrow} --port {PORT}")
    assert doctor.code == 1
    assert "a calibration was interrupted while it changed servos" in doctor.out
    assert run_cli(f"calibration resume {narrow} --port {PORT} --yes").code == 6
    assert run_cli(f"calibration revert {narrow} --port {PORT} --yes").code == 0
    assert eeproms(arm) == killed


@pytest.mark.full
def test_killed_end_stop_search_is_undone_once_arm_is_limp(arm, narrow, run_cli, killed):
    relaxed = run_cli(f"relax --arm {narrow} --port {PORT} --yes")
    assert not any(servo.drive.torque_on for servo in arm.line.servos.values()), relaxed.err
    done = run_cli(f"where --arm {narrow} --port {PORT} --uncalibrated")
    assert (done.code, eeproms(arm)) == (0, killed), done.err
    assert "interrupted" not in run_cli(f"doctor --arm {narrow} --port {PORT}").out


@pytest.mark.campaign
def test_killed_end_stop_search_is_cleared_by_calibration(
    arm, narrow, run_cli, killed, monkeypatch
):
    back_to_the_pose(arm)
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 1)
    agrees = lambda _, question: not question.text.startswith("Save")  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr("ikservo.cli.terminal_dialogue.Operator.agrees", agrees)
        assert auto(run_cli, narrow, "--skip joint1 --skip joint2").code == 1
    assert eeproms(arm) == killed
    assert auto(run_cli, narrow, "--skip joint1 --skip joint2").code == 0
    assert run_cli(f"where --arm {narrow} --port {PORT}").code == 0


@pytest.mark.full
@pytest.mark.timeout(400)
def test_calibration_in_sagged_pose_is_not_saved_unconfirmed(arm, narrow, run_cli):
    set_stops(arm, "joint2", -0.436, 0.436)  # where the arm file has them
    arm.world.place("joint2", math.radians(5.0 + 7.1))
    done = auto(run_cli, narrow, "--skip joint1")
    assert (done.code, saved()) == (6, None), done.err
    assert "joint2 was swept" in done.err
    assert "the zero seems to be off by 7." in done.err


def counts(arm):
    return [servo.read("homing_offset") for servo in arm.line.servos.values()]


@pytest.mark.full
def test_servo_registers_are_restored_if_nothing_is_saved(arm, narrow, run_cli, monkeypatch):
    before = counts(arm)
    agrees = lambda _, question: not question.text.startswith("Save")  # noqa: E731
    monkeypatch.setattr("ikservo.cli.terminal_dialogue.Operator.agrees", agrees)
    done = auto(run_cli, narrow, "--skip joint1 --skip joint2")
    assert done.code == 1, done.err
    assert counts(arm) == before


@pytest.mark.full
def test_stopped_auto_calibration_names_revert_command(arm, narrow, run_cli):
    write_calibration(arm)
    arm.world.schedule(arm.world.time_s + 3.0, lambda: signal.raise_signal(signal.SIGINT))
    assert "ikservo calibration revert narrow" in auto(run_cli, narrow).err
    assert run_cli(f"calibration push {narrow} --port {PORT} --yes").code == 0
    assert run_cli(f"where --arm {narrow} --port {PORT}").code == 0


@pytest.mark.full
def test_joint_without_end_stops_is_skipped_by_auto_search(monkeypatch, run_cli):
    arm = connect_arm(monkeypatch, "planar2", sign=1)
    where = {joint.name: joint.position for joint in arm.world.joints}
    done = run_cli(f"calibrate planar2 --port {PORT} --pose rest --auto --yes")
    assert done.code == 0, done.err
    assert "searching for its end stop" not in done.err
    assert "joint1: not searched: its range in the arm file, -150.0° to 150.0°" in done.err
    assert where.keys() == {"joint1", "joint2"}


def test_auto_calibration_without_consent_moves_nothing(arm, narrow, run_cli):
    done = run_cli(f"calibrate {narrow} --port {PORT} --pose home --auto --no-input")
    assert (done.code, "--yes" in done.err) == (2, True)
    assert not any(servo.drive.torque_on for servo in arm.line.servos.values())


def test_auto_calibration_forbidden_by_arm_file_is_refused(run_cli):
    done = run_cli(f"calibrate vx300s --port {PORT} --auto --yes")
    assert done.code == 6
    assert "strong enough to hurt somebody" in done.err


@pytest.mark.parametrize("pair", ["--auto --touch", "--touch --wiggle", "--auto --wiggle"])
def test_calibrate_takes_only_one_method_at_a_time(run_cli, pair):
    assert run_cli(f"calibrate planar2 --port {PORT} {pair} --yes").code == 2


def letting_go_when_it_holds(arm):
    """Hold every joint by hand until its torque is on."""
    Operator(arm).hold_all()

    def look():
        for joint in arm.world.joints:
            if not joint.is_free and joint.name in arm.world.hands:
                arm.world.release(joint.name)
        arm.world.schedule(arm.world.time_s + 0.05, look)

    look()


ARMS = ["so101", "so100", "koch", "omx_f", "open_manipulator_x", "px100", "wx250s", "planar2",
        "planar3"]  # fmt: skip


def limp(run_cli, name, *more):
    """Search the end stops of a simulated arm that nobody held before its torque came on."""
    return run_cli(
        " ".join(["calibrate", name, "--port", "sim", "--auto", "--yes", "--json", *more])
    )


def lifts(done):
    """Return the joints that moved to make room for another one, and that other joint."""
    return re.findall(
        r"(\w+) moves .*, and stays there, because it is in the way of (\w+)", done.err
    )


SHORT = {"so100": ("elbow_flex", "shoulder_lift"), "wx250s": ("elbow", "waist")}


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["so100", pytest.param("wx250s", marks=pytest.mark.campaign)])
def test_folded_arm_is_lifted_before_end_stops_are_searched(run_cli, name):
    left_out = [joint.name for joint in load_model(name).joints if joint.name != "gripper"]
    done = limp(run_cli, name, *(f"--skip {joint}" for joint in left_out))
    assert done.code == 0, done.err
    assert SHORT[name] in lifts(done)
    assert not re.search(r"(?m)^\d  ", done.err), done.err
    swept = {joint["name"]: joint["swept"] for joint in done.json["joints"]}
    assert swept == {**dict.fromkeys(left_out, "not swept"), "gripper": "by itself"}


@pytest.mark.campaign
def test_direction_check_avoids_joint_resting_on_its_stop(monkeypatch, run_cli):
    """The limp omx_f rests on the lower stop of joint2, past the limit in the arm file."""
    monkeypatch.setattr(
        "ikservo.apps.calibrating.auto_calibration.AutoCalibration.sweep", lambda _: iter(())
    )
    monkeypatch.setattr(
        "ikservo.apps.calibrating.auto_calibration.AutoCalibration.finish", stopped_there
    )
    done = limp(run_cli, "omx_f")
    assert done.code == 130, done.err
    assert "gripper moves so that it opens, then back" in done.err


def stopped_there(_):
    raise StoppedError("Stopped.")


@pytest.mark.full
def test_auto_calibration_in_tight_pose_suggests_another_pose(monkeypatch, run_cli):
    monkeypatch.setattr("ikservo.maintenance.direction_check.plan_clearance", lambda *_: None)
    done = limp(run_cli, "so100")
    assert done.code == 8
    assert "shoulder_lift cannot move by 5° without a collision" in done.err
    assert "ikservo calibrate so100 --auto --pose home" in done.err


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", ARMS)
def test_auto_calibration_measures_or_reports_every_joint(run_cli, name):
    done = limp(run_cli, name)
    assert done.code == 0, done.err
    for joint in done.json["joints"]:
        report = [line for line in done.json["findings"] if line.startswith(f"{joint['name']}: ")]
        assert joint["swept"] == "by itself" or report, joint["name"]
    reached = {"so101": 5, "so100": 5, "koch": 6, "open_manipulator_x": 4, "px100": 3}
    swept = [joint["name"] for joint in done.json["joints"] if joint["swept"] == "by itself"]
    assert len(swept) >= reached.get(name, 0), done.json["findings"]


@pytest.mark.campaign
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["so101", "so100", "koch", "px100"])
def test_shipped_arms_find_their_stops_under_gravity(monkeypatch, run_cli, name, seed):
    signs = {joint.name: joint.joint_map.sign for joint in load_model(name).joints}
    arm = connect_arm(monkeypatch, name, seed, gravity=True, sign=signs)
    letting_go_when_it_holds(arm)
    done = run_cli(f"calibrate {name} --port {PORT} --pose home --margin 0.3 --auto --yes")
    assert done.code == 0, done.err
    found = read_calibration(calibration_path(name, SERIAL)).joints
    assert sum(joint.swept == "by itself" for joint in found) >= 3
    for joint in found:
        if joint.swept == "by itself":
            low, high = arm.stops[joint.name]
            swept = joint.recorded_range()
            assert abs(swept[0] - low) < math.radians(1.5), joint.name
            assert abs(swept[1] - high) < math.radians(1.5), joint.name
