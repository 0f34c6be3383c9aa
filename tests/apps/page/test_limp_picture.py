"""The drawing of the limp arm during calibration, judged by the simulated joints."""

import math

import numpy as np
import pytest

from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.apps.page.running.calibration_panel import CalibrationDriver
from ikservo.apps.page.running.limp_picture import LimpPicture
from ikservo.arm import open_arm
from ikservo.maintenance.dialogue import HandRequest, ScriptedAnswers
from ikservo.model import load_model
from tests.apps.page.view_session import ViewSession
from tests.calibration.mounted_arms import Operator, make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator

NEAR_RAD = math.radians(3.0)  # of a hand that holds a pose
READINGS = 400


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


@pytest.fixture
def calibrated(monkeypatch):
    """Yield pairs of drawn and true joints during a calibration."""
    arm, model = make_mounted_arm("planar2", 7, pose="home"), load_model("planar2")
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda port, rate: arm.port)
    with arm.open_bus() as bus:
        schedule_operator(arm, TorqueOffArm(model, bus).make_subjects("home"))
    arm.port.is_open = True
    names = [joint.name for joint in model.joints]
    driver, script = CalibrationDriver(model, "/dev/ttyBENCH", "home"), ScriptedAnswers()
    picture = LimpPicture([joint.joint_map for joint in model.joints],
                          np.array([model.pose("home")[name] for name in names]))  # fmt: skip
    driver.request_start()

    def pairs(moved_rad=0.0):
        for name in names if moved_rad else ():
            Operator(arm).move(name, moved_rad)
        for view in driver.run():
            at = np.array([arm.world.joint(name).position for name in names])
            yield view.item, picture.positions(view.request), at
            if view.item.stage == "review":
                driver.put_answer("cancel", view.number)
            elif view.request is None:
                driver.put_answer("accept", view.number)
            elif answer := script.next_answer(view.item):
                driver.put_answer(answer, view.number)

    return pairs


def test_drawing_matches_limp_arm_once_joint_signs_are_known(calibrated):
    shown = [
        (drawn, at)
        for item, drawn, at in calibrated()
        if item.stage == "sweep" and not item.current
    ]
    assert len(shown) > 20
    assert max(np.abs(drawn - at).max() for drawn, at in shown) < NEAR_RAD
    assert np.ptp([drawn for drawn, _ in shown], axis=0).min() > math.radians(60.0)


def test_drawing_before_calibration_turns_as_much_as_joints(calibrated):
    shown = [
        (drawn, at)
        for item, drawn, at in calibrated(moved_rad=0.3)
        if isinstance(item, HandRequest) and item.stage == "anchor"
    ]
    (first, start), *_ = shown
    assert np.ptp([at for _, at in shown], axis=0).min() > math.radians(5.0)
    for drawn, at in shown:
        assert np.abs(drawn - first) == pytest.approx(np.abs(at - start), abs=math.radians(0.5))


@pytest.mark.full
def test_frames_during_calibration_show_moving_limp_arm():
    with ViewSession() as session:
        driver, frames = CalibrationDriver(session.arm.model, "sim:?pose=home"), []
        run = driver.run

        def watched():
            for count, view in enumerate(run()):
                yield view
                if count % 10 == 0:
                    frames.append(session.latest_frames())
                if count in (0, 20, READINGS):  # by hand, the pose, leave
                    driver.put_answer("cancel" if count == READINGS else "accept", view.number)

        driver.run = watched
        session.arm_thread.calibration = driver
        session.arm_thread._open = lambda: open_arm("so101", "sim:?pose=home")
        driver.request_start()
        session.arm_thread.step()
        session.arm_thread.arm.close()
    scenes = [frame["scene"] for frame in frames if "scene" in frame]
    elbows = [frame["status"]["joints"][2]["text"] for frame in frames if "status" in frame]
    assert all(scene["goal"] is not None for scene in scenes)
    assert len({str(scene["measured"]) for scene in scenes}) >= 3  # the limp arm sinks
    assert abs(float(elbows[0].rstrip("°")) - float(elbows[-1].rstrip("°"))) > 10.0
    last = [frame["status"] for frame in frames if "status" in frame][-1]
    assert last["age_s"] == 0
    assert {joint["torque"] for joint in last["health"]["joints"]} == {"off"}
