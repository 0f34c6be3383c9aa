"""A calibration answered from the page; hands sweep the simulated arm in virtual time."""

import math
from pathlib import Path

import pytest

from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.apps.page.running.calibration_panel import CalibrationDriver, calibration_fields
from ikservo.calibration.calibration_file import read_calibration
from ikservo.maintenance.dialogue import ScriptedAnswers
from ikservo.model import load_model
from tests.calibration.mounted_arms import make_mounted_arm
from tests.calibration.scripted_operator import schedule_operator

WHOLE_TURN = 4095
LONGEST = 6_000  # readings: two minutes


@pytest.fixture
def calibration():
    calibration = CalibrationDriver(load_model("so101"), "sim")
    calibration.request_start()
    return calibration


@pytest.fixture
def hidden(tmp_path, monkeypatch, request):
    """Return an arm on a port of its own that scripted hands sweep."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    arm, model = make_mounted_arm("planar2", 7, pose="home", sign=1), load_model("planar2")
    for name, position in model.pose("home").items():
        arm.world.place(name, position + getattr(request, "param", 0.0))
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda port, rate: arm.port)
    with arm.open_bus() as bus:
        schedule_operator(arm, TorqueOffArm(model, bus).make_subjects("home"))
    arm.port.is_open = True
    return arm


@pytest.fixture
def screens(hidden, request):
    """Return the different screens in order."""
    return screens_of(hidden, getattr(request, "param", "accept"))


def screens_of(arm, *last):
    return held(CalibrationDriver(load_model(arm.name), "/dev/ttyBENCH", "home"), *last)


def held(calibration, *last):
    """Answer a calibration with the given words at its review; return its screens by stage."""
    script, seen, reviewed = ScriptedAnswers(), {}, iter(last)
    calibration.request_start()
    for count, talk in enumerate(calibration.run()):
        shown = calibration_fields(talk)
        seen.setdefault(shown["stage"], shown)
        word = "cancel" if shown["stage"] == "saved" or count > LONGEST else "accept"
        if shown["stage"] in ("anchor", "sweep") and word == "accept":
            word = script.next_answer(talk.item) if talk.request else word
        if shown["stage"] == "review":
            word = next(reviewed)
        if word:
            calibration.put_answer(word, talk.number)
    return seen


def test_calibration_screens_follow_stages_until_saved(screens, tmp_path):
    assert list(screens) == [stage.value for stage in CalibrationStage]
    assert [meter["name"] for meter in screens["sweep"]["meters"]] == ["joint1", "joint2"]
    assert screens["saved"]["lines"][0].startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("screens", "narrow"), [("accept", False), ("protect", True)], indirect=["screens"]
)
def test_servo_limits_are_written_only_after_answer_protect(screens, narrow):
    saved = read_calibration(Path(screens["saved"]["lines"][0]))
    held_ticks = [joint.servo.holds["max_position_limit"] for joint in saved.joints]
    assert (max(held_ticks) < WHOLE_TURN) is narrow


def test_review_warns_of_servo_limits_inside_swept_range(hidden):
    hidden.line.servos[2].write("lock", 0)
    hidden.line.servos[2].write("max_position_limit", 2100)
    review = screens_of(hidden, "cancel")["review"]
    assert any("joint2: its servo's own limits" in line for line in review["lines"])


def test_calibration_undo_at_review_on_page_returns_to_sweep(hidden):
    screens = screens_of(hidden, "undo", "accept")
    assert [choice["answer"] for choice in screens["review"]["choices"]] == [
        "accept", "protect", "undo", "cancel"]  # fmt: skip
    assert Path(screens["saved"]["lines"][0]).is_file()


@pytest.mark.parametrize("hidden", [math.radians(28.0)], indirect=True)
def test_implausible_zero_needs_confirmation_on_page(hidden, tmp_path):
    review = screens_of(hidden, "cancel")["review"]
    assert 'exactly as in the pose "home"' in review["task"]
    assert any("the zero seems to be off by 2" in line for line in review["lines"])
    assert not list(tmp_path.rglob("*.toml"))


@pytest.mark.parametrize("hidden", [math.radians(28.0)], indirect=True)
def test_confirmed_implausible_zero_is_saved_on_page(hidden):
    screens = screens_of(hidden, "accept", "accept")
    assert Path(screens["saved"]["lines"][0]).is_file()


def test_calibration_answer_to_another_screen_is_ignored(hidden):
    calibration = CalibrationDriver(load_model(hidden.name), "/dev/ttyBENCH", "home")
    script, reviewed, late = ScriptedAnswers(), 0, 0
    calibration.request_start()
    for view in calibration.run():
        if view.item.stage == "review":
            reviewed += 1
            calibration.put_answer("accept", late)  # the press arrives when its screen is gone
            if reviewed in (5, 20):
                word = "remeasure joint1" if reviewed == 5 else "cancel"
                calibration.put_answer(word, view.number)
        elif view.request is None:
            calibration.put_answer("accept", view.number)  # by hand
        elif word := script.next_answer(view.item):
            late = view.number
            calibration.put_answer(word, late)
            calibration.put_answer(word, late)
    assert reviewed == 20


def test_unsuitable_calibration_answer_shows_reason(calibration):
    talks = calibration.run()
    calibration.put_answer("accept", next(talks).number)  # by hand
    calibration.put_answer("skip nowhere", next(talks).number)
    assert "no joint named" in str(next(talks).item.error)
    talks.close()


def test_cancel_button_ends_calibration_on_page(calibration):
    talks = calibration.run()
    calibration.put_answer("cancel", next(talks).number)
    assert len(list(talks)) <= 1
