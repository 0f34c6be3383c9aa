"""The filter from hands to joint goals: nothing moves at the clutch, and no step is too large."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.apps.teleoperating.pose_filter import TABLE, PoseFilter, TrackedPose
from ikservo.errors import BadValueError
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose
from ikservo.model.tool import tool_frame
from ikservo.motion import KinematicLimits
from tests.apps.teleoperating.hands import AWAY_M, Hand
from tests.journeys.command_arguments import usual_target_m
from tests.oracle import ARMS as ALL_ARMS

ARMS = ("so101", "koch", "open_manipulator_x", "wx250s")
CYCLE_S = 0.01
LIMITS = KinematicLimits(1.5, 8.0, 80.0)
SINGULAR_M_RAD = 0.04  # the motion of the tip per radian below which the goal slows down
FINISH = 400  # cycles in which a resting hand is reached

every_arm = pytest.mark.parametrize("name", ARMS)


class Follower:
    """A filter with its goal and its clock, as an arm would use it."""

    def __init__(self, name, scale=1.0):
        model = ikservo.load_model(name)
        self.chain, self.axis = model.chain, tool_frame(model).approach_axis
        self.filter = PoseFilter(self.chain, self.axis, [LIMITS] * self.chain.dof, scale)
        self.q = ikservo.solve(model, ikservo.Target(usual_target_m(name))).q
        self.time_s = 0.0
        self.steps = []

    def step(self, tracked):
        self.time_s += CYCLE_S
        q = self.filter.step(tracked, self.q, self.time_s)
        assert np.isfinite(q).all()
        assert (q >= self.chain.lower_rad - 1e-9).all()
        assert (q <= self.chain.upper_rad + 1e-9).all()
        self.steps.append(np.abs(q - self.q).max())
        assert self.steps[-1] <= LIMITS.speed_rad_s * 5 * CYCLE_S + 1e-9
        self.q = q
        return q

    def hold(self, T, cycles=FINISH):
        """Rest with the hand at a pose."""
        for _ in range(cycles):
            self.step(TrackedPose(T))
        return self

    def tip(self):
        return self.chain.forward(self.q)


def hand_at(shift_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)):
    return make_pose(AWAY_M + shift_m, exp_so3(np.array(turn_rad)))


def angle_rad(one, two):
    return float(np.linalg.norm(log_so3(one @ two.T)))


@every_arm
def test_closing_clutch_moves_no_joint(name):
    follower, hand = Follower(name), Hand(1)
    before = follower.q
    for held in (True, False, True, False):
        follower.step(hand.tracked(follower.time_s, held=held))
        hand = Hand(hand.seed + 1, span_m=0.4, span_rad=1.5)
    np.testing.assert_allclose(follower.q, before, atol=1e-6)


@every_arm
@pytest.mark.parametrize("scale", [0.25, 1.0, 2.0])
def test_tip_motion_is_hand_motion_times_scale(name, scale):
    follower = Follower(name, scale)
    before, shift_m = follower.tip()[:3, 3], np.array([-0.012, 0.01, 0.012])
    follower.hold(hand_at(), 2).hold(hand_at(shift_m))
    np.testing.assert_allclose(follower.tip()[:3, 3] - before, scale * shift_m, atol=2e-4)
    np.testing.assert_allclose(follower.filter.wanted[:3, 3], follower.tip()[:3, 3], atol=2e-4)


@pytest.mark.parametrize("seed", range(8))
def test_six_joint_arm_follows_hand_rotation(seed):
    follower = Follower("wx250s")
    before = follower.tip()[:3, :3]
    turn_rad = np.random.default_rng(seed).uniform(-0.3, 0.3, 3)
    follower.hold(hand_at(), 2).hold(hand_at(turn_rad=turn_rad))
    assert angle_rad(follower.tip()[:3, :3], exp_so3(turn_rad) @ before) < 0.01


@pytest.mark.parametrize("name", ["so101", "koch"])
@pytest.mark.parametrize("seed", range(8))
def test_five_joint_arm_follows_hand_position_axis_and_roll(name, seed):
    """The position is exact, the direction the nearest in the arm's plane, the roll the hand's."""
    random = np.random.default_rng(seed)
    shift_m, turn_rad = random.uniform(-0.02, 0.02, 3), random.uniform(-0.4, 0.4, 3)
    follower = Follower(name)
    before = follower.tip()
    follower.hold(hand_at(), 2).hold(hand_at(shift_m, turn_rad))
    T, wanted = follower.tip(), exp_so3(turn_rad) @ before[:3, :3]
    np.testing.assert_allclose(T[:3, 3], before[:3, 3] + shift_m, atol=2e-4)
    normal = np.cross(T[:3, :3] @ follower.axis, [0.0, 0.0, 1.0])
    normal /= np.linalg.norm(normal)
    direction = wanted @ follower.axis
    along = direction - normal * (normal @ direction)
    along /= np.linalg.norm(along)
    assert T[:3, :3] @ follower.axis @ along > math.cos(0.01)
    axis = np.cross(direction, along)
    angle = math.atan2(np.linalg.norm(axis), direction @ along)
    swing = exp_so3(axis / max(np.linalg.norm(axis), 1e-12) * angle)
    assert angle_rad(T[:3, :3], swing @ wanted) < 0.02


@every_arm
@pytest.mark.parametrize("seed", range(3))
def test_hand_goal_steps_are_bounded_for_random_motion(name, seed):
    follower, random = Follower(name), np.random.default_rng(seed)
    hand = Hand(seed, span_m=0.5, span_rad=4.0, fastest_hz=3.0, noise_m=0.003, noise_rad=0.02)
    for cycle in range(1500):
        tracked = hand.tracked(follower.time_s, held=cycle // 40 % 3 != 2)
        follower.step(tracked if random.random() < 0.6 else None)
        assert follower.steps[-1] <= LIMITS.speed_rad_s * CYCLE_S + 1e-9


@pytest.mark.sample(4)
@pytest.mark.parametrize("name", ALL_ARMS)
def test_arm_follows_slow_hand_or_reports_its_limit(name):
    follower, hand = Follower(name), Hand(7, span_m=0.02, span_rad=0.2)
    wanted = follower.tip()[:3, 3] - hand.state(0.0)[:3]
    for _ in range(300):
        follower.step(hand.tracked(follower.time_s + CYCLE_S))
    shown = follower.filter.is_out_of_reach or follower.filter.limit
    wanted = wanted + hand.state(follower.time_s)[:3]
    near = np.linalg.norm(follower.tip()[:3, 3] - wanted) < 0.02
    assert near or shown


@every_arm
def test_hand_returning_from_out_of_reach_causes_no_jump(name):
    follower = Follower(name)
    before, q = follower.tip(), follower.q
    out = [0.6 * min(1.0, k / 150) for k in range(200)]
    for x_m in (*out, *reversed(out)):
        follower.step(TrackedPose(hand_at((x_m, 0.0, 0.0))))
        assert follower.steps[-1] <= LIMITS.speed_rad_s * CYCLE_S + 1e-9
        if x_m == 0.6:
            assert follower.filter.is_out_of_reach
    follower.hold(hand_at())
    np.testing.assert_allclose(follower.tip()[:3, 3], before[:3, 3], atol=1e-3)
    assert np.abs(follower.q - q)[1:3].max() < 0.3  # the elbow bends to the same side


@every_arm
def test_clutch_closed_out_of_reach_follows_hand_at_once(name):
    follower = Follower(name)
    follower.hold(hand_at(), 2)
    for k in range(200):
        follower.step(TrackedPose(hand_at((0.003 * k, 0.0, 0.0))))
    follower.step(TrackedPose(hand_at((0.6, 0.0, 0.0)), held=False))
    before = follower.tip()[:3, 3]
    follower.hold(hand_at(), 2)
    follower.hold(hand_at((-0.03, 0.0, 0.0)))
    np.testing.assert_allclose(follower.tip()[:3, 3] - before, (-0.03, 0.0, 0.0), atol=2e-3)


@every_arm
def test_hand_goal_slows_down_near_singular_posture(name):
    """The tip is pulled to the edge of the reach, where the stretched arm is nearly singular."""
    follower, slowed = Follower(name), []
    follower.hold(hand_at(), 2)
    for k in range(400):
        moved = 0.5 * min(1.0, k / 100)
        sizes = np.linalg.svd(follower.chain.jacobian(follower.q)[:3], compute_uv=False)
        slowed.append(min(1.0, max(0.2, sizes[-1] / SINGULAR_M_RAD)))
        follower.step(TrackedPose(hand_at((moved, 0.3 * math.sin(0.1 * k), 0.0))))
        assert follower.steps[-1] <= LIMITS.speed_rad_s * CYCLE_S * slowed[-1] + 1e-9
    assert min(slowed) < 0.8


@every_arm
@pytest.mark.parametrize(
    "jump",
    [
        hand_at((0.07, 0.0, 0.0)),
        hand_at((0.5, 0.0, 0.0)),
        hand_at(turn_rad=(0.0, 0.0, math.pi)),
    ],
    ids=["7 cm", "0.5 m", "180°"],
)
def test_hand_tracking_jump_moves_nothing(name, jump):
    follower = Follower(name)
    follower.hold(hand_at(), 50)
    before = follower.q
    follower.hold(jump, 1)
    assert follower.filter.limit == "jump"
    follower.hold(jump, 30).hold(hand_at(), 30)
    np.testing.assert_allclose(follower.q, before, atol=1e-6)


@every_arm
def test_hand_goal_stops_when_poses_no_longer_arrive(name):
    follower = Follower(name)
    for k in range(40):
        follower.step(TrackedPose(hand_at((0.0, 0.004 * k, 0.0))))
    moved = [follower.step(None) for _ in range(100)]
    np.testing.assert_array_equal(moved[10], moved[-1])
    assert follower.filter.wanted is None


def test_refused_hand_goals_lift_tip_by_1_cm_at_most():
    follower = Follower("so101")
    follower.hold(hand_at(), 2).hold(hand_at((0.0, 0.0, -0.02)))
    before_m, kept, tips_m = follower.tip()[2, 3], follower.q, []
    for cycle in range(300):
        follower.step(TrackedPose(hand_at((0.0, 0.0, -0.02))))
        if cycle < 60 or cycle % 2:
            follower.filter.on_rejected(("gripper", TABLE), kept)
            follower.q = kept
        kept = follower.q
        tips_m.append(follower.tip()[2, 3])
    assert 0.002 < max(tips_m) - before_m < 0.011
    follower.hold(hand_at())
    np.testing.assert_allclose(follower.tip()[2, 3], before_m + 0.02, atol=1e-3)


def test_hand_motion_during_tracking_gap_is_ignored():
    follower = Follower("so101").hold(hand_at(), 20)
    before = follower.q
    follower.time_s += 0.35
    follower.hold(hand_at((0.0, 0.1, 0.0), (0.0, 0.0, 0.4)), 100)
    np.testing.assert_allclose(follower.q, before, atol=1e-6)


def test_wrist_at_its_limit_does_not_unwind_by_a_full_turn():
    follower = Follower("so101")
    axis = follower.tip()[:3, :3] @ follower.axis
    rolled = [follower.q[4]]
    for k in range(700):
        follower.step(TrackedPose(hand_at(turn_rad=0.01 * k * axis)))
        rolled.append(follower.q[4])
        if k == 400:
            assert follower.filter.limit == "wrist_roll at its limit"
    assert follower.filter.limit in {"turn", "wrist_roll at its limit"}
    assert np.ptp(rolled) > 2.7
    assert np.abs(np.diff(rolled)).sum() < 1.2 * np.ptp(rolled)


def test_hand_tracking_noise_moves_tip_by_less_than_1_5_mm():
    follower = Follower("so101")
    hand = Hand(3, span_m=0.0, span_rad=0.0, noise_m=0.001, noise_rad=0.003)
    tips = []
    for cycle in range(400):
        follower.step(hand.tracked(0.0) if cycle % 2 == 0 else None)
        tips.append(follower.tip()[:3, 3])
    assert np.std(tips[50:], axis=0).max() < 0.0015


@pytest.mark.parametrize(
    "pose",
    [
        np.full((4, 4), math.nan),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.zeros((3, 3)),
        "hand",
    ],
)
def test_invalid_tracked_pose_is_refused(pose):
    with pytest.raises(BadValueError):
        TrackedPose(pose)


@every_arm
def test_hand_pose_with_rounded_rotation_is_followed(name):
    follower = Follower(name)
    before = follower.tip()
    rounded = hand_at((0.0, 0.01, 0.0), (0.0, 0.1, 0.0))
    rounded[:3, :3] += 4e-4 * np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3))
    follower.hold(hand_at(), 2).hold(rounded, 100)
    np.testing.assert_allclose(follower.tip()[:3, 3] - before[:3, 3], (0.0, 0.01, 0.0), atol=2e-3)
    R = TrackedPose(rounded).matrix[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("scale", [0.0, 0.2, 2.1, math.nan, "1"])
def test_hand_motion_scale_out_of_range_is_refused(scale):
    with pytest.raises(BadValueError):
        Follower("so101", scale)
