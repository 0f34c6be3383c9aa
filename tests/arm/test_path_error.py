"""Path error, compared with a computation by hand and with the simulated joints."""

import numpy as np
import pytest

import ikservo
from ikservo.control.loop import ControlCycle
from ikservo.motion import ConcatenatedTrajectory, JointMove, KinematicLimits
from ikservo.planning.path_error import PathRecorder, path_deviations_m
from tests.arm.simulated import true_tip_m

LIMITS = KinematicLimits(1.0, 3.0, 30.0)
TIMES_S = np.linspace(0.0, 2.0, 201)
LINE_M = np.outer(TIMES_S, (0.1, 0.0, 0.0))


def test_path_error_is_the_perpendicular_distance():
    points = np.array([[0.05, 0.003, 0.004], [0.1234, 0.0, -0.002]])
    found = path_deviations_m((np.array([0.5, 1.234]), points), (TIMES_S, LINE_M))
    np.testing.assert_allclose(found, [0.005, 0.002], rtol=1e-9)


def test_lag_along_the_path_is_not_path_error():
    found = path_deviations_m((TIMES_S, LINE_M - (0.0099, 0, 0)), (TIMES_S, LINE_M))
    np.testing.assert_allclose(found[11:], 0.0, atol=1e-12)


def test_path_error_beyond_an_end_is_distance_to_that_end():
    points = np.array([[-0.01, 0.0, 0.0], [0.21, 0.0, 0.0]])
    found = path_deviations_m((np.array([0.0, 2.0]), points), (TIMES_S, LINE_M))
    np.testing.assert_allclose(found, [0.01, 0.01])


def test_path_error_ignores_later_part_of_self_crossing_path():
    back = np.concatenate([LINE_M, LINE_M[::-1] + np.array([0.0, 0.05, 0.0])])
    times_s = np.linspace(0.0, 4.02, len(back))
    on_the_way_back = np.array([[0.1, 0.05, 0.0]])
    assert path_deviations_m((np.array([1.0]), on_the_way_back), (times_s, back)) == (
        pytest.approx(0.05)
    )


def test_path_error_skips_cycles_with_a_missing_reply():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        plan = arm.plan_line((0.2, 0.1, 0.15))
        recorder = PathRecorder(plan.trajectory, plan.cartesian_s)
        at = plan.trajectory.state(0.5).position
        recorder.record(ControlCycle(0.5, plan.duration_s, at, at, at + 0.1, lost=("elbow_flex",)))
        assert recorder.error(arm.context.planner) is None
        recorder.record(ControlCycle(0.5, plan.duration_s, at, at, at))
        assert recorder.error(arm.context.planner).max_m < 1e-5


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "open_manipulator_x"])
def test_path_error_matches_simulated_joints(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        arm.move_joints({arm.joint_names[0]: 0.05})
        plan = arm.plan_line((0.2, 0.1, 0.15))
        start = arm.chain.forward(arm.joint_index.chain_joints(plan.start))[:3, 3]
        tips = []
        report = arm.execute(plan, lambda _: tips.append(true_tip_m(arm)))
    off_m = from_segment_m(np.array(tips), start, plan.tip_m)
    assert report.path_error_rms_m == pytest.approx(np.sqrt((off_m**2).mean()), abs=2e-4)
    assert report.path_error_max_m == pytest.approx(off_m.max(), abs=5e-4)
    assert report.path_error_max_m > 1e-3


def from_segment_m(points, begin, end):
    length = np.linalg.norm(end - begin)
    along = (end - begin) / length
    gone = points - begin
    beside = gone - np.outer(np.clip(gone @ along, 0.0, length), along)
    return np.linalg.norm(beside, axis=1)


def test_path_error_excludes_joint_move_before_the_line():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        line = arm.plan_line((0.2, 0.1, 0.15))
        joined = ConcatenatedTrajectory(
            JointMove(line.start + 0.2, line.start, [LIMITS] * len(line.start)), line.trajectory
        )
        recorder = PathRecorder(joined, line.cartesian_s)
        for time_s in np.linspace(0.0, joined.duration_s, 500).tolist():
            at = joined.state(time_s).position
            recorder.record(ControlCycle(time_s, joined.duration_s, at, at, at))
        assert recorder.error(arm.context.planner).max_m < 1e-4


@pytest.mark.campaign
def test_move_to_result_has_no_path_error_value():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        assert arm.move_to((0.2, 0.1, 0.15)).path_error_rms_m is None
