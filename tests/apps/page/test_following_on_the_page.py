"""One arm of the page follows another that is guided by hand; every failure ends that."""

import math

import numpy as np
import pytest

from ikservo.apps.page.messages.page_messages import Acknowledge, FollowArm, Heartbeat, SetSpeed
from ikservo.apps.page.running.follow_lag import LagMeter
from ikservo.apps.page.server.auth import Permission
from ikservo.errors import IkservoError, RefusedError
from ikservo.planning.context import ArmContext
from servosim.faults import Fault
from servosim.joint import Hand, glide
from tests.apps.page.test_served_arms import served
from tests.arm.simulated import line_of, registers, true_joints
from tests.browser.page_operator import until

TURN_RAD = 0.4
STOPPED = "Stopped from the list of arms"


class Pair:
    """A follower with a page in control of it, and a limp leader."""

    def __init__(self, arms):
        self.arms, self.seq = arms, 0
        self.follower, self.leader = (arms.find(name) for name in ("planar3", "planar3-2"))
        self.follower.arm_thread.arm.enable()
        self.page = self.follower.connect(Permission.CONTROL)
        self.say(SetSpeed, "set_speed", name="fast")

    def say(self, kind, word, **fields):
        self.seq += 1
        self.follower.receive(self.page, kind(kind=word, seq=self.seq, seen=0, **fields))

    def follow(self, leader="planar3-2"):
        self.say(FollowArm, "follow_arm", leader=leader)
        return self

    def reported(self):
        """Return the state of following that the page shows, at each call with a heartbeat."""
        self.say(Heartbeat, "heartbeat", visible=True)
        for frame in self.follower.frames(self.page):
            if frame["kind"] == "following":
                self.following = frame
        return self.following

    def guide(self, joint, by_rad):
        arm = self.leader.arm_thread.arm
        here = true_joints(arm)[joint]
        line_of(arm).world.grasp(joint, Hand(glide(here, here + by_rad, 0.4)))
        return here + by_rad

    def until(self, true):
        until(lambda: self.reported() and true(), lambda: (self.following, self.notices()))
        return self

    def until_followed(self):
        return self.until(lambda: self.following.get("lag") and self.joint_gap_rad() < 0.03)

    def joint_gap_rad(self):
        led, followed = (true_joints(arm.arm_thread.arm) for arm in (self.leader, self.follower))
        return max(abs(led[name] - followed[name]) for name in led)

    def notices(self):
        return [arm.arm_thread.snapshot.stop_notice for arm in (self.follower, self.leader)]


@pytest.fixture
def pair():
    with served(("planar3", "sim:?pose=home"), ("planar3", "sim:?pose=home")) as (arms, _):
        yield Pair(arms)


@pytest.mark.full
def test_follower_follows_hand_guided_leader_and_shows_lag(pair):
    pair.follow().until_followed()
    wanted = pair.guide("joint3", TURN_RAD)
    pair.until(lambda: any("ms" in value for _, value in pair.following["lag"]))
    followed = lambda: true_joints(pair.follower.arm_thread.arm)["joint3"]  # noqa: E731
    pair.until(lambda: abs(followed() - wanted) < 0.03)
    assert pair.leader.fields()["state"] == "busy"
    assert set(registers(pair.leader.arm_thread.arm, "torque_enable").values()) == {0}
    pair.follow(None).until(lambda: pair.following["leader"] is None)
    until(lambda: pair.leader.arm_thread.job is None)
    assert pair.notices() == [None, None]


@pytest.mark.full
def test_refused_leader_position_is_reported_and_last_goal_kept(pair, monkeypatch):
    def refuse(*_):
        raise RefusedError("The cup is in the way.")

    pair.follow().until_followed()
    monkeypatch.setattr(ArmContext, "check_trajectory", refuse)
    goals = registers(pair.follower.arm_thread.arm, "goal_position")
    pair.guide("joint3", TURN_RAD)
    pair.until(lambda: "The cup is in the way." in str(pair.following))
    assert registers(pair.follower.arm_thread.arm, "goal_position") == goals
    assert pair.notices() == [None, None]


def pull_cable(pair):
    line_of(pair.leader.arm_thread.arm).plugged = False


def silence_servo(pair):
    line = line_of(pair.follower.arm_thread.arm)
    line.faults.add(Fault("silent", id=3, at_s=line.world.time_s))


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("fault", "reported", "leader_too"),
    [
        (pull_cable, "planar3-2 no longer leads: Lost connection", True),
        (
            lambda pair: pair.arms.stop("planar3-2", STOPPED),
            "planar3-2 no longer leads: The arm was stopped: Stopped",
            True,
        ),
        (silence_servo, "joint3 (id 3)", False),
        (lambda pair: pair.arms.stop("planar3", STOPPED), STOPPED, False),
    ],
    ids=["leader's cable", "leader's stop", "follower's servo", "follower's stop"],
)
def test_fault_of_leader_or_follower_ends_following(pair, fault, reported, leader_too):
    pair.follow().until_followed()
    fault(pair)
    pair.until(lambda: pair.notices()[0] and pair.following["leader"] is None)
    assert reported in pair.notices()[0].message
    until(lambda: pair.leader.arm_thread.job is None)
    until(lambda: bool(pair.notices()[1]) == leader_too)
    goals = registers(pair.follower.arm_thread.arm, "goal_position")
    if not leader_too:
        pair.guide("joint3", TURN_RAD)
    with pytest.raises(IkservoError, match="stopped"):
        pair.follow()
    if fault is not silence_servo:
        pair.say(Acknowledge, "acknowledge")
        pair.until(lambda: pair.notices()[0] is None)
        assert registers(pair.follower.arm_thread.arm, "goal_position") == goals


def test_leader_that_is_missing_or_has_torque_on_is_refused(pair):
    pair.leader.arm_thread.arm.enable()
    until(lambda: all(state.torque for state in pair.leader.arm_thread.snapshot.states))
    for name, why in [
        ("planar3-2", "you cannot guide it"),
        ("planar3", "No other arm"),
        ("x", "No other"),
    ]:
        with pytest.raises(IkservoError, match=why):
            pair.follow(name)
    assert pair.leader.arm_thread.job is pair.follower.arm_thread.job is None


@pytest.mark.parametrize("lag_s", [0.0, 0.04, 0.2])
def test_follower_lag_meter_measures_delay_of_motion(lag_s):
    meter = LagMeter(("pan", "lift"))

    def led(time_s):
        return np.array([0.3 * math.sin(2.0 * time_s), 0.1 * math.cos(time_s)])

    for cycle in range(400):
        now_s = 0.01 * cycle
        meter.record(now_s - 0.003, led(now_s - 0.003), now_s, led(now_s - lag_s), led(now_s - 0.3))
    found = meter.read()
    assert found.goal_s == pytest.approx(lag_s, abs=0.004)
    assert found.arm_s == pytest.approx(0.3, abs=0.004)
    assert found.joint == "pan"


def test_lag_meter_reports_only_error_while_leader_is_still():
    meter = LagMeter(("pan",))
    for cycle in range(10):
        meter.record(cycle, np.array([0.5]), cycle, np.array([0.5]), np.array([0.4]))
    found = meter.read()
    assert (found.goal_s, found.arm_s) == (None, None)
    assert found.error == pytest.approx(0.1)
