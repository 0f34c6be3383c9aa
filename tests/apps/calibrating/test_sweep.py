"""The conversation of a calibration, without a terminal, a bus or a clock."""

import math
from dataclasses import replace

import pytest

from ikservo.apps.calibrating.by_hand_dialogue import (
    apply_answer,
    possible_answers,
    read_script,
)
from ikservo.apps.calibrating.by_hand_procedure import (
    CalibrationStage,
    CalibrationState,
    joint_readouts,
    warnings,
)
from ikservo.apps.calibrating.calibration_result import find_shifted_zeros
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.homing import TickRange
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.errors import BadValueError, CalibrationError, FileFormatError, UnknownNameError
from ikservo.maintenance.dialogue import JointProgress, ScriptedAnswers

TURN = 4096


def subject(name="elbow", servo_id=1, pose=0.0, lower=-1.5, upper=1.5, **more):
    joint_map = JointMap.revolute(name, servo_id, 1, 2048, TURN)
    expected = Limits.of(name, lower, upper, "arm file")
    return JointUnderCalibration(joint_map, TURN, expected, pose, **more)


class Hand:
    """Moves joints through a calibration and keeps its own clock."""

    def __init__(self, *subjects, start=100, margin_rad=0.0):
        self.state = CalibrationState(subjects, margin_rad)
        self.ticks = {i: start for s in subjects for i in (s.servo_id, *s.shadow_ids)}
        self.at_s = 0.0

    def read(self, times=1):
        for _ in range(times):
            self.at_s += 0.02
            wrapped = {i: tick % TURN for i, tick in self.ticks.items()}
            self.state = self.state.update(self.at_s, wrapped)
        return self

    def rest(self):
        return self.read(30)

    def request(self):
        return possible_answers(self.state, self.at_s)

    def accept(self):
        self.state = self.state.accept()
        return self

    def say(self, word):
        self.state = apply_answer(self.state, word)
        return self

    def move(self, way, *servo_ids, step=100):
        for _ in range(abs(way) // step):
            for i in servo_ids or self.ticks:
                self.ticks[i] += step if way > 0 else -step
            self.read()
        return self


def test_anchor_pose_is_accepted_only_when_arm_is_at_rest():
    hand = Hand(subject())
    for _ in range(40):
        hand.ticks[1] += 10
        hand.read()
    with pytest.raises(CalibrationError, match="still moving"):
        hand.accept()
    assert hand.rest().accept().state.stage is CalibrationStage.SWEEP


def test_reference_tick_is_mean_of_readings_of_unsteady_hand():
    hand = Hand(subject())
    for k in range(40):
        hand.ticks[1] = 500 + (k % 2) * 3
        hand.read()
    assert hand.accept().state.reference_ticks[1] == pytest.approx(501.5, abs=0.1)


def test_zero_comes_from_anchor_pose_not_from_middle_of_sweep():
    hand = Hand(subject(pose=math.pi / 4), start=1000).rest().accept()
    hand.move(-1000)
    assert hand.state.position(hand.state.subjects[0], 1000) == pytest.approx(math.pi / 4)


@pytest.mark.parametrize(("pose", "towards"), [(0.9, -1), (-0.9, 1), (0.0, 1)])
def test_calibration_asks_for_motion_towards_larger_range(pose, towards):
    assert subject(pose=pose).free_direction == towards


def test_first_motion_in_requested_direction_confirms_joint_sign():
    hand = Hand(subject()).rest().accept().move(400)
    assert hand.state.signs == {"elbow": 1}


def test_opposite_joint_sign_is_measured_twice():
    hand = Hand(subject()).rest().accept().move(-400)
    assert hand.state.signs == {}
    assert hand.state.is_second_trial
    with pytest.raises(CalibrationError, match="elbow turned opposite to the direction"):
        hand.accept()
    hand.move(400).move(-400)
    assert hand.state.signs == {"elbow": -1}


def test_joint_moved_wrong_way_once_keeps_arm_file_sign():
    hand = Hand(subject()).rest().accept().move(-400).move(400).move(400)
    assert hand.state.signs == {"elbow": 1}


def test_continued_motion_is_not_a_second_sign_measurement():
    hand = Hand(subject()).rest().accept().move(-1200)
    assert hand.state.signs == {}


@pytest.mark.parametrize(("back", "signs"), [(343, {}), (344, {"elbow": -1})])
def test_joint_must_return_close_to_start_before_second_trial(back, signs):
    # 15 degrees are 170.7 ticks, a third of them 56.9
    hand = Hand(subject()).rest().accept()
    hand.move(-400, step=1).move(back, step=1).move(-400, step=1)
    assert hand.state.signs == signs


def test_remeasuring_joint_clears_doubt_about_its_sign():
    hand = Hand(subject()).rest().accept().move(-400).say("remeasure elbow")
    assert not hand.state.is_second_trial


def test_joint_sign_is_recorded_only_for_requested_joint():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept()
    assert hand.state.current_joint.name == "a"
    hand.move(-800, 2)
    assert hand.state.signs == {}
    hand.move(800, 1)
    assert hand.state.current_joint.name == "b"
    assert hand.state.signs == {"a": 1}


@pytest.mark.parametrize(
    ("requested", "other", "named"), [(0, 200, False), (0, -300, True), (100, 400, False)]
)
def test_joint_that_moves_instead_of_requested_one_is_named(requested, other, named):
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept()
    hand.move(other, 2).move(requested, 1)
    assert (hand.state.moved_instead is not None) == named
    hand.move(800 - requested, 1).move(800, 2)
    assert hand.state.moved_instead is None
    assert hand.state.signs == {"a": 1, "b": 1}


def test_joint_that_goes_on_to_its_ends_is_not_named_instead():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept()
    hand.move(800, 1).move(-1200, 1)
    assert hand.state.current_joint.name == "b"
    assert hand.state.moved_instead is None


def test_swept_range_is_tracked_across_encoder_wrap_around():
    hand = Hand(subject(), start=50).rest().accept().move(900).move(-1900).move(900)
    track = hand.state.tracks[1]
    assert (track.low, track.high) == (50 - 1000, 50 + 900)


def test_sweep_does_not_end_before_every_joint_has_moved():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept().move(900, 1)
    with pytest.raises(CalibrationError, match="b has not been moved yet"):
        hand.accept()


def test_calibration_error_names_joint_that_hardly_moved():
    hand = Hand(subject(), margin_rad=0.5).rest().accept().move(400)
    with pytest.raises(CalibrationError, match="elbow was moved by only 400 ticks"):
        hand.accept()


def test_skipped_joint_is_not_asked_for_and_is_reported():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept().say("skip a").move(1500, 2)
    hand.accept()
    assert hand.state.stage is CalibrationStage.REVIEW
    assert "a was skipped" in " ".join(warnings(hand.state))


def test_unmeasured_joint_is_reported_with_reason():
    hand = Hand(subject("a", 1)).rest().accept()
    assert [*warnings(hand.state.skip("a", "its end stop is beyond the table"))] == [
        "a: its end stop is beyond the table"
    ]


def test_calibration_undo_reverts_answers_one_by_one():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept()
    hand.say("skip a").say("undo")
    assert hand.state.current_joint.name == "a"
    hand.say("undo")
    assert hand.state.stage is CalibrationStage.REFERENCE_POSE
    hand.say("undo")
    assert hand.state.stage is CalibrationStage.REFERENCE_POSE


def test_calibration_undo_drops_wrong_direction_of_joint():
    hand = Hand(subject()).rest().accept().move(-400).say("undo").move(400)
    assert hand.state.signs == {"elbow": 1}


def test_calibration_undo_at_review_resumes_sweep_with_range():
    hand = Hand(subject()).rest().accept().move(900).move(-1900).accept().say("undo")
    assert hand.state.stage is CalibrationStage.SWEEP
    assert hand.state.tracks[1].width == 1900


def test_calibration_undo_at_review_keeps_later_motion():
    hand = Hand(subject()).rest().accept().move(900).move(-1900).accept().move(-200).say("undo")
    assert hand.state.tracks[1].width == 2100


def test_joint_is_skipped_only_during_sweep():
    hand = Hand(subject())
    with pytest.raises(CalibrationError, match="only possible during the sweep"):
        hand.state.skip("elbow")
    reviewed = hand.rest().accept().move(900).move(-1900).accept().state
    with pytest.raises(CalibrationError, match="only possible during the sweep"):
        reviewed.mark_continuous("elbow")


def test_remeasuring_joint_keeps_data_of_other_joints():
    hand = Hand(subject("a", 1), subject("b", 2)).rest().accept().move(900, 1).move(900, 2)
    hand.say("remeasure a")
    assert hand.state.tracks[1].width == 0
    assert hand.state.tracks[2].width == 900
    assert hand.state.current_joint.name == "a"


def test_joint_without_end_stops_uses_wide_arm_file_range():
    hand = Hand(subject(lower=-3.1, upper=3.1)).rest().accept().move(4300).accept()
    assert "turns freely: the arm file's range -177.6° to 177.6° is used" in " ".join(
        warnings(hand.state)
    )


def test_full_turn_is_refused_unless_joint_is_marked_continuous():
    hand = Hand(subject()).rest().accept().move(4300)
    with pytest.raises(CalibrationError, match="full turn"):
        hand.accept()
    assert hand.say("continuous elbow").accept().state.stage is CalibrationStage.REVIEW


def test_joint_turned_too_fast_must_be_remeasured():
    hand = Hand(subject()).rest().accept().move(900).move(-1900, step=100)
    hand.move(1500, step=1500)
    with pytest.raises(CalibrationError, match="moved too fast to count its turns"):
        hand.accept()


@pytest.mark.parametrize(("gap_s", "lost"), [(0.3, False), (0.5, False), (0.7, True)])
def test_turn_count_is_lost_if_gap_allows_an_unseen_turn(gap_s, lost):
    hand = Hand(subject()).rest().accept().move(900).move(-1900, step=100)
    hand.at_s += gap_s
    hand.move(300, step=300)
    assert hand.state.tracks[1].lost is lost


def test_undo_does_not_restore_range_of_lost_turn_count():
    hand = Hand(subject()).rest().accept().move(900).move(-1900, step=100)
    hand.move(1500, step=1500).say("remeasure elbow").say("undo")
    with pytest.raises(CalibrationError, match="moved too fast to count its turns"):
        hand.accept()


def test_swept_range_that_fits_only_mirrored_is_refused():
    lopsided = subject(pose=-1.4, lower=-1.5, upper=1.5)
    hand = Hand(lopsided).rest().accept()
    hand.move(-400).move(400).move(-400).move(400).move(1900)  # both times the wrong way
    with pytest.raises(CalibrationError, match="the wrong way"):
        hand.accept()


def test_full_turn_joint_is_not_checked_for_mirrored_range():
    hand = Hand(subject(lower=-1.0, upper=5.0)).rest().accept()
    hand.move(400).move(-3600).move(4100)  # from -4.9 to 1.4 rad; mirrored it would fit
    assert hand.accept().state.stage is CalibrationStage.REVIEW


def test_servos_of_joint_with_opposite_counts_are_refused():
    hand = Hand(subject(shadow_ids=(2,))).rest().accept()
    for _ in range(15):
        hand.ticks[1] += 100
        hand.ticks[2] -= 100
        hand.read()
    with pytest.raises(CalibrationError, match="Servos 1 and 2 of elbow report different motions"):
        hand.accept()


def test_joint_with_known_range_does_not_need_sweep():
    hand = Hand(subject(known=TickRange(0, 2000))).rest().accept().move(400).accept()
    assert hand.state.stage is CalibrationStage.REVIEW


def test_calibration_readouts_show_progress_of_each_joint():
    hand = Hand(subject("a", 1), subject("b", 2), subject("c", 3)).rest().accept()
    hand.move(900, 1).move(-1900, 1).move(900, 2).say("skip c")
    states = {meter.name: meter.state for meter in joint_readouts(hand.state)}
    assert states == {
        "a": JointProgress.COMPLETE,
        "b": JointProgress.MOVING,
        "c": JointProgress.SKIPPED,
    }


def test_joint_sign_that_contradicts_arm_file_is_reported_early():
    hand = Hand(subject()).rest().accept().move(-900).move(900).move(-900).move(1900).accept()
    assert "elbow: its sign, measured twice, contradicts the arm file" in " ".join(
        warnings(hand.state)
    )


@pytest.mark.parametrize("shift", [-28, -12, 12, 28])
def test_shifted_range_reveals_wrong_anchor_pose(shift):
    zero = round(shift / 360 * TURN)
    hand = Hand(subject(lower=-1.0, upper=1.0)).rest().accept()
    hand.move(700 + zero, step=1).move(-1400, step=1).move(100, step=1)
    (found,) = find_shifted_zeros(hand.accept().state)
    assert math.degrees(found.shift) == pytest.approx(-shift, abs=0.5)
    assert "the zero seems to be off by" in str(found)


@pytest.mark.parametrize(
    ("up", "down"),
    [(650, 1300), (750, 1500), (650, 900), (560, 1200)],
    ids=["exact", "stops beyond both limits", "swept in part", "a few degrees off"],
)
def test_plausible_swept_range_reports_no_zero_shift(up, down):
    hand = Hand(subject(lower=-1.0, upper=1.0)).rest().accept()
    hand.move(up, step=1).move(-down, step=1)
    assert list(find_shifted_zeros(hand.accept().state)) == []


@pytest.mark.parametrize("word", ["jump", "skip", "accept it", ""])
def test_unknown_calibration_answers_are_refused(word):
    with pytest.raises(BadValueError, match="answer"):
        Hand(subject()).rest().accept().say(word)


def test_calibration_answer_for_unknown_joint_lists_known_ones():
    with pytest.raises(UnknownNameError, match="elbow"):
        Hand(subject()).rest().accept().say("skip elbwo")


def scripted(hand, script, moves):
    """Let a script answer while a hand moves the joints; return its answers."""
    messages = []
    moves = iter(moves)
    for _ in range(5000):
        word = script.next_answer(hand.request())
        if word:
            messages.append(word)
            hand.say(word)
        if hand.state.stage is CalibrationStage.REVIEW:
            return messages
        move = next(moves, None)
        hand.move(move) if move else hand.read()
    return messages


def test_default_calibration_script_accepts_pose_and_full_sweep():
    hand = Hand(subject())
    moves = [None] * 60 + [900, -1900, 900]
    assert scripted(hand, ScriptedAnswers(), moves) == ["accept", "accept"]


def test_scripted_calibration_answers_are_given_in_order():
    hand = Hand(subject("a", 1), subject("b", 2))
    script = ScriptedAnswers(["accept", "skip a", "continuous b", "accept"])
    moves = [None] * 60 + [900, -1900]
    assert scripted(hand, script, moves) == ["accept", "skip a", "continuous b", "accept"]


def test_default_calibration_script_times_out_without_motion():
    with pytest.raises(CalibrationError, match="elbow has not been moved yet"):
        scripted(Hand(subject()), ScriptedAnswers(), [])


def test_calibration_script_that_ends_too_early_is_refused():
    with pytest.raises(CalibrationError, match="script ended"):
        scripted(Hand(subject()), ScriptedAnswers(["accept"]), [])


def test_calibration_script_may_contain_comments(tmp_path):
    path = tmp_path / "script"
    path.write_text("accept   # the pose\n\nskip wrist_roll\naccept\n")
    assert read_script(path) == ["accept", "skip wrist_roll", "accept"]


def test_calibration_script_error_states_line_number(tmp_path):
    path = tmp_path / "script"
    path.write_text("accept\nskpi wrist_roll\n")
    with pytest.raises(FileFormatError, match="line 2"):
        read_script(path)


def test_calibration_state_is_immutable():
    hand = Hand(subject()).rest()
    before = hand.state
    hand.accept()
    assert before.stage is CalibrationStage.REFERENCE_POSE
    assert replace(before) == before
