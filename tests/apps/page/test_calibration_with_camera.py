"""A calibration with the camera of the page, begun and answered there, in virtual time."""

from contextlib import nullcontext
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from ikservo.apps.page.messages.page_messages import CalibrationAnswer
from ikservo.apps.page.running.arm_thread import ArmThread
from ikservo.apps.page.running.calibration_panel import CalibrationDriver, calibration_fields
from ikservo.arm import StopKind, StopReason
from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.cli.camera_options import CameraOptions
from ikservo.files.reading import config_dir
from ikservo.planning.surroundings import Turn
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL

pytest.importorskip("cv2")

from tests.apps.cameras.hidden_arms import hidden_arm

ACTIONS = set(get_args(CalibrationAnswer.model_fields["action"].annotation))
STOP = StopReason(StopKind.CLIENT, "Stopped from the page.")


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def hidden(monkeypatch):
    return hidden_arm(monkeypatch, "so101", 0)


@pytest.fixture
def thread(hidden):
    """Return the thread of an arm whose page is in control and shows a camera."""
    arm, camera = hidden
    model = load_model("so101")
    driver = CalibrationDriver(model, PORT)
    options = CameraOptions(camera="http://me:secret@cam/1", pictures=10)
    driver.open_camera = lambda: nullcontext((camera, options))
    thread = ArmThread(lambda: open_own_arm(model, PORT), arm.port.clock, 0.3, driver)
    thread.page = thread.lease.acquire("a page", take_over=True).lease
    yield thread
    thread.arm.close("hold")


def run(thread, answers=None, on_view=lambda _: None):
    """Run the calibration in the thread; return its screens.

    Each screen is answered with its first choice, or as in ``answers``.
    """
    driver, run_driver, screens = thread.calibration, thread.calibration.run, []

    def answered():
        for view in run_driver():
            yield view
            shown = calibration_fields(view)
            if not screens or shown != screens[-1]:
                screens.append(shown)
            thread.lease.refresh(thread.page)
            assert set(choices(shown)) <= ACTIONS
            on_view(shown)
            words = {"How do you want": "camera", **(answers or {})}
            word = next((words[part] for part in words if part in shown["task"]), None)
            if not shown["moves"]:
                driver.put_answer(word or shown["choices"][0]["answer"], view.number)

    driver.run = answered
    driver.request_start()
    thread.step()
    assert (driver.requested, driver.arm, thread.snapshot.calibration) == (False, None, None)
    return screens


def choices(shown):
    return [choice["answer"] for choice in shown["choices"]]


def holding(arm):
    return [servo.drive.torque_on for servo in arm.line.servos.values()]


def positions(arm):
    return [joint.position for joint in arm.world.joints]


def saved():
    return calibration_path("so101", SERIAL).read_text()


def test_page_without_camera_tells_how_to_get_one(thread):
    thread.calibration.open_camera = None
    screens = run(thread, {"How do you want": "cancel"})
    assert choices(screens[0]) == ["accept", "stops", "cancel"]
    remedy = "this page has none. Add one: ikservo view so101 --camera 0"
    assert remedy in screens[0]["lines"][2]


def test_page_without_camera_ignores_choice_of_camera(thread):
    thread.calibration.open_camera = None
    count = iter(range(5))
    screens = run(thread, on_view=lambda _: next(count, None) is None and leave(thread))
    assert len(screens) == 1


def leave(thread):
    thread.calibration.put_answer("cancel", 0)


@pytest.mark.full
@pytest.mark.timeout(600)
def test_calibration_with_camera_is_saved_from_page(thread, hidden):
    screens, before = run(thread), thread.arm
    assert choices(screens[0]) == ["accept", "stops", "camera", "cancel"]
    assert screens[0]["lines"][2].startswith("With a camera: a calibrated arm shows")
    begin = next(each for each in screens if each["task"] == "Begin?")
    assert "Fix the board 5x7-12mm-4x4 to the gripper" in begin["lines"][0]
    assert not begin["shows_pose"]
    shares = [each["share"] for each in screens if each["share"] is not None]
    assert (shares == sorted(shares), shares[-1]) == (True, 1.0)
    assert all(choices(each) == ["cancel"] for each in screens if each["moves"])
    review = next(each for each in screens if each["stage"] == "review")
    assert "10 pictures in" in review["lines"][0]
    assert "ikservo calibration undo so101" in screens[-1]["lines"][0]
    camera = read_calibration(calibration_path("so101", SERIAL)).camera
    assert (camera.source, camera.pictures) == ("http://…@cam/1", 10)
    assert camera.after_mm < camera.before_mm
    assert not list(config_dir().glob("pictures/*"))
    assert all(holding(hidden[0]))
    assert (thread.snapshot.stop_notice, thread.arm is before) == (None, True)
    assert before.where().torque.all()


@pytest.mark.parametrize("part", ["How do you want", "Begin?"])
def test_leaving_before_pictures_changes_nothing(thread, hidden, part):
    before = saved(), positions(hidden[0])
    screens = run(thread, {part: "cancel"})
    assert part in screens[-1]["task"]
    assert (saved(), any(holding(hidden[0]))) == (before[0], False)
    assert thread.snapshot.stop_notice is None


