"""`ikservo camera check` and `ikservo look` detect and refuse a camera that was moved."""

import numpy as np
import pytest

import ikservo

cv2 = pytest.importorskip("cv2")

from servosim.camera import SimulatedCamera  # noqa: E402
from tests.apps.cameras.saved_camera import save_simulated_camera  # noqa: E402

ARM = "so101 --port sim:?pose=home"
LOOK = f"--arm {ARM}"


@pytest.fixture(autouse=True)
def camera(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr(SimulatedCamera, "set_stage", lambda _: None)  # the board is enough
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        return save_simulated_camera(arm)


@pytest.fixture
def move_camera(monkeypatch):
    """Return a function that moves the simulated camera by a distance in metres."""

    def move(shift_m):
        place = SimulatedCamera.T_camera_board
        monkeypatch.setattr(
            SimulatedCamera,
            "T_camera_board",
            lambda self: place(self) - np.pad(np.array(shift_m)[:, None], ((0, 1), (3, 0))),
        )
        return lambda: monkeypatch.setattr(SimulatedCamera, "T_camera_board", place)

    return move


@pytest.mark.full
def test_camera_check_passes_if_camera_has_not_moved(run_cli):
    found = run_cli(f"camera check {ARM} --camera sim --json")
    assert (found.code, found.json["moved"], found.json["board"]) == (0, False, "gripper")
    assert found.json["off_m"] < 0.001
    assert found.json["moved_m"] < 0.004
    assert "has not moved" in run_cli(f"camera check {ARM} --camera sim").out


def test_moved_camera_is_detected_and_refused_until_moved_back(run_cli, move_camera):
    back = move_camera([0.01, 0.0, 0.0])
    found = run_cli(f"camera check {ARM} --camera sim --json")
    assert (found.code, found.json["moved"]) == (6, True)
    assert found.json["off_m"] == pytest.approx(0.01, abs=0.001)
    assert found.json["moved_m"] == pytest.approx(0.01, abs=0.003)
    refused = run_cli(f"look 480 500 {LOOK}")
    assert refused.code == 6
    assert "The camera has moved by" in refused.err
    assert run_cli(f"look 480 500 {LOOK} --move --yes").code == 6
    assert run_cli(f"camera check {ARM} --camera sim --remember").code == 6
    assert run_cli(f"camera check {ARM} --camera sim --within 20mm").code == 0
    back()
    assert run_cli(f"camera check {ARM} --camera sim").code == 0
    assert run_cli(f"look 480 500 {LOOK}").code == 0


@pytest.mark.full
def test_board_on_table_is_stored_as_reference_and_compared(run_cli, move_camera):
    move_camera([-0.05, 0.0, 0.0])  # which is, for a camera that stands, a board elsewhere
    found = run_cli(f"camera check {ARM} --camera sim --remember --json")
    assert found.code == 0
    assert found.json["board"] == "5x7-12mm-4x4"
    found = run_cli(f"camera check {ARM} --camera sim --json")
    assert (found.code, found.json["board"]) == (0, "table")
    move_camera([0.0, 0.006, 0.0])
    assert run_cli(f"camera check {ARM} --camera sim").code == 6


def test_board_on_gripper_is_not_stored_as_table_reference(run_cli, move_camera):
    for by_m in (0.0, 0.01):  # pushed on the gripper since
        move_camera([by_m, 0.0, 0.0])
        refused = run_cli(f"camera check {ARM} --camera sim --remember")
        assert (refused.code, "is still on the gripper" in refused.err) == (1, True)
    move_camera([-0.01, 0.0, 0.0])
    found = run_cli(f"camera check {ARM} --camera sim --json")
    assert (found.code, found.json["board"]) == (0, "gripper")


def test_look_command_prints_point_of_pixel_and_moves_there(run_cli, camera):
    there = np.linalg.inv(camera.T_base_camera) @ [0.27, 0.06, 0.04, 1.0]
    lens = np.array([[900.0, 0, 480.0], [0, 900.0, 360.0], [0, 0, 1.0]])
    px, _ = cv2.projectPoints(
        there[None, :3], np.zeros(3), np.zeros(3), lens, np.array([-0.12, 0.04, 0, 0])
    )
    u, v = px.ravel()
    seen = run_cli(f"look {u} {v} {LOOK} --height 40mm --json")
    assert seen.code == 0, seen.err
    assert seen.json["point_m"] == pytest.approx([0.27, 0.06, 0.04], abs=1e-6)
    assert "(0.27" in run_cli(f"look {u} {v} {LOOK} --height 40mm").out
    moved = run_cli(f"look {u} {v} {LOOK} --height 40mm --move --yes --json")
    assert moved.code == 0, moved.err
    assert moved.json["measured_tip_m"] == pytest.approx([0.27, 0.06, 0.04], abs=0.002)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (f"look 5 4000 {LOOK}", 2, "a pixel of the 960 x 720 picture"),
        (f"look 480 -360 {LOOK}", 2, "The pixel is 480, -360.\nExpected a pixel of"),
        (f"look -5 3 {LOOK}", 2, "The pixel is -5, 3.\nExpected a pixel of"),
        (f"look 480 x {LOOK}", 2, "'x' is not a number of pixels"),
        (f"look nan 4 {LOOK}", 2, "nan is not a number"),
        (f"look 480 100 {LOOK} --height 3m", 2, "does not meet the table"),
        (f"look 480 400 {LOOK} --dry-run", 2, "only applies with --move"),
        (f"look 480 400 {LOOK} --pitch -90", 2, "only apply with --move"),
        (f"look 480 400 {LOOK} --keep-above 0.02", 2, "only apply with --move"),
        ("look 480 400 --arm koch --port sim", 6, "calibrate the camera: ikservo calibrate koch"),
        ("camera check koch --port sim --camera sim", 6, "koch has no calibrated camera"),
        (f"camera check {ARM}", 2, "Add: --camera 0"),
        (f"camera check {ARM} --camera 77", 2, "There is no camera 77"),
        (f"camera check {ARM} --camera sim --within 0", 2, "above 0"),
        (
            f"camera check {ARM} --camera sim --remember --board 9x9-5mm-5x5",
            1,
            "not in the picture",
        ),
        ("camera board --camera 0", 2, "only applies to check"),
        ("camera board --at 1,2", 2, "only applies to tip"),
        (f"camera check {ARM} --camera sim --at 1,2", 2, "only applies to tip"),
        (f"camera tip {ARM} --at 1,2 --camera sim", 2, "only applies to check"),
        (f"camera tip {ARM}", 2, "Add its pixel: --at 512,300"),
        (f"camera tip {ARM} --at 480", 2, "two numbers, such as 512,300"),
        (f"camera tip {ARM} --at=-5,3", 2, "The pixel is -5, 3.\nExpected a pixel of"),
        (f"camera tip {ARM} --at -5,3", 2, "The pixel is -5, 3.\nExpected a pixel of"),
        (f"camera tip {ARM} --at 480,nan", 2, "a pixel of the 960 x 720 picture"),
        (f"camera tip {ARM} --at 480,360", 6, "The zeros of a simulated arm are exact"),
        (f"camera tip {ARM} --at 480,360 --camera-name left", 2, "no camera named 'left'"),
        (f"camera check {ARM} --camera sim --overwrite", 2, "only applies to board"),
        ("camera checks", 2, "check"),
    ],
)
def test_bad_camera_command_input_gives_one_error(run_cli, words, code, text):
    done = run_cli(words)
    assert done.code == code, (done.out, done.err)
    assert text in done.err


@pytest.mark.full
@pytest.mark.parametrize(
    ("spoil", "code", "text"),
    [
        (lambda picture: np.full_like(picture, 100), 1, "is not in the picture"),
        (lambda picture: cv2.GaussianBlur(picture, (0, 0), 12), 1, "blurred"),
        (lambda picture: np.ascontiguousarray(picture[:, ::-1]), 1, "mirrored"),
        (lambda picture: cv2.resize(picture, (1200, 900)), 6, "1200 x 900"),
    ],
)
def test_unusable_picture_leaves_camera_calibration_unchanged(
    run_cli, monkeypatch, spoil, code, text
):
    take = SimulatedCamera.take
    monkeypatch.setattr(SimulatedCamera, "take", lambda self: spoil(take(self)))
    done = run_cli(f"camera check {ARM} --camera sim")
    assert (done.code, text in done.err) == (code, True), done.err
    assert run_cli(f"look 480 500 {LOOK}").code == 0
