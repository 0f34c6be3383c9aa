"""``ikservo calibrate --touch`` on an arm with slightly wrong zeros and links."""

import math
from contextlib import nullcontext
from datetime import UTC, datetime

import numpy as np
import pytest

from ikservo.calibration.calibration_file import read_calibration, save_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.calibration.records import CalibratedCamera
from ikservo.planning.calibrated_arm import load_calibration_for
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration
from tests.model.touch.perturbed_geometry import PerturbedGeometry

NAME = "so101"
EVERY_S = 2.0
WORDS = f"calibrate {NAME} --port {PORT} --touch"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def truth():
    return PerturbedGeometry(NAME, 2, load_model(NAME).chain)


@pytest.fixture
def arm(monkeypatch, truth):
    """Return an arm that was held two degrees off its pose when it was calibrated."""
    arm = connect_arm(monkeypatch, NAME)
    for name, off in zip(truth.chain.names, truth.zeros, strict=True):
        arm.world.place(name, arm.true_position(name) + off)
    write_calibration(arm)
    return arm


def guide(arm, truth, tmp_path, count=15):
    """Guide the tip to points one after another; return the file that says where they are."""
    lines, start_s = [], arm.world.time_s + 0.5
    for i in range(count):
        q = truth.posture()
        arm.world.schedule(start_s + EVERY_S * i, lambda q=q: place(arm, truth, q))
        x, y, z = truth.tip(q) + truth.noise()
        lines.append(f"P{i} {x:.4f} {1000 * y:.1f}mm {z:.4f}")
    path = tmp_path / "points"
    path.write_text("# measured\n" + "\n".join(lines))
    return path


def place(arm, truth, q):
    for name, position in zip(truth.chain.names, q, strict=True):
        arm.world.place(name, position)


def tip_errors_m(arm, truth, count=20):
    """Return the distances between the true and the computed tip at unseen postures, m."""
    errors = []
    with arm.open_bus() as bus:
        bus.port.name = PORT
        own = load_calibration_for(bus, load_model(NAME))
        maps = [own.joint_map(own_joint(name)) for name in truth.chain.names]
        for _ in range(count):
            q = truth.posture()
            place(arm, truth, q)
            result = [m.position(arm.register(m.servo_id, "present_position")) for m in maps]
            errors.append(own.chain().forward(result)[:3, 3] - truth.tip(q))
    return np.linalg.norm(errors, axis=1)


def own_joint(name):
    return load_model(NAME).joint(name)


@pytest.mark.full
def test_touch_off_of_15_points_brings_tip_within_1_5_mm_rms(arm, truth, tmp_path, run_cli):
    before = tip_errors_m(arm, truth)
    points = guide(arm, truth, tmp_path)
    done = run_cli(f"{WORDS} --points {points} --yes --json")
    assert done.code == 0, done.err
    after = tip_errors_m(arm, truth)
    assert math.sqrt(np.mean(before**2)) > 0.008
    assert math.sqrt(np.mean(after**2)) < 0.0015
    assert done.json["after_m"] < 0.2 * done.json["before_m"]
    assert "Cross-validated tip error: " in done.err
    geometry = read_calibration(calibration_path(NAME, SERIAL)).geometry
    assert geometry.touches == 15
    home = load_model(NAME).chain_pose("home")
    place(arm, truth, home)
    move = f"move 0.22 0.03 0.12 --arm {NAME} --port {PORT} --no-collision --no-wiggle --yes"
    moved = run_cli(move)
    assert moved.code == 0, moved.err
    true = truth.tip([arm.true_position(name) for name in truth.chain.names])
    np.testing.assert_allclose(true, (0.22, 0.03, 0.12), atol=2.5e-3)


