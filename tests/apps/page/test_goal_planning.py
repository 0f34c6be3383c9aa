"""The path to a target is planned in the background, shown, then executed unchanged."""

import math
import time
from contextlib import contextmanager
from threading import Event

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages import thing_messages as things
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.arm import StopKind, StopReason, open_arm
from ikservo.guard.path_search import WaySearch
from tests.apps.page.view_session import LOOK_S, LOOKS, ViewSession
from tests.arm.simulated import line_of, registers, true_joints
from tests.arm.test_ways_around import POST, left_of, nearest_m


@pytest.fixture
def session():
    """A session of an arm that stands to the left of a post."""
    with left_of(POST) as arm, ViewSession(arm) as made:
        yield made


def aim_right(session, deg=38.0):
    """Type a target to the right of the post."""
    session.send_message(page_messages.SetJoint, joint="shoulder_pan", value=deg)


def rows(frames):
    return {name: text for name, text, _ in frames["status"]["tip"]}


def execute(session, number):
    session.send_message(page_messages.ArmAction, action="execute", path=number)


def run_job(session):
    """Let the arm thread do what was requested; return the setpoints (k, n)."""
    session.send_message(page_messages.Heartbeat, visible=True)
    setpoints, reported = [], session.arm_thread.on_progress

    def tell(progress):
        session.send_message(page_messages.Heartbeat, visible=True)
        setpoints.append(progress.setpoints_rad)
        reported(progress)

    session.arm_thread.on_progress = tell
    session.arm_thread.step()
    del session.arm_thread.on_progress
    return np.array(setpoints)


@contextmanager
def slow_search(monkeypatch):
    """Yield events: a search has begun, it may find a path; it can be cancelled at any time."""
    begun, may_end, search = Event(), Event(), WaySearch.find

    def find(self, most, is_over):
        begun.set()
        while not (may_end.is_set() or is_over()):
            time.sleep(LOOK_S)
        return search(self, most, is_over)

    with monkeypatch.context() as patch:
        patch.setattr(WaySearch, "find", find)
        yield begun, may_end
        may_end.set()


def until_begun(session, begun):
    frames = {}
    for _ in range(LOOKS):
        frames |= session.latest_frames()
        if begun.is_set():
            return frames
        time.sleep(LOOK_S)
    raise AssertionError("no search")


def until_idle(session):
    """Wait until the planning thread is idle."""
    planner = session.controller._planner
    for _ in range(LOOKS):
        if planner._busy is None or planner._busy[2].done():
            return
        time.sleep(LOOK_S)
    raise AssertionError("it plans on")


def test_planned_path_around_obstacle_is_executed_as_shown(session):
    aim_right(session)
    frames = session.planned()
    plan, path = session.interaction.path.plan, frames["scene"]["path"]
    length_mm, clear_mm = plan.path_m * 1e3, plan.clearance_m * 1e3
    assert rows(frames)["path"] == (
        f"around, {length_mm:.0f} mm, {plan.duration_s:.1f} s, {clear_mm:.0f} mm clear"
    )
    said = session.interaction.messages[-1].message
    assert said.endswith("would touch the post; the arm goes around.")
    assert frames["scene"]["refusal"] is None
    assert not frames["status"]["refused"]
    assert path["joints"][0] == pytest.approx(frames["scene"]["measured"], abs=0.02)
    assert path["joints"][-1] == pytest.approx(frames["scene"]["goal"], abs=1e-6)
    execute(session, path["number"])
    seen = run_job(session)
    expect_along(plan, seen)
    assert nearest_m(session.arm, seen) > 0.0
    assert math.degrees(true_joints(session.arm)["shoulder_pan"]) == pytest.approx(38.0, abs=1)
    session.arm_thread.step()
    assert session.latest_frames()["scene"]["path"] is None  # the arm is there


def test_planned_straight_path_is_shown_as_straight(session):
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=20.0)
    frames = session.planned()
    assert rows(frames)["path"].startswith("straight, ")
    assert not session.interaction.messages


