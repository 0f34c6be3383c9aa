"""The dialogue of a search for stops, answered value by value in virtual time."""

from contextlib import closing, nullcontext

import pytest

from ikservo.apps.calibrating.auto_calibration_setup import restore_encoders
from ikservo.apps.calibrating.auto_dialogue import calibrate_against_stops, confirm_search
from ikservo.apps.calibrating.by_hand_dialogue import CalibrationOptions
from ikservo.apps.calibrating.calibration_session import open_torque_off
from ikservo.errors import CalibrationError, IkservoError
from ikservo.maintenance.dialogue import HandRequest, Notice, Progress, Question
from ikservo.model import load_model
from tests.cli.fixtures_mounted_arm import PORT, connect_arm


@pytest.fixture
def arm(narrow, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    return connect_arm(monkeypatch, narrow, sign=1)


def search(arm, answer, status):
    """Run the dialogue; ``answer`` maps each item to its answer. Return all different items."""
    seen, word = [], None
    options = CalibrationOptions("home", write_limits=False)
    with (
        open_torque_off(load_model(arm.name), PORT) as limp_arm,
        restore_encoders(limp_arm, status.append),
        closing(
            calibrate_against_stops(limp_arm, options, status.append, lambda _: nullcontext())
        ) as dialogue,
    ):
        while True:
            try:
                seen.append(dialogue.send(word))
            except StopIteration:
                return seen
            word = answer(seen[-1])


def agree(item):
    return None if isinstance(item, Notice | Progress) else "accept"


@pytest.mark.full
def test_search_tells_progress_of_each_end_in_order(arm):
    items = search(arm, agree, [])
    shares = [each.done / each.total for each in items if isinstance(each, Progress) if each.total]
    assert shares == [0.0, 0.25, 0.5, 0.75]
    texts = [each.text for each in items if isinstance(each, Progress)]
    assert texts[-1] == "Moving to the rest pose"
    assert texts[0] == "Each joint moves slightly"
    assert texts[1].startswith("joint2: searching for its end stop near -25")


def test_search_begins_only_after_its_warning_is_accepted():
    dialogue = confirm_search(load_model("so101"), "Ctrl-C")
    warning, question = next(dialogue), dialogue.send(None)
    assert "Clear its whole reach. Ctrl-C stops the arm" in warning.text
    assert question.text == "Begin?"
    with pytest.raises(IkservoError, match="Nothing moved"):
        dialogue.send("no")


def test_search_forbidden_by_arm_file_asks_nothing():
    with pytest.raises(CalibrationError, match="strong enough to hurt somebody"):
        next(confirm_search(load_model("vx300s"), "Ctrl-C"))


@pytest.mark.parametrize(
    ("word", "reason"),
    [("skip nowhere", "nowhere"), ("nonsense", "The answer"), ("accept elbow", "The answer")],
)
def test_bad_answer_before_search_is_refused_and_moves_nothing(arm, word, reason):
    def answer(item):
        if isinstance(item, HandRequest) and item.error:
            raise item.error
        return word

    with pytest.raises(IkservoError, match=reason):
        search(arm, answer, [])
    assert not any(servo.drive.torque_on for servo in arm.line.servos.values())


def test_denied_direction_ends_search_and_names_settings(arm):
    status = []
    deny = lambda item: "no" if isinstance(item, Question) else agree(item)  # noqa: E731
    with pytest.raises(CalibrationError, match="joint1 does not move as the arm file says"):
        search(arm, deny, status)
    assert any("keep the settings of the search" in line for line in status)
    assert all(servo.drive.torque_on for servo in arm.line.servos.values())
