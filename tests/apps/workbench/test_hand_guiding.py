"""Hand guiding: a hand moves an arm that carries its own weight; judged at its joints."""

import contextlib

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.hand_guiding import ANCHOR_RAD, guide_by_hand
from ikservo.errors import CalibrationError, RefusedError, StoppedError
from servosim.joint import Hand, glide
from tests.arm.simulated import context_of, line_of, registers, servo_group

HAND_RAD_S = 0.4
AWAY_S, LEFT_S = 0.7, 3.0  # the arm is alone before the hand comes, and after it has gone


class Guided:
    """Moves one joint by hand, and records what the joints and motors do."""

    def __init__(self, arm, joint, way_rad, limit_nm, rad_s=HAND_RAD_S):
        self._arm, self._joint, self._way_rad = arm, joint, way_rad
        self._limit_nm, self._rad_s = limit_nm, rad_s
        self._world, self._since_s, self._steps = line_of(arm).world, None, [0]
        self.moved_s = abs(way_rad) / rad_s + 0.3
        self.times_s, self.joints, self.torques = [], [], []

    def __call__(self):
        now_s = self._arm.clock.now_s()
        self._since_s = self._since_s or now_s
        time_s = now_s - self._since_s
        joints = [self._world.joint(name) for name in self._arm.chain.names]
        self.times_s.append(time_s)
        self.joints.append([joint.position for joint in joints])
        self.torques.append([sum(s.motor.torque_nm for s in joint.servos) for joint in joints])
        if self._steps == [0] and time_s > AWAY_S:
            self._steps = [1]
            at = self._world.joint(self._joint).position
            path = glide(at, at + self._way_rad, self._rad_s)
            self._world.grasp(self._joint, Hand(path, limit=self._limit_nm))
        if self._steps == [1] and time_s > AWAY_S + self.moved_s:
            self._steps = [2]
            self._world.release(self._joint)
        return time_s > AWAY_S + self.moved_s + LEFT_S

    def between(self, start_s, end_s):
        times = np.array(self.times_s)
        return np.array(self.joints)[(times >= start_s) & (times <= end_s)]

    def drift_deg(self):
        """Return the drift of each joint after the hand released it, degrees."""
        left = self.between(AWAY_S + self.moved_s, np.inf)
        return np.degrees(np.abs(left - left[0]).max(axis=0))

    def moved_deg(self):
        led = self.between(AWAY_S, AWAY_S + self.moved_s)
        return np.degrees(led[-1] - led[0])


def guided(name, joint, way_rad, limit_nm, hidden=""):
    with ikservo.open_arm(name, port=f"sim:?pose=home{hidden}") as arm:
        hand = Guided(arm, joint, way_rad, limit_nm)
        guide_by_hand(arm, hand)
        feed_forward = servo_group(arm).compensator.feed_forward
        gravity = feed_forward.parameters.dynamics.gravity_torques(np.array(hand.joints[-1]))
        drives = feed_forward.parameters.drives
    return hand, gravity, np.array([drive.stiffness_nm_rad for drive in drives])


# The hand's force is what friction under load and the anchor take, and some more to move.
HANDS = [
    ("so101", "elbow_flex", -0.5, 0.6),
    ("so101", "shoulder_pan", 0.5, 0.9),
    ("koch", "elbow_flex", -0.4, 0.2),
    ("open_manipulator_x", "joint3", -0.4, 1.0),
    ("wx250s", "shoulder", 0.3, 3.0),
]


@pytest.mark.full
@pytest.mark.sample(2)
@pytest.mark.parametrize(("name", "joint", "way_rad", "limit_nm"), HANDS)
def test_hand_guided_arm_follows_light_push_and_stays_there(name, joint, way_rad, limit_nm):
    hand, gravity, stiffness = guided(name, joint, way_rad, limit_nm)
    k = ikservo.load_model(name).chain.names.index(joint)
    assert hand.moved_deg()[k] == pytest.approx(np.degrees(way_rad), abs=1.0)
    assert hand.drift_deg().max() < 0.3
    # Its motors give what gravity needs and, at most, what the anchor's tolerance is worth.
    excess = np.abs(np.abs(hand.torques[-1]) - np.abs(gravity))
    assert (excess < 1.3 * ANCHOR_RAD * stiffness).all()


@pytest.mark.full
def test_guided_arm_heavier_than_model_sinks_less_than_2_deg():
    hand, *_ = guided("so101", "elbow_flex", -0.3, 1.0, hidden="&mass_scale=1.2&payload_g=30")
    sunk = hand.between(0.0, AWAY_S)
    assert np.degrees(np.abs(sunk - sunk[0]).max()) < 2.0
    assert hand.drift_deg().max() < 1.0  # the play of its gears


def test_stop_ends_hand_guiding_and_arm_holds():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:

        def stop():
            if arm.clock.now_s() > 2.0:
                arm.stop("Stopped by the test.")
            return False

        with pytest.raises(StoppedError):
            guide_by_hand(arm, stop)
        before = arm.where()
        arm.clock.sleep_until(arm.clock.now_s() + 3.0)
        for then, now in zip(before.joints, arm.where().joints, strict=True):
            assert now.torque
            assert now.position_rad == pytest.approx(then.position_rad, abs=0.01)


@pytest.mark.full
def test_motion_after_hand_guiding_starts_at_guided_position():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        hand = Guided(arm, "elbow_flex", -0.5, 1.0)
        found = guide_by_hand(arm, hand)
        report = arm.move_joints({"wrist_roll": 0.3})
        elbow = arm.where().joints[2].position_rad
        assert report.reached
        assert elbow == pytest.approx(found["elbow_flex"], abs=0.02)


@pytest.mark.full
def test_hand_guiding_goals_stay_inside_limits():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        driven = servo_group(arm).driven_joints[0]
        goals = []

        def push_on():
            goals.append(registers(arm, "goal_position")[driven.servo_id])
            if len(goals) == 20:
                beyond = glide(0.0, driven.limits.upper.value + 0.3, 1.5)
                line_of(arm).world.grasp("shoulder_pan", Hand(beyond, limit=2.0))
            return len(goals) > 500

        with contextlib.suppress(RefusedError):  # it resists there, and may stop and hold
            guide_by_hand(arm, push_on)
        assert max(goals) > driven.tick_range[1] - 20
        low, high = driven.tick_range
        assert low <= min(goals)
        assert max(goals) <= high


def test_hand_guiding_refuses_arm_without_masses(monkeypatch):
    with ikservo.open_arm("planar2", port="sim") as arm:
        servo_group(arm).compensator.feed_forward = None
        with pytest.raises(RefusedError, match="no masses"):
            guide_by_hand(arm, lambda: True)
        assert not any(registers(arm, "torque_enable").values())


def test_hand_guiding_refuses_uncalibrated_arm(monkeypatch):
    with ikservo.open_arm("so101", port="sim") as arm:

        def refuse(_):
            raise CalibrationError("so101 is not calibrated.")

        monkeypatch.setattr(type(context_of(arm).zeros), "require_known", lambda *a: refuse(a))
        with pytest.raises(CalibrationError):
            guide_by_hand(arm, lambda: True)
        assert not any(registers(arm, "torque_enable").values())
