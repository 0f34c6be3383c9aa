"""The script answers at the right moment, to the tick of the clock."""

import pytest

from ikservo.apps.calibrating.by_hand_dialogue import possible_answers, read_script
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.maintenance.dialogue import ScriptedAnswers
from tests.apps.calibrating.test_sweep import Hand, subject


def swept(up=1000, down=2000):
    """Return a hand that has swept one joint by 3 rad, 1956 ticks, over the given ticks."""
    return Hand(subject()).rest().accept().move(up).move(-down)


def answer_at(script, state, at_s):
    return script.next_answer(possible_answers(state, at_s))


def answered_at(hand, script, until_s=70.0):
    """Return the seconds until the script answers, and the answer."""
    began_s = hand.at_s
    while hand.at_s - began_s < until_s:
        word = script.next_answer(hand.request())
        if word is not None:
            return hand.at_s - began_s, word
        hand.read()
    return None


def test_anchor_pose_is_accepted_as_soon_as_arm_is_at_rest():
    hand = Hand(subject()).read()
    assert answered_at(hand, ScriptedAnswers()) == (pytest.approx(0.5, abs=0.05), "accept")


def test_full_joint_sweep_is_accepted_after_1_s_without_change():
    assert answered_at(swept(), ScriptedAnswers()) == (pytest.approx(1.0, abs=0.03), "accept")


def test_narrow_joint_sweep_is_accepted_after_4_s_unchanged():
    assert answered_at(swept(500, 1000), ScriptedAnswers()) == (
        pytest.approx(4.0, abs=0.03),
        "accept",
    )


@pytest.mark.parametrize(("up", "down", "wait_s"), [(1000, 2000, 1.0), (500, 1000, 4.0)])
def test_scripted_accept_is_given_after_wait_without_motion(up, down, wait_s):
    state, script = swept(up, down).state, ScriptedAnswers()
    answers = [answer_at(script, state, at_s) for at_s in (5.0, 5.0 + wait_s, 5.0 + wait_s + 0.01)]
    assert answers == [None, None, "accept"]


def test_scripted_answer_times_out_after_60_s():
    state, script = Hand(subject()).rest().accept().state, ScriptedAnswers()
    assert [answer_at(script, state, at_s) for at_s in (5.0, 65.0)] == [
        None,
        None,
    ]
    with pytest.raises(CalibrationError, match="has not been moved yet"):
        answer_at(script, state, 65.01)


def test_joint_motion_restarts_wait_before_accept():
    hand, script = swept(), ScriptedAnswers()
    assert answered_at(hand, script, until_s=0.8) is None
    hand.move(-200)
    assert answered_at(hand, script)[0] == pytest.approx(1.0, abs=0.03)


def test_scripted_skip_is_given_as_soon_as_sweep_starts():
    script = ScriptedAnswers(["skip elbow", "accept"])
    hand = Hand(subject()).rest()
    assert script.next_answer(hand.request()) is None
    hand.accept().read()
    assert script.next_answer(hand.request()) == "skip elbow"


def test_every_scripted_answer_has_its_own_time_out():
    hand, script = (
        Hand(subject("a", 1), subject("b", 2)).rest().accept(),
        ScriptedAnswers(["skip a"]),
    )
    assert answered_at(hand, script) == (0.0, "skip a")
    hand.say("skip a")
    began_s = hand.at_s
    with pytest.raises(CalibrationError, match="script ended"):
        answered_at(hand, script)
    assert hand.at_s - began_s == pytest.approx(60.0, abs=0.05)


def trembling(hand, script):
    """Let a hand tremble by ten ticks while a script waits."""
    for k in range(5000):
        script.next_answer(hand.request())
        hand.ticks[1] = 100 + 10 * (k % 2)
        hand.read()


def test_calibration_of_arm_that_never_rests_times_out():
    hand = Hand(subject()).read()
    with pytest.raises(CalibrationError, match="still moving"):
        trembling(hand, ScriptedAnswers())
    assert hand.at_s == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize(
    ("text", "line"), [("jump\n", 1), ("accept\n# a remark\n\nagian elbow\n", 4)]
)
def test_calibration_script_error_names_line(tmp_path, text, line):
    path = tmp_path / "script"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_script(path)
    assert caught.value.where == f"line {line}"


def test_calibration_script_accepts_old_command_names(tmp_path):
    path = tmp_path / "script"
    path.write_text("again elbow\nfree wrist\ncontinuous wrist\n")
    assert read_script(path) == ["remeasure elbow", "continuous wrist", "continuous wrist"]


def test_scripted_accept_without_effect_is_repeated_later():
    state, script = swept().state, ScriptedAnswers()
    answers = [answer_at(script, state, at_s) for at_s in (5.0, 6.01, 6.02, 6.5, 7.03)]
    assert answers == [None, "accept", None, None, "accept"]


def test_one_narrow_sweep_of_several_needs_4_s_wait():
    hand = Hand(subject(), subject("wrist", 2)).rest().accept()
    hand.move(1000, 1).move(-2000, 1).move(500, 2).move(-1000, 2)
    assert answered_at(hand, ScriptedAnswers()) == (pytest.approx(4.0, abs=0.03), "accept")