def test_arm_without_calibration_is_not_shown_to_camera(thread, hidden):
    calibration_path("so101", SERIAL).unlink()
    model = load_model("so101")
    thread._open = lambda: open_own_arm(model, PORT, uncalibrated=True)
    run(thread)
    notice = thread.snapshot.stop_notice
    assert notice.message == "so101 has no calibration to correct."
    assert "press Calibrate" in notice.hint
    assert not any(holding(hidden[0]))


def test_arm_with_camera_that_sees_no_board_does_not_move(thread, hidden, monkeypatch):
    arm, camera = hidden
    thread.arm.enable()  # a limp arm would sink
    before, grey = positions(arm), np.full_like(camera.take(), 100)
    monkeypatch.setattr(camera, "take", lambda: grey)
    run(thread)
    assert "is not in the picture" in thread.snapshot.stop_notice.message
    np.testing.assert_allclose(positions(arm), before, atol=0.01)


def assert_stopped(thread, arm, text, before):
    """Check that an arm was stopped, holds where it is, and waits for an acknowledgement."""
    at = positions(arm)
    assert all(holding(arm))
    assert text in thread.snapshot.stop_notice.message
    thread.step()
    np.testing.assert_allclose(positions(arm), at, atol=0.02)
    assert saved() == before
    assert not list(config_dir().glob("pictures/*"))
    thread.acknowledge()
    thread.step()
    assert thread.snapshot.stop_notice is None


def in_motion(thread, action):
    """Call an action in the first motion of the arm, in which the page answers."""
    on_cycle, cycles = thread._on_calibration_cycle, iter(range(20))

    def watched(cycle):
        thread.lease.refresh(thread.page)
        on_cycle(cycle)
        if next(cycles, None) == 19:
            action()

    thread._on_calibration_cycle = watched


@pytest.mark.parametrize("part", ["How do you want", "Begin?"])
def test_arm_does_not_move_after_a_stop_on_a_screen(thread, hidden, part):
    cycles = []
    thread._on_calibration_cycle = cycles.append
    screens = run(thread, on_view=lambda shown: part in shown["task"] and thread.request_stop(STOP))
    assert part in screens[-1]["task"]
    assert not cycles


def test_pictures_are_kept_until_the_result_is_saved(thread, hidden):
    before = saved()
    run(thread, {"Save this?": "cancel"})
    (folder,) = config_dir().glob("pictures/*")
    assert len(list(folder.glob("*.png"))) == 10
    said = [entry.message for entry in thread.snapshot.messages]
    assert any(f"--from-pictures {folder}" in each for each in said)
    assert saved() == before


def test_stop_of_page_reaches_arm_with_camera(thread, hidden):
    before = saved()
    in_motion(thread, lambda: thread.request_stop(STOP))
    run(thread)
    assert_stopped(thread, hidden[0], "Stopped from the page", before)


def test_leaving_arm_that_moves_with_camera_brakes_it(thread, hidden):
    before = saved()
    in_motion(thread, lambda: leave(thread))
    run(thread)
    assert_stopped(thread, hidden[0], "The calibration was cancelled.", before)


def test_stop_while_picture_is_taken_ends_calibration(thread, hidden, monkeypatch):
    (arm, camera), before, taken = hidden, saved(), []
    take = camera.take

    def stopped():
        taken.append(1)
        if len(taken) == 2:
            thread.arm.request_stop(STOP)  # as `ikservo stop` does
        return take()

    monkeypatch.setattr(camera, "take", stopped)
    run(thread)
    assert len(taken) == 2
    assert_stopped(thread, arm, "Stopped from the page", before)


def test_neighbour_may_not_move_while_arm_is_with_camera(thread):
    turn, reopen, others = Turn(), thread._reopen_arm, []
    neighbour = SimpleNamespace(name="koch", turn=turn, things=lambda _: [])

    def reopen_beside_neighbour():
        reopen()
        thread.arm.context.surroundings.set_others([neighbour])

    def stop():
        others.append(turn.is_of_other(neighbour))
        thread.request_stop(STOP)

    thread.arm.context.surroundings.set_others([neighbour])
    thread._reopen_arm = reopen_beside_neighbour
    in_motion(thread, stop)
    run(thread)
    assert (others, turn.is_of_other(neighbour)) == ([True], False)


def test_silent_page_stops_arm_with_camera(thread, hidden):
    before = saved()
    thread.lease.refresh = lambda _: None
    run(thread)
    assert 2.5 < thread.lease.silence_s() < 10.0
    assert_stopped(thread, hidden[0], "the page does not answer", before)


def test_closed_page_leaves_arm_with_camera_holding(thread, hidden):
    def close():
        thread._ending = True
        thread.request_stop(STOP)

    in_motion(thread, close)
    run(thread)
    assert all(holding(hidden[0]))
    assert "Stopped from the page" in thread.snapshot.stop_notice.message
