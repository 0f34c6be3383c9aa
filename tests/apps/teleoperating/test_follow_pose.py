"""Simulated arms follow hands with every error of a tracker; true joints and registers judge."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.apps.teleoperating.pose_filter import TrackedPose
from ikservo.errors import BadValueError, StoppedError
from ikservo.guard import StopKind, StopReason
from ikservo.kinematics.se3 import exp_so3
from tests.apps.teleoperating.hands import AWAY_M, Hand, sampled
from tests.arm.audit import Auditor
from tests.arm.simulated import line_of, motion_limits, registers, servo_id, true_joints
from tests.journeys.command_arguments import usual_target_m
from tests.oracle import tip_from_joints

ARMS = ("so101", "koch", "open_manipulator_x", "wx250s")
# Starts away from the limits of wrists, and where a slow first joint is fast enough.
START_RAD = {"koch": {"shoulder_lift": -0.08, "elbow_flex": 0.38, "wrist_flex": 1.11}}
START_M = {"wx250s": (0.36, 0.03, 0.25)}
RATE_HZ = 60.0
MAX_STEP_RAD = math.radians(2.0)
HOLDS_S = 0.3
STILL_RAD_S = 0.02

every_arm = pytest.mark.parametrize("name", ARMS)


class Session:
    """An arm at a start within its reach, and a record of everything that it did.

    Attributes:
        time_s: The times of the cycles since the hand began to move.
        reference: The references of the joints (cycles, n).
        joints: The true joints, from the registers of the servos.
        tip_m: The true tip (cycles, 3).
    """

    def __init__(self, name):
        self.name = name
        self.arm = ikservo.open_arm(name, port="sim:?pose=home")

    def __enter__(self):
        self.arm.__enter__()
        if self.name in START_RAD:
            self.arm.move_joints(START_RAD[self.name], speed="fast")
        else:
            self.arm.move_to(START_M.get(self.name, usual_target_m(self.name)), speed="fast")
        self.auditor = Auditor(self.arm)
        self.speeds = np.array([m.speed_rad_s for m in motion_limits(self.arm, "fast")])
        return self

    def __exit__(self, *error):
        self.arm.__exit__(*error)

    def follow(self, tracked, duration_s, rate_hz=RATE_HZ, **options):
        """Follow a hand; return the result."""
        rows, clock, start_s = [], self.arm.clock, []

        def timed(time_s):
            start_s.append(clock.now_s() - time_s)
            return tracked(time_s)

        def record(progress):
            joints = true_joints(self.arm)
            tip_m = tip_from_joints(self.name, joints)
            rows.append((clock.now_s(), progress.setpoints_rad, [*joints.values()], tip_m))

        poses = sampled(clock, rate_hz, duration_s, timed)
        options = {"speed": "fast", **options}
        result = self.arm.follow_pose(poses, on_progress=record, **options)
        times_s, self.reference, self.joints, self.tip_m = map(np.array, zip(*rows, strict=True))
        self.time_s = times_s - start_s[0]
        return result

    def check(self):
        """Check that no goal left the limits, and no joint was faster than its speed."""
        assert self.auditor.faults() == []
        elapsed_s = np.diff(self.time_s)[:, None]
        assert (
            np.abs(np.diff(self.reference, axis=0)) <= 1.02 * self.speeds * elapsed_s + 1e-6
        ).all()
        lower, upper = self.arm.limits()
        assert (self.reference >= lower - 1e-6).all()
        assert (self.reference <= upper + 1e-6).all()

    def speed_rad_s(self, since_s, until_s=math.inf):
        """Return the largest speed of a reference in a span of time."""
        span = (self.time_s >= since_s) & (self.time_s <= until_s)
        return float(
            np.abs(
                np.diff(self.reference[span], axis=0) / np.diff(self.time_s[span])[:, None]
            ).max()
        )


@pytest.fixture
def session(request):
    with Session(request.param) as opened:
        yield opened


arms = pytest.mark.parametrize("session", ARMS, indirect=True)


def circle(radius_m=0.04, speed_m_s=0.1, begin_s=0.5):
    """Return the pose of a hand that moves along a circle, at a constant speed after its start."""

    def displacement_m(time_s):
        moving_s = max(0.0, time_s - begin_s)
        angle = speed_m_s / radius_m * (moving_s - 0.3 * (1.0 - math.exp(-moving_s / 0.3)))
        return radius_m * np.array([math.cos(angle) - 1.0, math.sin(angle), 0.0])

    return displacement_m


def at(shift_m, turn_rad=(0.0, 0.0, 0.0), **fields):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = exp_so3(np.array(turn_rad)), AWAY_M + shift_m
    return TrackedPose(T, **fields)


@arms
@pytest.mark.sample(2)
def test_tip_follows_tracked_hand_at_100_mm_s_within_5_mm(session):
    path_m = circle()
    session.follow(lambda time_s: at(path_m(time_s)), 4.0)
    session.check()
    wanted_m = session.tip_m[0] + np.array([path_m(time_s) for time_s in session.time_s])
    moving = (session.time_s > 1.5) & (session.time_s < 3.9)
    error_m = np.linalg.norm(session.tip_m - wanted_m, axis=1)[moving]
    assert math.sqrt((error_m**2).mean()) <= 0.005
    assert error_m.max() <= 0.012


def reclutched(hand, count, held_s=0.25, open_s=0.1):
    """Return the items of a hand that closes and opens its clutch; it leaps while it is open."""
    random = np.random.default_rng(hand.seed)
    away_m = random.uniform(-0.3, 0.3, (count + 1, 3))
    turned = [exp_so3(each) for each in random.uniform(-2.0, 2.0, (count + 1, 3))]

    def tracked(time_s):
        number, phase_s = divmod(time_s, held_s + open_s)
        T = hand.pose(time_s)
        T[:3, 3] += away_m[int(number)]
        T[:3, :3] = turned[int(number)] @ T[:3, :3]
        return TrackedPose(T, held=phase_s < held_s)

    return tracked, count * (held_s + open_s)


@arms
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "count", [30, pytest.param(200, marks=pytest.mark.campaign)], ids="{} re-clutches".format
)
def test_clutch_closed_again_moves_joints_below_2_deg_per_step(session, count):
    hand = Hand(5, span_m=0.05, span_rad=0.4, fastest_hz=0.7, noise_m=5e-4, noise_rad=2e-3)
    tracked, duration_s = reclutched(hand, count)
    session.follow(tracked, duration_s)
    session.check()
    assert np.abs(np.diff(session.joints, axis=0)).max() <= MAX_STEP_RAD
    assert np.ptp(session.joints, axis=0).max() > math.radians(5.0)


def lost(hand, _late_s):
    return None


def jumped(hand, late_s, size_m=0.5, turn_rad=0.0):
    """Return a pose that jumps back and forth five times a second."""
    T = hand.pose(ERROR_S)
    if int(late_s * 5.0) % 2 == 0:
        T[:3, 3] += size_m
        T[:3, :3] = exp_so3(np.array([0.0, 0.0, turn_rad])) @ T[:3, :3]
    return TrackedPose(T)


def flipped(hand, late_s):
    return jumped(hand, late_s, 0.0, math.pi)


def frozen(hand, _late_s):
    return hand.tracked(ERROR_S)


ERROR_S = 1.45  # not the time of a pose
ERRORS = (lost, jumped, flipped, frozen)


@arms
@pytest.mark.sample(4)
@pytest.mark.parametrize("rate_hz", [10.0, 60.0])
@pytest.mark.parametrize("error", ERRORS)
def test_arm_holds_within_300_ms_after_hand_tracking_error(session, error, rate_hz):
    hand = Hand(2)

    def tracked(time_s):
        return hand.tracked(time_s) if time_s < ERROR_S else error(hand, time_s - ERROR_S)

    result = session.follow(tracked, 3.0, rate_hz)
    session.check()
    # The error is known when the next pose is due; a frozen hand, when its pose is repeated.
    known_s = (math.ceil(ERROR_S * rate_hz) + (error is frozen)) / rate_hz
    assert session.speed_rad_s(0.5, ERROR_S) > 0.1
    assert session.speed_rad_s(known_s + HOLDS_S, 2.9) < STILL_RAD_S
    assert result.ended == ("no pose for 0.3 s" if error is lost else "end of the poses")
    assert all(registers(session.arm, "torque_enable").values())


@arms
@pytest.mark.sample(2)
@pytest.mark.parametrize("rate_hz", [10.0, 90.0])
@pytest.mark.parametrize("seed", range(3))
def test_random_hand_motion_keeps_goals_inside_limits(session, seed, rate_hz):
    hand = Hand(seed, span_m=0.6, span_rad=5.0, fastest_hz=2.5, noise_m=0.003, noise_rad=0.03)
    session.follow(hand.tracked, 4.0, rate_hz, scale=2.0)
    session.check()
    assert np.abs(np.diff(session.joints, axis=0)).max() <= MAX_STEP_RAD


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_tip_slides_along_table_if_hand_moves_below_it(session):
    def tracked(time_s):
        down_m = np.interp(time_s, (0.0, 1.5, 3.5, 5.0), (0.0, 0.3, 0.3, 0.0))
        aside_m = np.interp(time_s, (2.0, 3.0, 3.5, 4.0), (0.0, 0.06, 0.06, 0.0))
        return at((0.0, aside_m, -down_m))

    result = session.follow(tracked, 6.0)
    session.check()
    before_m, shift_m = session.tip_m[0], session.tip_m - session.tip_m[0]
    below = (session.time_s > 2.0) & (session.time_s < 3.5)
    assert result.refused > 0
    assert session.tip_m[:, 2].min() > -0.005
    assert session.tip_m[below, 2].max() < min(0.05, before_m[2] - 0.02)
    assert shift_m[session.time_s < 3.45][-1][1] == pytest.approx(0.06, abs=0.01)
    np.testing.assert_allclose(session.tip_m[-1], before_m, atol=0.01)


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_gripper_follows_commanded_opening_of_hand(session):
    session.follow(lambda time_s: at((0.0, 0.0, 0.0), opening=1.0), 2.5)
    session.check()
    gripper = session.arm.model.gripper
    assert true_joints(session.arm)[gripper.joint] == pytest.approx(gripper.open, abs=0.06)


def test_hand_following_is_slow_in_first_second_after_torque_on():
    def tracked(time_s):
        aside_m = np.interp(time_s, (0.0, 0.3, 1.6, 2.0), (0.0, 0.06, 0.06, -0.04))
        return at((0.0, aside_m, 0.0))

    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        rows, slow = [], np.array([m.speed_rad_s for m in motion_limits(arm, "slow")])
        arm.follow_pose(
            sampled(arm.clock, RATE_HZ, 2.0, tracked),
            speed="fast",
            on_progress=lambda at: rows.append((at.elapsed_s, *at.setpoints_rad)),
        )
    times_s, speeds = np.array(rows)[1:, 0], np.diff(np.array(rows), axis=0)
    speeds = np.abs(speeds[:, 1:]) / speeds[:, :1]
    assert (speeds[times_s < 0.95] <= 1.05 * slow).all()
    assert (speeds[times_s > 1.5] > 1.05 * slow).any()


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_gripper_does_not_move_while_clutch_is_open(session):
    before = true_joints(session.arm)[session.arm.model.gripper.joint]
    session.follow(lambda _: at((0.0, 0.0, 0.0), held=False, opening=1.0), 1.0)
    after = true_joints(session.arm)[session.arm.model.gripper.joint]
    assert after == pytest.approx(before, abs=0.02)


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_goal_stays_close_to_blocked_gripper(session):
    gripper, arm = session.arm.model.gripper, session.arm
    line_of(arm).servos[servo_id(session.name, gripper.joint)].motor.stuck = True
    session.follow(lambda _: at((0.0, 0.0, 0.0), opening=1.0), 1.5)
    lead = abs(session.reference[-1] - session.joints[-1])[arm.joint_index.column(gripper.joint)]
    assert lead < 0.1 * abs(gripper.open - gripper.closed)


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_invalid_hand_pose_brakes_arm_and_raises_error(session):
    def tracked(time_s):
        return np.full((4, 4), math.nan) if time_s > 0.5 else at((0.0, 0.1 * time_s, 0.0))

    with pytest.raises(BadValueError):
        session.follow(tracked, 1.0)
    assert all(registers(session.arm, "torque_enable").values())
    session.arm.move_to(usual_target_m(session.name))


@pytest.mark.parametrize("session", ["so101"], indirect=True)
def test_stop_during_hand_following_makes_arm_hold(session):
    def tracked(time_s):
        if time_s > 0.5:
            session.arm.request_stop(StopReason(StopKind.PROGRAM, "enough"))
        return at((0.0, 0.1 * time_s, 0.0))

    with pytest.raises(StoppedError, match="enough"):
        session.follow(tracked, 2.0)
    assert all(registers(session.arm, "torque_enable").values())