def test_planner_error_is_shown_as_refusal_and_not_retried(session, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("no such state")

    monkeypatch.setattr(session.arm.context.planner.__class__, "motion_limits", fail)
    aim_right(session)
    assert "no such state" in session.planned()["scene"]["refusal"]
    number = session.interaction.path.number
    session.latest_frames()
    assert session.interaction.path.number == number  # the same is not tried again and again


@pytest.mark.parametrize("by", ["page", "another program"])
def test_stop_ends_path_planning_and_discards_plan(session, monkeypatch, by):
    before = registers(session.arm, "goal_position")
    with slow_search(monkeypatch) as (begun, _):
        aim_right(session)
        assert rows(until_begun(session, begun))["path"] == "is being planned"
        number = session.interaction.path.number
        with pytest.raises(BadMessageError, match="not planned yet"):
            execute(session, number)
        if by == "page":
            session.send_message(page_messages.Stop)
        else:
            session.arm.request_stop(StopReason(StopKind.PROGRAM, "Stopped by a program."))
        until_idle(session)  # nobody lets the search go on: the stop has ended it
    session.arm_thread.step()
    assert session.arm_thread.snapshot.stop_notice
    session.latest_frames()
    for _ in range(2):
        with pytest.raises(BadMessageError, match="stopped"):
            execute(session, number)
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    frames = session.latest_frames()
    assert frames["scene"]["path"] is frames["status"]["path"] is None
    with pytest.raises(BadMessageError, match="No target"):
        execute(session, number)
    session.arm_thread.step()
    assert registers(session.arm, "goal_position") == before


def test_newer_target_ends_path_search_for_older_one(session, monkeypatch):
    with slow_search(monkeypatch) as (begun, _):
        aim_right(session)
        until_begun(session, begun)
        older = session.interaction.goal
        session.send_message(page_messages.SetJoint, joint="shoulder_pan", value=-45.0)
        frames = session.planned()  # though nobody lets that search go on
    assert session.interaction.path.request.goal is session.interaction.goal is not older
    assert rows(frames)["path"].startswith("straight, ")
    assert frames["scene"]["path"]["joints"][-1] == pytest.approx(frames["scene"]["goal"], abs=1e-6)


def test_path_to_dragged_goal_is_planned_only_after_release(session, monkeypatch):
    session.send_message(page_messages.SetViewport, w=900, h=700, dpr=1, view="top")
    tip_m = session.arm.where().tip_m
    start, end = (
        session.camera().project(tip_m * np.array([1.0, side, 1.0]))[0].tolist() for side in (1, -1)
    )
    with slow_search(monkeypatch) as (begun, may_end):
        session.point("down", *start)
        session.point("move", *end)
        assert session.planned()["status"]["refused"]
        assert not begun.is_set()
        session.point("up", *end)
        until_begun(session, begun)
        assert session.interaction.refusal is None
        may_end.set()
        assert rows(session.planned())["path"].startswith("around, ")
    assert not any("Refused" in entry.message for entry in session.interaction.messages)


CHANGES = {
    "a thing": (
        lambda session: session.arm.scene.change("the post", size_m=(0.16, 0.04, 0.25)),
        "The things around the arm have changed",
    ),
    "torque": (
        lambda session: (session.arm.disable_torque(), session.arm.enable()),
        "The speed has changed",
    ),
}


@pytest.mark.parametrize(("change", "reason"), CHANGES.values(), ids=CHANGES)
def test_outdated_path_is_replanned_instead_of_executed(session, change, reason):
    if reason == "The speed has changed":
        session.arm.move_joints({"wrist_roll": 0.1})  # the first motion, which is slow, is over
        session.arm_thread.step()
        session.send_message(page_messages.SetSpeed, name="fast")
    aim_right(session)
    session.planned()
    number, before = session.interaction.path.number, registers(session.arm, "goal_position")
    execute(session, number)  # and then it changes, before the arm's thread begins
    change(session)
    assert len(run_job(session)) == 0
    said = session.arm_thread.snapshot.messages[-1].message
    assert said.startswith(f"{reason}; planning again.")
    assert session.arm_thread.snapshot.stop_notice is None
    if reason == "The things around the arm have changed":
        assert registers(session.arm, "goal_position") == before
    session.arm_thread.step()
    with pytest.raises(BadMessageError, match=reason):
        execute(session, number)
    session.planned()
    assert session.interaction.path.number > number
    with pytest.raises(BadMessageError, match="not shown yet"):
        execute(session, number)  # a page that still shows the older one
    execute(session, session.interaction.path.number)
    seen = run_job(session)
    assert nearest_m(session.arm, seen) > 0.0
    assert math.degrees(true_joints(session.arm)["shoulder_pan"]) == pytest.approx(38.0, abs=1)


def test_path_shown_after_stop_is_executed_without_replanning(session):
    """It is planned at slow speed, because torque may be off before the arm moves."""
    session.arm.move_joints({"wrist_roll": 0.1})
    session.send_message(page_messages.SetSpeed, name="fast")
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    session.send_message(page_messages.SetJoint, joint="wrist_roll", value=20.0)
    session.go_there()
    plan = session.interaction.path.plan
    assert plan.speed == "slow"
    expect_along(plan, run_job(session))


def test_obstacle_added_to_shown_path_is_avoided(session):
    aim_right(session)
    session.planned()
    first = session.interaction.path
    highest = max(
        first.plan.sample(0.01).positions, key=lambda q: session.arm.context.planner.tip(q)[2]
    )
    tip_m = session.arm.context.planner.tip(highest)
    session.send_message(things.AddThing, shape="sphere")
    session.send_message(things.ChangeThing, name="the ball 1", center_m=tuple(tip_m.tolist()))
    frames = session.planned()
    second = session.interaction.path
    assert second.number > first.number
    assert session.arm.context.collision.things[-1] == "the ball 1"
    if second.plan is None:
        assert "would touch" in frames["scene"]["refusal"]
    else:
        assert nearest_m(session.arm, second.plan.sample(0.01).positions) > 0.0
    with pytest.raises(BadMessageError):
        execute(session, first.number)


def test_limp_arm_executes_shown_path_unless_moved_by_hand():
    with ViewSession() as session:
        session.arm.disable_torque()
        for _ in range(100):  # it sinks
            session.arm_thread.step()
        session.send_message(page_messages.GoToPose, name="home")
        assert "clear" not in rows(session.planned())["path"]  # it begins in contact
        session.go_there()
        line_of(session.arm).world.place("wrist_roll", 0.2)
        assert len(run_job(session)) == 0
        assert "The arm has moved since" in session.arm_thread.snapshot.messages[-1].message
        session.go_there()
        plan = session.interaction.path.plan
        assert plan.start[4] == pytest.approx(0.2, abs=0.01)
        expect_along(plan, run_job(session))


def test_path_of_sagging_arm_is_replanned_and_executed():
    with ViewSession() as session:
        session.arm.disable_torque()
        for _ in range(100):
            session.arm_thread.step()
        session.send_message(page_messages.GoToPose, name="home")
        session.go_there()
        for joint in ("shoulder_lift", "wrist_roll"):
            place = line_of(session.arm).world.place
            place(joint, true_joints(session.arm)[joint] + 0.06)
        assert len(run_job(session)) > 0
        home = session.arm.model.pose("home")
        for joint, angle in true_joints(session.arm).items():
            assert angle == pytest.approx(home[joint], abs=math.radians(2.0)), joint


@pytest.mark.full
@pytest.mark.parametrize("moved_rad", [0.0045, 0.007])
def test_limp_gripper_past_its_limit_does_not_end_planned_motion(moved_rad):
    with ViewSession(open_arm("omx_l", "sim")) as session:
        session.arm.disable_torque()
        for _ in range(300):
            session.arm_thread.step()
        z_mm = 1000.0 * session.arm.where().tip_m[2] + 60.0
        session.send_message(page_messages.SetTool, what="z", value=z_mm)
        session.go_there()
        place = line_of(session.arm).world.place
        place("gripper", true_joints(session.arm)["gripper"] + moved_rad)
        assert len(run_job(session)) > 100
        assert session.arm_thread.snapshot.stop_notice is None


def expect_along(plan, setpoints):
    planned = plan.sample(0.002).positions
    assert len(setpoints) > 50
    for setpoint in setpoints[::5]:
        assert np.abs(planned - setpoint).max(axis=1).min() < 0.01


LAMP_M = (0.27, 0.0, 0.15)


def test_blocked_tip_target_is_reached_in_another_posture():
    with ViewSession() as session:
        planner = session.arm.context.planner
        session.arm.scene.add("sphere", "the lamp", center_m=LAMP_M, radius_m=0.015)
        session.send_message(page_messages.SetTool, what="x", value=260.0)
        typed, wanted_m = session.interaction.goal, session.interaction.marker.target_m
        assert nearest_m(session.arm, [typed]) < 0.0
        session.planned()
        plan, goal = session.interaction.path.plan, session.interaction.goal
        assert np.degrees(np.abs(goal - typed).max()) > 20.0
        np.testing.assert_array_equal(plan.goal, goal)
        np.testing.assert_allclose(planner.tip(goal), wanted_m, atol=1e-4)
        said = [entry.message for entry in session.interaction.messages]
        assert "The arm will reach this target in another posture." in said
        number = session.interaction.path.number
        session.latest_frames()
        assert session.interaction.path.number == number  # it is not planned again
        session.go_there()
        assert nearest_m(session.arm, run_job(session)) > 0.0
        np.testing.assert_allclose(session.arm.where().tip_m, wanted_m, atol=0.002)
        session.send_message(page_messages.Undo)
        assert session.interaction.goal is None


def test_colliding_typed_posture_is_refused_and_not_replaced():
    with ViewSession() as session:
        session.arm.scene.add("sphere", "the lamp", center_m=LAMP_M, radius_m=0.015)
        session.send_message(page_messages.SetTool, what="x", value=260.0)
        goal = session.interaction.goal
        for joint, at in zip(session.arm.joint_names, np.degrees(goal).tolist(), strict=True):
            session.send_message(page_messages.SetJoint, joint=joint, value=at)
        assert "would touch the lamp" in session.planned()["scene"]["refusal"]
        np.testing.assert_allclose(session.interaction.goal, goal, atol=1e-9)
