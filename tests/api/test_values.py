"""The API returns arrays and mappings by joint name, with a short representation."""

import csv
import io
import math

import numpy as np
import pytest

import ikservo
from ikservo.arm import ArmState
from tests.arm.simulated import true_joints, true_tip_m
from tests.oracle import arm_file

NEAR = (0.23, 0.02, 0.10)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


@pytest.fixture(scope="module")
def still():
    """Return an arm that no test of this module moves."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


def test_where_method_returns_positions_in_order_of_names(still):
    here = still.where()
    assert here.names == tuple(joint["name"] for joint in arm_file("so101")["joints"])
    true = [true_joints(still)[name] for name in here.names]
    np.testing.assert_allclose(here.positions_rad, true, atol=0.005)  # a limp arm sinks
    assert (here.lower_rad < here.positions_rad).all()
    assert (here.positions_rad < here.upper_rad).all()


@pytest.mark.parametrize(
    "array", ["temperatures_c", "voltages_v", "loads_percent", "torque", "lower_rad", "upper_rad"]
)
def test_where_method_arrays_have_one_element_per_joint(still, array):
    assert getattr(still.where(), array).shape == (6,)


def test_where_result_is_indexed_by_joint_name(still):
    here = still.where()
    assert here["elbow_flex"] is here.by_name["elbow_flex"] is here.joints[2]
    assert here.positions["elbow_flex"] == here["elbow_flex"].position_rad
    with pytest.raises(ikservo.UnknownNameError, match="elbow_flex"):
        _ = here["elbow"]


@pytest.mark.full
def test_positions_returned_by_where_are_valid_motion_targets(arm):
    there = arm.where().positions
    arm.move_to(NEAR)
    assert arm.move_joints(there).reached
    back = list(arm.where().positions.values())
    np.testing.assert_allclose(back, list(there.values()), atol=0.02)


def test_where_method_returns_tip_position_and_orientation(still):
    here = still.where()
    T = still.chain.forward(here.positions_rad[: still.chain.dof])
    np.testing.assert_allclose(here.orientation, T[:3, :3])
    np.testing.assert_allclose(here.tip_m, T[:3, 3])


def test_load_that_servo_does_not_report_is_nan():
    state = ikservo.arm.JointState("a", 0.0, -1.0, 1.0, "arm file", 25.0, 7.4, None, torque=True)
    assert math.isnan(ArmState(np.zeros(3), (state,)).loads_percent[0])


@pytest.mark.full
def test_progress_has_measured_joints_and_setpoints(arm):
    seen = []
    arm.move_to(NEAR, on_progress=seen.append)
    last = seen[-1]
    assert last.names == arm.where().names
    assert last.joints_rad.shape == last.setpoints_rad.shape == (6,)
    assert last.positions == dict(zip(last.names, last.joints_rad.tolist(), strict=True))
    np.testing.assert_allclose(last.tip_m, true_tip_m(arm), atol=0.01)


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "motion",
    [
        lambda arm, seen: arm.follow([{"shoulder_pan": 0.1}] * 3, on_progress=seen.append),
        lambda arm, seen: arm.gripper("open", on_progress=seen.append),
        lambda arm, seen: arm.move_joints({"shoulder_pan": 0.1}, on_progress=seen.append),
    ],
)
def test_every_motion_type_reports_its_joints_in_progress(arm, motion):
    seen = []
    motion(arm, seen)
    assert all(progress.joints_rad.shape == (6,) for progress in seen)


@pytest.mark.full
def test_progress_arrays_do_not_change_in_later_cycles(arm):
    seen = []
    arm.move_joints({"shoulder_pan": 0.4}, on_progress=seen.append)
    assert seen[0].joints_rad[0] < 0.1
    assert seen[-1].joints_rad[0] > 0.35


def test_a_plan_is_sampled_from_its_start_to_its_end(still):
    plan = still.plan_to(NEAR)
    sampled = plan.sample(0.02)
    assert sampled.names == plan.names
    assert sampled.positions.shape == sampled.velocities.shape == (len(sampled), 6)
    np.testing.assert_allclose(sampled.positions[[0, -1]], [plan.start, plan.goal], atol=1e-9)
    assert sampled.times_s[-1] == plan.duration_s
    assert (np.diff(sampled.times_s) > 0.0).all()


def test_sampled_velocities_match_derivative_of_positions(still):
    sampled = still.plan_to(NEAR).sample(0.002)
    slopes = np.gradient(sampled.positions, sampled.times_s, axis=0)
    np.testing.assert_allclose(sampled.velocities[2:-2], slopes[2:-2], atol=0.01)


def test_trajectory_joint_is_found_by_name(still):
    sampled = still.plan_joints({"shoulder_pan": 0.3}).sample()
    assert sampled.joint("shoulder_pan")[-1] == pytest.approx(0.3, abs=1e-3)
    with pytest.raises(ikservo.UnknownNameError, match="shoulder_pan"):
        sampled.joint("pan")


@pytest.mark.parametrize("dt_s", [0.0, -0.1, math.nan, 1e-9, "often"])
def test_plan_sample_refuses_invalid_time_step(still, dt_s):
    with pytest.raises(ikservo.BadValueError, match="between two samples"):
        still.plan_to(NEAR).sample(dt_s)


def test_plan_to_current_position_has_one_or_two_samples(still):
    here = still.where().positions
    assert 1 <= len(still.plan_joints({"wrist_roll": here["wrist_roll"]}).sample()) <= 2


def test_plan_csv_names_columns_and_units(still, tmp_path):
    plan, path = still.plan_to(NEAR), tmp_path / "plan.csv"
    text = plan.to_csv(path, 0.05)
    assert path.read_text() == text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [float(rows[-1][f"{name}_rad"]) for name in plan.names] == pytest.approx(plan.goal)
    assert {"t_s", "elbow_flex_rad", "elbow_flex_rad_s"} <= rows[0].keys()


def test_csv_of_sliding_joint_is_in_metres():
    with ikservo.open_arm("open_manipulator_x", port="sim") as arm:
        header = arm.plan_joints({"gripper": 0.0}).to_csv().splitlines()[0]
    assert "gripper_m,gripper" not in header
    assert "gripper_m" in header
    assert "gripper_m_s" in header


def test_csv_file_is_overwritten_only_if_asked(still, tmp_path):
    plan, path = still.plan_to(NEAR), tmp_path / "plan.csv"
    plan.to_csv(path)
    with pytest.raises(ikservo.InputError, match="overwrite=True"):
        plan.to_csv(path)
    plan.to_csv(path, overwrite=True)


def test_recording_is_read_as_arrays_and_written_as_csv(arm, tmp_path):
    arm.record(tmp_path / "still.jsonl", duration_s=0.2)
    recording = ikservo.read_recording(tmp_path / "still.jsonl")
    trajectory = recording.trajectory()
    assert trajectory.positions.shape == (len(recording.times_s), 6)
    assert trajectory.names == arm.where().names
    text = recording.to_csv(tmp_path / "still.csv")
    assert text.count("\n") == 1 + len(trajectory)


@pytest.mark.parametrize(
    "make",
    [
        lambda arm: arm,
        lambda arm: arm.model,
        lambda arm: arm.where(),
        lambda arm: arm.plan_to(NEAR),
        lambda arm: arm.plan_to(NEAR).sample(),
        lambda arm: arm.poses,
        lambda arm: ikservo.Solver(arm.chain),
    ],
)
def test_repr_of_results_is_short_and_without_memory_address(still, make):
    shown = repr(make(still))
    assert len(shown) < 300
    assert " object at 0x" not in shown


def test_repr_of_arm_shows_whether_it_is_open():
    with ikservo.open_arm("so101", port="sim") as arm:
        assert "open" in repr(arm)
    assert "closed" in repr(arm)
