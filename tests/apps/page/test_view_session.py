"""The controller and its arm thread in virtual time: who moves the arm, what stops it."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from ikservo.apps.page.dragging.interaction import Interaction
from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.page_updates import FrameComposer
from ikservo.apps.page.picking.joint_dials import joint_dials
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.viewpoints import Viewpoint
from ikservo.apps.page.server.auth import Permission
from ikservo.apps.page.server.message_age_and_rate import Client
from ikservo.arm import StopKind, StopReason, open_arm
from servosim.faults import Fault
from tests.apps.page.view_session import ViewSession
from tests.arm.simulated import line_of, registers, true_tip_m
from tests.arm.test_first_motion import narrowed


@pytest.fixture
def session():
    with ViewSession() as session:
        yield session


@pytest.mark.campaign
def test_click_in_live_mode_moves_tip_to_clicked_point(session):
    session.enable_live()
    session.click(480, 300)
    wanted = session.interaction.marker.target_m
    session.run()
    assert math.dist(true_tip_m(session.arm), wanted) < 0.002


def test_status_shows_target_of_grabbed_link(session):
    session.click(480, 300)
    assert [name for name, *_ in session.latest_frames()["status"]["tip"]][:2] == ["tip", "target"]
    session.interaction.marker = replace(session.interaction.marker, frame="gripper")
    assert "target of gripper" in [name for name, *_ in session.latest_frames()["status"]["tip"]]


@pytest.mark.full
def test_live_mode_without_target_moves_nothing(session):
    session.enable_live().click(480, 300)
    session.run()  # goals lead the joints from here on
    before_m = true_tip_m(session.arm)
    session.enable_live().run(cycles=200)
    assert math.dist(true_tip_m(session.arm), before_m) < 0.0005


@pytest.mark.full
def test_arm_stays_in_place_after_cancelled_gesture(session):
    session.enable_live()
    session.point("down", 480, 300)
    session.run(cycles=150, on_cycle=lambda number: number == 100 and session.point("cancel", 0, 0))
    cancelled_m = true_tip_m(session.arm)
    session.run(cycles=200)
    assert math.dist(true_tip_m(session.arm), cancelled_m) < 0.002


def test_click_outside_live_mode_moves_nothing(session):
    before = registers(session.arm, "goal_position")
    session.click(480, 300)
    session.run()
    assert registers(session.arm, "goal_position") == before
    assert session.interaction.goal is not None


@pytest.mark.full
def test_random_drag_keeps_every_goal_inside_limits(session):
    session.enable_live()
    session.point("down", 480, 300)
    seen = []

    def wander(number):
        session.point("move", 450 + 800 * math.sin(number / 7), 350 + 700 * math.cos(number / 11))
        seen.append(session.arm_thread.snapshot.reference)

    session.run(cycles=300, on_cycle=wander)
    chain = session.arm.chain
    goals = np.array(seen)[:, : chain.dof]
    assert (goals >= chain.lower_rad - 1e-3).all()
    assert (goals <= chain.upper_rad + 1e-3).all()
    assert np.abs(np.diff(goals, axis=0)).max() > 0.0


def test_silent_page_makes_arm_hold_within_dead_man_time(session):
    session.enable_live()
    session.send_message(page_messages.SetSpeed, name="slow")
    session.click(480, 300)
    sent_s, goals = session.clock.now_s(), []
    see = session.arm_thread.on_cycle
    session.arm_thread.on_cycle = lambda cycle: (
        see(cycle),
        goals.append((session.clock.now_s(), cycle.goals)),
    )
    session.arm_thread.step()
    moved_s = [s for (s, goal), (_, before) in zip(goals[1:], goals, strict=False)
               if not np.array_equal(goal, before)]  # fmt: skip
    braking_s = 0.25 + 0.02  # and two cycles
    assert 0.2 < moved_s[-1] - sent_s < 0.3 + braking_s
    assert not session.latest_frames()["status"]["live"]


def test_silent_page_must_enable_live_mode_again(session):
    session.enable_live()
    session.click(480, 300)
    session.arm_thread.step()
    session.arm_thread.step()  # reads the joints: the last goals, which have no reply, have come
    before = registers(session.arm, "goal_position")
    session.send_message(page_messages.Heartbeat, visible=True)
    session.click(480, 300)
    session.run(cycles=50)
    assert registers(session.arm, "goal_position") == before


def test_hidden_page_ends_live_mode(session):
    session.enable_live()
    session.click(480, 300)
    session.run(
        on_cycle=lambda n: n == 5 and session.send_message(page_messages.Heartbeat, visible=False)
    )
    assert not session.latest_frames()["status"]["live"]


def test_disconnected_page_ends_live_mode(session):
    session.enable_live()
    session.click(480, 300)
    session.controller.disconnect(session.client)
    assert not session.arm_thread.command.live


@pytest.mark.full
def test_cancelled_drag_holds_arm_where_it_is(session):
    session.enable_live()
    start = session.arm_thread.snapshot.measured
    session.point("down", 480, 300)
    session.run(on_cycle=lambda n: n == 120 and session.point("cancel", 480, 300))
    session.run(cycles=200)
    assert np.abs(session.goals[0] - start).max() > 0.1
    assert np.ptp(session.measured, axis=0).max() < 0.06  # what a joint lagged while it moved
    assert np.ptp(session.measured[100:], axis=0).max() < 0.004


CUT_S = [0.15 + number * 0.009 for number in range(100)]
STILL_RAD = 5e-4  # from one goal to the next
CYCLE_S = 0.02  # until a cycle handles it and goals are sent


@pytest.mark.sample(1)
@pytest.mark.parametrize(("way", "notice_s"), [("closed", 0.0), ("silent", 0.3)])
@pytest.mark.parametrize(
    "cuts",
    [CUT_S[5::50], *(pytest.param(CUT_S[n::5], marks=pytest.mark.campaign) for n in range(5))],
    ids=lambda cuts: f"{len(cuts)} from {cuts[0]:.3f} s",
)
def test_connection_cut_during_drag_makes_arm_hold(session, cuts, way, notice_s):
    for cut_s in cuts:
        assert held_s(session, cut_s, way) - cut_s < notice_s + CYCLE_S + longest_brake_s(
            session.arm
        )
        assert not session.arm_thread.command.live


def longest_brake_s(arm):
    """Return the longest braking time: a speed that still grows must first stop growing."""
    pace = arm.model.speed("fast")
    return pace.rad_s / pace.rad_s2 + 2.0 * pace.rad_s2 / pace.rad_s3


def held_s(session, cut_s, way):
    """Drag until the connection is cut; return the time of the last new goal."""
    heartbeats_s = []

    def drag(_):
        heartbeats_s.append(session.clock.now_s())
        now_s = heartbeats_s[-1] - heartbeats_s[0]
        if now_s < cut_s:
            angle = 6.0 * now_s
            session.point("move", 480 + 90 * math.cos(angle), 300 + 90 * math.sin(angle))
        elif way == "closed" and session.arm_thread.command.live:
            session.controller.disconnect(session.client)
            session.client = session.connect()

    session.enable_live()
    session.point("down", 570, 300)
    sent_goals = session.record_goals()
    session.run(on_cycle=drag, heartbeats=False)
    session.point("cancel", 480, 300)
    goals = np.array([goal for _, goal in sent_goals])
    changed = np.flatnonzero(np.abs(np.diff(goals, axis=0)).max(axis=1) > STILL_RAD) + 1
    return sent_goals[changed[-1]][0] - heartbeats_s[0]


def test_stop_right_after_acknowledgement_is_latched(session):
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    session.send_message(page_messages.Acknowledge)
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    assert session.latest_frames()["status"]["mode"] == "stopped"


def test_error_in_arm_thread_is_shown_on_page_banner(session):
    def fail():
        raise ZeroDivisionError

    session.arm_thread.step = fail
    with pytest.raises(ZeroDivisionError):
        session.arm_thread._run_thread()
    assert "The panel failed" in session.latest_frames()["status"]["banner"]["message"]


def test_reopened_arm_replaces_limits_of_page(session):
    before = session.interaction
    session.latest_frames()
    assert session.interaction is before
    session.arm_thread.arm = open_arm("so101", "sim:?pose=home")
    session.latest_frames()
    assert session.interaction._chain is session.arm_thread.arm.chain
    session.arm_thread.arm.close()


@pytest.mark.full
def test_held_trigger_opens_gripper_until_released(session):
    session.enable_live()
    before = session.arm_thread.snapshot.measured[-1]
    closing = session.arm.model.gripper.closed - session.arm.model.gripper.open

    def press(number):
        if number % 5 == 0:
            session.send_message(
                page_messages.Gamepad, axes=[0, 0, 0, 0], grip=-1.0 if number < 60 else 0.0
            )

    session.run(cycles=250, on_cycle=press)
    goals = np.array(session.goals)
    assert (goals[-1, -1] - before) * closing < -0.05
    assert np.ptp(goals[150:, -1]) < 0.02
    assert np.ptp(goals[:, :-1], axis=0).max() < 0.04


def test_live_mode_enabled_again_during_braking_stays_on(session):
    session.enable_live()
    session.click(480, 300)

    def off_and_on(number):
        if number == 40:
            session.send_message(page_messages.SetLive, on=False)
            session.send_message(page_messages.SetLive, on=True)

    session.run(cycles=200, on_cycle=off_and_on)
    assert session.latest_frames()["status"]["live"]


def test_stop_latches_and_refuses_live_mode(session):
    session.enable_live()
    session.click(480, 300)
    session.run(on_cycle=lambda n: n == 5 and session.send_message(page_messages.Stop))
    session.arm_thread.step()
    assert session.latest_frames()["status"]["mode"] == "stopped"
    with pytest.raises(BadMessageError, match="The arm was stopped"):
        session.enable_live()


def test_stop_message_without_text_stops_arm(session):
    session.arm_thread.request_stop(StopReason(StopKind.CLIENT))
    session.arm_thread.step()
    assert session.latest_frames()["status"]["mode"] == "stopped"
    assert session.arm.stop_reason.kind is StopKind.CLIENT


@pytest.mark.full
def test_arm_moves_again_after_acknowledgement(session):
    session.send_message(page_messages.Stop)
    session.arm_thread.step()
    session.send_message(page_messages.Acknowledge)
    session.arm_thread.step()
    session.enable_live()
    session.click(480, 300)
    wanted = session.interaction.marker.target_m
    session.run()
    assert math.dist(true_tip_m(session.arm), wanted) < 0.002


def test_banner_names_silent_servo(session):
    session.enable_live()
    session.click(480, 300)
    silent = Fault("silent", id=3, at_s=line_of(session.arm).world.time_s + 0.1)
    line_of(session.arm).faults.add(silent)
    session.run()
    assert "elbow_flex (id 3)" in session.latest_frames()["status"]["banner"]["message"]


ASKING = [
    (page_messages.SetLive, {"on": True}),
    (page_messages.Stop, {}),
    (page_messages.Acknowledge, {}),
    (page_messages.TakeControl, {"on": True}),
    (page_messages.SetSpeed, {"name": "fast"}),
    (page_messages.SetSolver, {"name": "ccd"}),
    (page_messages.GoToPose, {"name": "rest"}),
    (page_messages.CalibrationAnswer, {"action": "start"}),
    (page_messages.Key, {"key": "ArrowUp"}),
    (page_messages.SelectBehind, {"step": 1}),
    (page_messages.PreferPosture, {"pose": "rest"}),
    (page_messages.Gamepad, {"axes": [1, 0, 0, 0]}),
    (page_messages.Wheel, {"x": 480, "y": 300, "notches": 1}),
    (page_messages.Pointer, {"phase": "down", "x": 480, "y": 300, "button": 0, "pointer": 1}),
]


def pixel_of_hub(session, joint):
    chain, q = session.arm.chain, session.chain_joints()
    dial = next(dial for dial in joint_dials(chain, q) if dial.name == joint)
    return session.camera().project(dial.hub(link_poses(chain, q, {}), q))[0].tolist()


def test_links_under_pointer_are_listed_by_depth(session):
    session.point("hover", *pixel_of_hub(session, "elbow_flex"))
    under = session.latest_frames()["status"]["under"]
    links = [row for row in under if row["depth"]]
    assert links[0]["name"] in {"upper_arm", "forearm"}
    assert links[0]["depth"] == "nearest"
    assert [row["chosen"] for row in under] == [True] + [False] * (len(under) - 1)
    assert under[len(links)]["name"] == "the tip moves here"


def test_select_behind_key_selects_next_link_under_pointer(session):
    session.point("hover", *pixel_of_hub(session, "elbow_flex"))
    first = session.latest_frames()["scene"]["hover"]
    session.send_message(page_messages.SelectBehind, step=1)
    sent_goals = session.latest_frames()
    assert sent_goals["status"]["under"][1]["chosen"]
    assert sent_goals["scene"]["hover"] != first


def test_link_list_stays_after_tap_on_touch_screen(session):
    fields = {"x": 480, "y": 300, "button": 0, "pointer": 1, "touch": True}
    for phase in ("down", "up", "leave"):
        session.send_message(page_messages.Pointer, phase=phase, **fields)
    assert session.latest_frames()["status"]["under"]
    session.point("leave", 480, 300)
    assert not session.latest_frames()["status"]["under"]


def test_pointer_over_empty_space_lists_only_tip(session):
    session.point("hover", 5, 5)
    assert [row["name"] for row in session.latest_frames()["status"]["under"]] == [
        "the tip moves here"
    ]


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("method", ["ccd", "transpose"])
def test_drag_uses_chosen_solver_until_target_is_reached(session, method):
    session.send_message(page_messages.SetSolver, name=method)
    tip_m = session.arm.chain.forward(session.chain_joints())[:3, 3]
    tip = session.camera().project(tip_m)[0].tolist()
    session.point("down", *tip)
    session.point("move", tip[0] + 30, tip[1] - 30)
    assert session.latest_frames()["status"]["solver"]["text"].startswith(f"{method}: ")
    for _ in range(200):
        session.latest_frames()
    assert session.interaction.marker.gap_m < 2e-3


def test_preferred_posture_changes_goal_of_click(session):
    session.send_message(page_messages.PreferPosture, pose="rest", weights={"shoulder_pan": 0.0})
    session.click(480, 300)
    leaning, gestures = session.interaction.goal, session.interaction
    session.send_message(page_messages.PreferPosture, pose="none")
    gestures.reset()
    session.click(480, 300)
    assert gestures.marker.reached
    assert np.abs(leaning - gestures.goal).max() > 0.05
    assert session.latest_frames()["status"]["preference"]["pose"] == "none"


def test_solver_without_null_space_says_it_ignores_posture(session):
    session.send_message(page_messages.PreferPosture, pose="rest")
    assert session.latest_frames()["status"]["preference"]["note"] == ""
    session.send_message(page_messages.SetSolver, name="ccd")
    assert "cannot prefer a posture" in session.latest_frames()["status"]["preference"]["note"]


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"pose": "nowhere"}, "no pose"),
        ({"pose": "rest", "weights": {"knee": 1.0}}, "no joint"),
    ],
)
def test_invalid_posture_preference_is_refused(session, fields, why):
    with pytest.raises(BadMessageError, match=why):
        session.send_message(page_messages.PreferPosture, **fields)
    assert session.latest_frames()["status"]["preference"]["pose"] == "none"


def test_unconverged_solver_result_is_not_shown_as_nearest(session):
    session.send_message(page_messages.SetSolver, name="transpose")
    session.click(60, 60)
    assert "transpose ended" in session.latest_frames()["status"]["messages"][-1]["message"]


def posture_rows(sent_goals):
    return {name: words for name, words, _ in sent_goals["status"]["posture"]}


def later(session, name):
    """Return a line about the posture that takes a while to compute."""
    for _ in range(500):
        sent_goals = session.latest_frames()
        if "status" in sent_goals and name in posture_rows(sent_goals):
            return posture_rows(sent_goals)[name]
        threading.Event().wait(0.01)
    raise AssertionError(f"{name} is never sent")


def test_shown_manipulability_equals_that_computed_from_jacobian(session):
    q = session.arm_thread.snapshot.measured[:5]
    J = session.arm.chain.jacobian(q)[:3]
    value, unit = posture_rows(session.latest_frames())["manipulability"].split(",")[0].split()
    assert float(value) == pytest.approx(math.sqrt(np.linalg.det(J @ J.T)), rel=0.05)
    assert unit == "m³"


def test_singularity_and_hidden_links_are_reported_at_rest(session):
    assert later(session, "singularity").endswith(("inside the limits", "elbow_flex"))
    session.send_message(page_messages.SetViewport, w=900, h=700, dpr=1, view="top")
    assert "shoulder (by " in later(session, "hidden here")


def refused_request(session, client, asking, why):
    """Send a request that is refused with a reason and has no effect."""
    drag_command = session.arm_thread.command
    for kind, fields in asking:
        with pytest.raises(BadMessageError, match=why):
            session.send_message(kind, client, **fields)
        assert session.arm_thread.command is drag_command, kind.__name__


def test_motion_request_of_watcher_is_refused(session):
    asking = [(kind, fields) for kind, fields in ASKING if kind is not page_messages.Stop]
    refused_request(session, session.connect(Permission.WATCH), asking, "can only watch")


def test_watcher_stops_arm_and_cannot_acknowledge(session):
    watcher = session.connect(Permission.WATCH)
    session.send_message(page_messages.Stop, watcher)
    assert session.arm.stop_reason.kind is StopKind.CLIENT
    with pytest.raises(BadMessageError, match="can only watch"):
        session.send_message(page_messages.Acknowledge, watcher)
    assert session.arm.stop_reason


def test_motion_request_of_page_without_control_is_refused(session):
    free = (page_messages.Stop, page_messages.Acknowledge, page_messages.TakeControl)
    asking = [(kind, fields) for kind, fields in ASKING if kind not in free]
    refused_request(session, session.connect(), asking, "Another page")


def test_page_without_control_may_stop_arm(session):
    session.send_message(page_messages.Stop, session.connect())
    session.arm_thread.step()
    assert session.latest_frames()["status"]["mode"] == "stopped"


def test_taking_control_ends_live_mode(session):
    session.enable_live()
    other = session.connect()
    session.send_message(page_messages.TakeControl, other, on=True)
    assert not session.arm_thread.command.live
    assert session.latest_frames(other)["status"]["controller"] == "you"


def test_page_that_takes_control_starts_at_slow_speed(session):
    session.enable_live()
    session.controller.disconnect(session.client)
    assert session.latest_frames(session.connect())["status"]["speed"] == "slow"


def test_unknown_pose_is_refused_by_page(session):
    for name in ("nowhere", "homes"):
        with pytest.raises(BadMessageError, match="no pose"):
            session.send_message(page_messages.GoToPose, name=name)


@pytest.mark.parametrize(
    ("pose", "joint", "upper_deg"), [("rest", "elbow_flex", 80.0), ("home", "wrist_flex", 57.0)]
)
def test_pose_beyond_narrowed_limit_moves_to_limit_and_warns(pose, joint, upper_deg):
    model = narrowed("so101", **{joint: (-90.0, upper_deg)})
    with ViewSession(open_arm(model, f"sim:{model.path}?pose=zero")) as session:
        session.send_message(page_messages.GoToPose, name=pose)
        goal = dict(zip(session.arm.where().names, session.interaction.goal, strict=True))
        # as far inside as friction may keep it short of a goal: 0.070 N m on 17.5 N m/rad
        inside_deg = upper_deg - math.degrees(0.070 / 17.5)
        assert math.degrees(goal[joint]) == pytest.approx(inside_deg, abs=0.1)
        assert any(entry.message.startswith(joint) for entry in session.interaction.messages)


def test_unchanged_scene_is_not_sent_to_page_again(session):
    session.latest_frames()
    assert [frame["kind"] for frame in session.controller.frames(session.client)] == []


def test_mouse_wheel_moves_goal_by_one_degree_per_notch(session):
    x, y = pixel_of_hub(session, "elbow_flex")
    session.send_message(page_messages.Wheel, x=x, y=y, notches=3)
    turned = session.interaction.goal - session.arm_thread.snapshot.measured
    assert math.degrees(np.abs(turned).max()) == pytest.approx(3.0, abs=0.3)


def test_arm_thread_command_can_only_be_set_by_post(session):
    command = replace(session.arm_thread.command, speed="fast")
    session.arm_thread.post(command)
    assert session.arm_thread.command is command
    with pytest.raises(AttributeError):
        session.arm_thread.command = command


def test_page_without_viewport_size_has_no_camera(session):
    client = Client(9, Permission.WATCH, Viewpoint("side"))
    with pytest.raises(BadMessageError, match="size of its drawing"):
        FrameComposer(
            session.arm_thread, Interaction(session.arm, session.clock), session.clock
        ).camera(client)


def test_press_before_viewport_size_does_not_set_goal(session):
    client = session.controller.connect(Permission.CONTROL)
    session.send_message(page_messages.TakeControl, client, on=True)
    session.point("down", 400, 300, client)
    assert session.arm_thread.command.goal is None


PRESSES = {
    "a click": lambda session: session.click(480, 300),
    "a wheel": lambda session: session.send_message(page_messages.Wheel, x=480, y=300, notches=1),
    "a key": lambda session: session.send_message(page_messages.Key, key="ArrowUp"),
    "a handle": lambda session: session.send_message(
        page_messages.DragTool, phase="down", shift=(0, 0, 0), turn=(0, 0, 0)
    ),
}


@pytest.mark.parametrize("press", PRESSES.values(), ids=PRESSES)
def test_press_while_arm_executes_goal_is_refused(session, press):
    session.click(480, 300)
    goal = session.interaction.goal
    session.go_there()
    with pytest.raises(BadMessageError, match="busy: Moving to the target"):
        press(session)
    session.point("move", 500, 320)  # no press: nothing to tell
    assert session.interaction.goal is goal