@pytest.mark.full
def test_touch_off_drops_and_names_outdated_camera_calibration(arm, truth, tmp_path, run_cli):
    camera = CalibratedCamera(
        source="2", seen=datetime(2026, 11, 2, tzinfo=UTC), pictures=24, left_out=0,
        before_mm=1.0, after_mm=0.2, size_px=(640, 480), lens_px=(600.0, 600.0, 320.0, 240.0),
        distortion=(0.0,) * 5, at_mm=(300.0, 0.0, 500.0), turned_deg=(180.0, 0.0, 0.0),
    )  # fmt: skip
    path = calibration_path(NAME, SERIAL)
    save_calibration(read_calibration(path).model_copy(update={"camera": camera}))
    done = run_cli(f"{WORDS} --points {guide(arm, truth, tmp_path)} --yes")
    assert done.code == 0
    assert "The camera calibration from 2026-11-02 used the old zeros" in done.err
    assert read_calibration(path).camera is None


@pytest.mark.full
def test_touch_off_moves_zeros_and_keeps_end_stops(arm, truth, tmp_path, run_cli):
    path = calibration_path(NAME, SERIAL)
    before = read_calibration(path)
    assert run_cli(f"{WORDS} --points {guide(arm, truth, tmp_path)} --yes").code == 0
    for old, new in zip(before.joints, read_calibration(path).joints, strict=True):
        assert new.travel_ticks == old.travel_ticks
        shift_deg = new.sign * (old.zero_tick - new.zero_tick) * 360 / 4096
        assert new.lower_deg - old.lower_deg == pytest.approx(shift_deg)
        assert new.upper_deg - old.upper_deg == pytest.approx(shift_deg)
    assert path.with_name(f"{path.name}.bak").exists()


@pytest.mark.full
def test_touch_off_script_can_undo_touches(arm, truth, tmp_path, run_cli):
    points = guide(arm, truth, tmp_path, 8)
    script = tmp_path / "script"
    script.write_text("touch\ntouch\nundo\n" + 7 * "touch\n" + "accept\n")
    done = run_cli(f"{WORDS} --points {points} --from-script {script} --json")
    assert [t["point"] for t in done.json["touches"]] == [f"P{i}" for i in range(8)]


def test_touch_off_with_too_few_touches_saves_nothing(arm, truth, tmp_path, run_cli):
    before = calibration_path(NAME, SERIAL).read_text()
    done = run_cli(f"{WORDS} --points {guide(arm, truth, tmp_path, 4)} --yes")
    assert (done.code, "Too few touches: " in done.err) == (6, True)
    assert calibration_path(NAME, SERIAL).read_text() == before


