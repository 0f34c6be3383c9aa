"""The end of a goal is reported only when the arm is at rest."""

import contextlib
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from ikservo.apps.remote.ros.action_server import ActionGoal, GoalStatus
from ikservo.apps.remote.ros.goal_driver import GoalDriver, GoalEnd
from ikservo.apps.remote.ros.trajectory_action import ErrorCode, _Watch
from ikservo.errors import IkservoError

WITHIN_S = 60.0


class BrakingArm:
    """An arm that brakes until it may rest."""

    def __init__(self):
        self.background = SimpleNamespace(
            stop_count=0, requested=lambda _: contextlib.nullcontext()
        )
        self.sent, self.braking, self.may_rest = [], threading.Event(), threading.Event()

    def where(self):
        return SimpleNamespace(positions={"a": 0.0}, positions_rad=np.zeros(1), tip_m=np.zeros(3))

    @contextlib.contextmanager
    def stream(self, speed):
        yield SimpleNamespace(send=self.sent.append, progress=True, reason="", unreached=0)
        self.braking.set()
        assert self.may_rest.wait(WITHIN_S)


class Goal:
    """A goal that never ends by itself; it waits at its first setpoint if told to."""

    arrives = True

    def __init__(self, goes_on=None):
        self.followed, self._goes_on = threading.Event(), goes_on

    def delay(self, now_s):
        pass

    def has_ended(self, now_s):
        return False

    def setpoint(self, now_s, tip_m):
        self.followed.set()
        assert self._goes_on is None or self._goes_on.wait(WITHIN_S)
        return self


class Watch:
    """Records the end of its goal, and whether the driver still moved the arm then."""

    def __init__(self, is_moving):
        self.ends, self.has_ended, self._is_moving = [], threading.Event(), is_moving

    def observe(self, now_s, positions):
        return True

    def ended(self, end, why):
        self.ends.append((end, self._is_moving()))
        self.has_ended.set()


@pytest.fixture
def arm():
    return BrakingArm()


@pytest.fixture
def driver(arm):
    driver = GoalDriver(arm, "slow", lambda _: None)
    yield driver
    arm.may_rest.set()
    driver.close()


def put(driver, goal):
    watch = Watch(lambda: driver.is_moving)
    driver.put(goal, watch)
    return watch


def test_canceled_ros_goal_ends_once_arm_is_at_rest(arm, driver):
    goal = Goal()
    watch = put(driver, goal)
    assert goal.followed.wait(WITHIN_S)
    driver.cancel(watch)
    assert arm.braking.wait(WITHIN_S)
    assert watch.ends == []
    arm.may_rest.set()
    assert watch.has_ended.wait(WITHIN_S)
    assert watch.ends == [(GoalEnd.ENDED, False)]


def test_ros_goal_canceled_before_start_ends_with_arm_at_rest(arm, driver):
    goes_on = threading.Event()
    first = Goal(goes_on)
    put(driver, first)
    assert first.followed.wait(WITHIN_S)
    watch = put(driver, Goal())
    driver.cancel(watch)
    assert watch.ends == []
    goes_on.set()
    arm.may_rest.set()
    assert watch.has_ended.wait(WITHIN_S)
    assert watch.ends == [(GoalEnd.ENDED, False)]


def test_ros_goal_canceled_during_braking_ends_at_rest(arm, driver):
    goal = Goal()
    first = put(driver, goal)
    assert goal.followed.wait(WITHIN_S)
    driver.cancel(first)
    assert arm.braking.wait(WITHIN_S)
    watch = put(driver, Goal())
    driver.cancel(watch)
    assert watch.ends == []
    arm.may_rest.set()
    assert watch.has_ended.wait(WITHIN_S)
    assert watch.ends == [(GoalEnd.ENDED, False)]


def test_canceled_ros_goal_ends_once_newer_goal_is_followed(driver):
    goes_on = threading.Event()
    first = Goal(goes_on)
    watch = put(driver, first)
    assert first.followed.wait(WITHIN_S)
    driver.cancel(watch)
    put(driver, Goal())
    goes_on.set()
    assert watch.has_ended.wait(WITHIN_S)
    assert watch.ends == [(GoalEnd.REPLACED, True)]


def test_new_ros_goal_succeeds_only_after_own_time_at_rest(arm, driver, monkeypatch):
    now_s, began_s = [0.0], []
    clock = SimpleNamespace(
        monotonic=lambda: now_s[0], sleep=lambda wait_s: now_s.append(now_s.pop() + wait_s)
    )
    monkeypatch.setattr("ikservo.apps.remote.ros.goal_driver.time", clock)
    watch = Watch(lambda: now_s[0] - began_s[0])
    arm.may_rest.set()

    class There(Goal):
        """A goal at the present position of the arm."""

        def has_ended(self, now_s):
            return True

    class Replaced(There):
        """A goal that is replaced shortly before its unmoved arm counts as arrived."""

        def setpoint(self, at_s, tip_m):
            if at_s >= 1.95 and not began_s:
                began_s.append(at_s)
                driver.put(There(), watch)
            return self

    driver.put(Replaced())
    assert watch.has_ended.wait(WITHIN_S)
    ((end, elapsed_s),) = watch.ends
    assert end is GoalEnd.ARRIVED
    assert elapsed_s > 1.95


def test_ros_goal_whose_end_is_unmeasurable_is_aborted():
    def where():
        raise IkservoError("gripper does not answer.")

    ends = []
    action = SimpleNamespace(finish=lambda *end: ends.append(end[1:]))
    goal = ActionGoal(bytes(16), 0)
    watch = _Watch(action, goal, SimpleNamespace(where=where), None, {}, {}, 0.0)
    watch.ended(GoalEnd.ARRIVED, "")
    assert ends == [
        (GoalStatus.ABORTED, ErrorCode.PATH_TOLERANCE_VIOLATED, "gripper does not answer.")
    ]