def test_touch_off_time_out_names_the_untouched_point(arm, tmp_path, run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.maintenance.dialogue._TIMEOUT_S", 3.0)
    (tmp_path / "points").write_text("A 0.2 0 0.1\nB 0.2 0.05 0.1\n")
    done = run_cli(f"{WORDS} --points {tmp_path / 'points'} --yes")
    assert (done.code, "Timeout: the tip was not put on B" in done.err) == (6, True)


def test_touch_off_prints_sheet_position_and_omits_far_points(arm, tmp_path, run_cli, monkeypatch):
    monkeypatch.setattr("ikservo.maintenance.dialogue._TIMEOUT_S", 1.0)
    done = run_cli(f"{WORDS} --sheet-origin 250mm --yes")
    assert "its near edge 250 mm from the base's origin" in done.err
    assert "put the tip on B1 at (0.280, 0.050, 0.000) m" in done.err


@pytest.mark.parametrize("line", ["A 1 2", "A 1 2 x", "A 1 2 inf", "A", "A 1 2 3 4"])
def test_touch_off_points_file_error_names_line(arm, tmp_path, run_cli, line):
    (tmp_path / "points").write_text(f"B 0 0 0\n{line}\n")
    done = run_cli(f"{WORDS} --points {tmp_path / 'points'} --yes")
    assert done.code == 2
    assert "line 2" in done.err


def test_touch_off_script_error_names_line(arm, tmp_path, run_cli):
    (tmp_path / "script").write_text("touch\ntuch\n")
    done = run_cli(f"{WORDS} --same-point --from-script {tmp_path / 'script'}")
    assert (done.code, "line 2" in done.err) == (2, True)


def test_touch_off_without_terminal_names_script_option(arm, run_cli):
    done = run_cli(f"{WORDS} --same-point")
    assert (done.code, "--from-script" in done.err) == (2, True)


def test_touch_off_refuses_an_uncalibrated_arm(monkeypatch, run_cli):
    connect_arm(monkeypatch, NAME)
    done = run_cli(f"{WORDS} --yes")
    assert (done.code, "is not calibrated" in done.err) == (6, True)


def test_calibrate_refuses_touch_points_without_touch_option(arm, run_cli):
    done = run_cli(f"calibrate {NAME} --port {PORT} --same-point --yes")
    assert (done.code, "--touch" in done.err) == (2, True)


@pytest.mark.full
def test_touch_off_is_controlled_by_single_keys(arm, truth, tmp_path, run_cli, monkeypatch):
    points = guide(arm, truth, tmp_path, 8)
    typed = iter("\nu" + 8 * "\n" + "a")  # the first touch is taken back and made again
    state = {"next": next(typed)}

    def key():
        still = arm.world.time_s > key.ready_s
        if state["next"] and still:
            pressed, state["next"] = state["next"], next(typed, "")
            key.ready_s += EVERY_S if (pressed, state["next"]) == ("\n", "\n") else 0.0
            return pressed
        return ""

    key.ready_s = arm.world.time_s + 1.5
    monkeypatch.setattr("ikservo.cli.terminal_dialogue.read_keys", lambda: nullcontext(key))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("ikservo.cli.terminal.read_answer", lambda _: "y")
    done = run_cli(f"{WORDS} --points {points} --json")
    assert "Enter touch   s skip   u undo" in done.err
    assert "8 points touched.\n  a evaluate" in done.err
    assert len(done.json["touches"]) == 8


def reported_errors_m(answer):
    tips = [
        np.array(tip) - pose["target_m"] for pose in answer["poses"] for tip in pose["attained_m"]
    ]
    return np.linalg.norm(tips, axis=1)


@pytest.mark.campaign
def test_touch_accuracy_test_detects_calibration_errors(arm, truth, tmp_path, run_cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    true = math.sqrt(np.mean(tip_errors_m(arm, truth) ** 2))
    test = f"test {NAME} --port {PORT} --touch --touches 1 --html a.html --overwrite --yes --json"
    done = run_cli(f"{test} --points {guide(arm, truth, tmp_path, 12)}")
    assert done.code == 0, done.err
    before = math.sqrt(np.mean(reported_errors_m(done.json) ** 2))
    assert len(done.json["poses"]) == 12
    assert before == pytest.approx(true, rel=0.35)
    assert "the tip on known points" in (tmp_path / "a.html").read_text()
    assert run_cli(f"{WORDS} --points {guide(arm, truth, tmp_path)} --yes").code == 0
    again = run_cli(f"{test} --points {guide(arm, truth, tmp_path, 12)}")
    assert math.sqrt(np.mean(reported_errors_m(again.json) ** 2)) < 0.2 * before


def test_touch_accuracy_test_measures_repeatability(arm, truth, tmp_path, run_cli):
    lines = guide(arm, truth, tmp_path, 6).read_text().splitlines()
    (tmp_path / "points").write_text("\n".join(lines[:4]))  # three points, each twice
    words = f"test {NAME} --port {PORT} --touch --touches 2 --points {tmp_path / 'points'}"
    done = run_cli(f"{words} --html {tmp_path / 'a.html'} --yes --json")
    assert done.code == 0, done.err
    assert [pose["cycles"] for pose in done.json["poses"]] == [2, 2, 2]
    assert all(pose["rp_m"] > 0.0 for pose in done.json["poses"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--touch", "Cannot ask: input is not a terminal."),
        ("--points points", "--points and --touches need --touch."),
        ("--touch --touches 0 --yes", "--touches"),
        ("--touch --points nowhere --yes", "nowhere"),
    ],
)
def test_touch_accuracy_test_refuses_bad_options(
    arm, run_cli, tmp_path, monkeypatch, words, message
):
    monkeypatch.chdir(tmp_path)
    result = run_cli(f"test {NAME} --port {PORT} {words}")
    assert result.code in (1, 2)
    assert message in result.err
    assert not list(tmp_path.glob("*.html"))
