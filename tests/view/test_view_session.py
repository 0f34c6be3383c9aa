"""The desk and the pilot on a simulated arm in virtual time: who moves it, and what holds it."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from ikservo.arm import StopKind, StopReason, open_arm
from ikservo.view import messages as said
from ikservo.view.auth import Permission
from ikservo.view.connection import Client
from ikservo.view.frames import FrameComposer
from ikservo.view.interaction import Interaction
from ikservo.view.messages import BadMessageError
from ikservo.view.viewpoints import Viewpoint
from servosim.faults import Fault
from tests.arm.simulated import line_of, registers, true_tip_m
from tests.arm.test_first_motion import narrowed
from tests.view.rooms import Room


@pytest.fixture
def room():
    with Room() as room:
        yield room


def test_a_click_moves_the_simulated_servos_to_its_place(room):
    room.throw_live()
    room.click(480, 300)
    wanted = room.desk._interaction.marker.target_m
    room.run()
    assert math.dist(true_tip_m(room.arm), wanted) < 0.002


def test_without_live_a_click_moves_nothing(room):
    before = registers(room.arm, "goal_position")
    room.click(480, 300)
    room.run()
    assert registers(room.arm, "goal_position") == before
    assert room.desk._interaction.goal is not None


def test_every_goal_of_a_wild_drag_is_inside_the_limits(room):
    room.throw_live()
    room.point("down", 480, 300)
    seen = []

    def wander(number):
        room.point("move", 450 + 800 * math.sin(number / 7), 350 + 700 * math.cos(number / 11))
        seen.append(room.pilot.snapshot.goals)

    room.run(beats=300, at_beat=wander)
    chain = room.arm.chain
    goals = np.array(seen)[:, : chain.dof]
    assert (goals >= chain.lower_rad - 1e-3).all()
    assert (goals <= chain.upper_rad + 1e-3).all()
    assert np.abs(np.diff(goals, axis=0)).max() > 0.0


def test_a_silent_page_holds_within_the_dead_man_time(room):
    room.throw_live()
    room.say(said.SetSpeed, name="slow")
    room.click(480, 300)
    said_s, goals = room.clock.now_s(), []
    see = room.pilot.on_cycle
    room.pilot.on_cycle = lambda beat: (see(beat), goals.append((room.clock.now_s(), beat.goals)))
    room.pilot.step()
    moved_s = [s for (s, goal), (_, before) in zip(goals[1:], goals, strict=False)
               if not np.array_equal(goal, before)]  # fmt: skip
    braking_s = 0.25 + 0.02  # and two beats
    assert 0.2 < moved_s[-1] - said_s < 0.3 + braking_s
    assert not room.told()["status"]["live"]


def test_after_silence_only_live_begins_again(room):
    room.throw_live()
    room.click(480, 300)
    room.pilot.step()
    before = registers(room.arm, "goal_position")
    room.say(said.Heartbeat, visible=True)
    room.click(480, 300)
    room.run(beats=50)
    assert registers(room.arm, "goal_position") == before


def test_a_hidden_page_holds(room):
    room.throw_live()
    room.click(480, 300)
    room.run(at_beat=lambda n: n == 5 and room.say(said.Heartbeat, visible=False))
    assert not room.told()["status"]["live"]


def test_a_page_that_leaves_holds(room):
    room.throw_live()
    room.click(480, 300)
    room.desk.disconnect(room.visitor)
    assert not room.pilot.command.live


def test_a_gesture_that_is_taken_back_holds_the_arm_where_it_is(room):
    room.throw_live()
    start = room.pilot.snapshot.measured
    room.point("down", 480, 300)
    room.run(at_beat=lambda n: n == 120 and room.point("cancel", 480, 300))
    room.run(beats=100)
    assert np.abs(room.goals[0] - start).max() > 0.1
    assert np.ptp(room.goals, axis=0).max() < 0.03


CUT_S = [0.15 + number * 0.009 for number in range(100)]
STILL_RAD = 5e-4  # from one goal to the next
BEATS_S = 0.02  # until a beat heeds it, and the servos are told


@pytest.mark.parametrize(("way", "notice_s"), [("closed", 0.0), ("silent", 0.3)])
@pytest.mark.parametrize(
    "cuts",
    [CUT_S[5::50], *(pytest.param(CUT_S[n::5], marks=pytest.mark.campaign) for n in range(5))],
    ids=lambda cuts: f"{len(cuts)} from {cuts[0]:.3f} s",
)
def test_a_line_that_is_cut_in_mid_drag_holds_the_arm_each_time(room, cuts, way, notice_s):
    for cut_s in cuts:
        assert held_s(room, cut_s, way) - cut_s < notice_s + BEATS_S + longest_brake_s(room.arm)
        assert not room.pilot.command.live


def longest_brake_s(arm):
    """Return what it takes at most to come to rest: speed that still grows ends growing first."""
    pace = arm.model.speed("fast")
    return pace.rad_s / pace.rad_s2 + 2.0 * pace.rad_s2 / pace.rad_s3


def held_s(room, cut_s, way):
    """Drag until the line is cut; return when the servos were last told anything new."""
    beats_s = []

    def drag(_):
        beats_s.append(room.clock.now_s())
        now_s = beats_s[-1] - beats_s[0]
        if now_s < cut_s:
            angle = 6.0 * now_s
            room.point("move", 480 + 90 * math.cos(angle), 300 + 90 * math.sin(angle))
        elif way == "closed" and room.pilot.command.live:
            room.desk.disconnect(room.visitor)
            room.visitor = room.arrive()

    room.throw_live()
    room.point("down", 570, 300)
    told = room.listen_in()
    room.run(at_beat=drag, beating=False)
    room.point("cancel", 480, 300)
    goals = np.array([goal for _, goal in told])
    changed = np.flatnonzero(np.abs(np.diff(goals, axis=0)).max(axis=1) > STILL_RAD) + 1
    return told[changed[-1]][0] - beats_s[0]


def test_a_stop_after_an_acknowledgement_stands(room):
    room.say(said.Stop)
    room.pilot.step()
    room.say(said.Acknowledge)
    room.say(said.Stop)
    room.pilot.step()
    assert room.told()["status"]["mode"] == "stopped"


def test_a_fault_of_the_view_itself_is_told(room):
    def fail():
        raise ZeroDivisionError

    room.pilot.step = fail
    with pytest.raises(ZeroDivisionError):
        room.pilot._run_thread()
    assert "has failed" in room.told()["status"]["banner"]["message"]


def test_the_limits_of_an_arm_that_was_opened_again_are_the_new_ones(room):
    before = room.desk._interaction
    room.told()
    assert room.desk._interaction is before
    room.pilot.arm = open_arm("so101", "sim:?pose=home")
    room.told()
    assert room.desk._interaction._chain is room.pilot.arm.chain
    room.pilot.arm.close()


def test_a_trigger_opens_the_gripper_and_lifting_it_stops_the_jaws(room):
    room.throw_live()
    before = room.pilot.snapshot.measured[-1]
    closing = room.arm.model.gripper.closed - room.arm.model.gripper.open

    def press(number):
        if number % 5 == 0:
            room.say(said.Gamepad, axes=[0, 0, 0, 0], grip=-1.0 if number < 60 else 0.0)

    room.run(beats=250, at_beat=press)
    goals = np.array(room.goals)
    assert (goals[-1, -1] - before) * closing < -0.05
    assert np.ptp(goals[150:, -1]) < 0.02
    assert np.ptp(goals[:, :-1], axis=0).max() < 0.02


def test_live_that_is_thrown_again_while_the_arm_brakes_is_thrown(room):
    room.throw_live()
    room.click(480, 300)

    def off_and_on(number):
        if number == 40:
            room.say(said.SetLive, on=False)
            room.say(said.SetLive, on=True)

    room.run(beats=200, at_beat=off_and_on)
    assert room.told()["status"]["live"]


def test_a_stop_latches(room):
    room.throw_live()
    room.click(480, 300)
    room.run(at_beat=lambda n: n == 5 and room.say(said.Stop))
    room.pilot.step()
    assert room.told()["status"]["mode"] == "stopped"
    with pytest.raises(BadMessageError, match="The arm was stopped"):
        room.throw_live()


def test_a_stop_without_words_is_a_stop(room):
    room.pilot.request_stop(StopReason(StopKind.CLIENT))
    room.pilot.step()
    assert room.told()["status"]["mode"] == "stopped"
    assert room.arm.stop_reason.kind is StopKind.CLIENT


def test_after_an_acknowledgement_the_arm_moves_again(room):
    room.say(said.Stop)
    room.pilot.step()
    room.say(said.Acknowledge)
    room.pilot.step()
    room.throw_live()
    room.click(480, 300)
    wanted = room.desk._interaction.marker.target_m
    room.run()
    assert math.dist(true_tip_m(room.arm), wanted) < 0.002


def test_a_silent_servo_is_named_on_the_banner(room):
    room.throw_live()
    room.click(480, 300)
    silent = Fault("silent", id=3, at_s=line_of(room.arm).world.time_s + 0.1)
    line_of(room.arm).faults.add(silent)
    room.run()
    assert "elbow_flex (id 3)" in room.told()["status"]["banner"]["message"]


ASKING = [
    (said.SetLive, {"on": True}),
    (said.Stop, {}),
    (said.Acknowledge, {}),
    (said.TakeControl, {"on": True}),
    (said.SetSpeed, {"name": "fast"}),
    (said.SetSolver, {"name": "ccd"}),
    (said.GoToPose, {"name": "rest"}),
    (said.CalibrationAnswer, {"action": "start"}),
    (said.Key, {"key": "ArrowUp"}),
    (said.SelectBehind, {"step": 1}),
    (said.PreferPosture, {"pose": "rest"}),
    (said.Gamepad, {"axes": [1, 0, 0, 0]}),
    (said.Wheel, {"x": 480, "y": 300, "notches": 1}),
    (said.Pointer, {"phase": "down", "x": 480, "y": 300, "button": 0, "pointer": 1}),
]


def pixel_of_hub(room, joint):
    items = room.told()["scene"]["items"]
    return next(i["at"] for i in items if i["style"] == "hub" and i.get("joint") == joint)


def test_what_is_under_the_pointer_is_told_by_depth(room):
    room.point("hover", *pixel_of_hub(room, "elbow_flex"))
    under = room.told()["status"]["under"]
    links = [row for row in under if row["depth"]]
    assert links[0]["name"] in {"upper_arm", "forearm"}
    assert links[0]["depth"] == "nearest"
    assert [row["chosen"] for row in under] == [True] + [False] * (len(under) - 1)
    assert under[len(links)]["name"] == "the tip comes here"


def test_the_key_for_behind_chooses_the_next_of_them(room):
    room.point("hover", *pixel_of_hub(room, "elbow_flex"))
    first = room.told()["scene"]["hover"]
    room.say(said.SelectBehind, step=1)
    told = room.told()
    assert told["status"]["under"][1]["chosen"]
    assert told["scene"]["hover"] != first


def test_after_a_tap_the_list_stays_though_a_finger_leaves(room):
    fields = {"x": 480, "y": 300, "button": 0, "pointer": 1, "touch": True}
    for phase in ("down", "up", "leave"):
        room.say(said.Pointer, phase=phase, **fields)
    assert room.told()["status"]["under"]
    room.point("leave", 480, 300)
    assert not room.told()["status"]["under"]


def test_over_nothing_only_the_tip_can_come(room):
    room.point("hover", 5, 5)
    assert [row["name"] for row in room.told()["status"]["under"]] == ["the tip comes here"]


@pytest.mark.parametrize("method", ["ccd", "transpose"])
def test_a_drag_is_answered_by_the_chosen_method_and_goes_on_while_the_pointer_rests(room, method):
    room.say(said.SetSolver, name=method)
    tip = next(i["at"] for i in room.told()["scene"]["items"] if i["style"] == "tip")
    room.point("down", *tip)
    room.point("move", tip[0] + 30, tip[1] - 30)
    assert room.told()["status"]["solver"]["text"].startswith(f"{method}: ")
    for _ in range(200):
        room.told()
    assert room.desk._interaction.marker.gap_m < 2e-3


def test_the_preferred_posture_is_told_and_leans_where_the_tip_leaves_freedom(room):
    room.say(said.PreferPosture, pose="rest", weights={"shoulder_pan": 0.0})
    room.click(480, 300)
    leaning, gestures = room.desk._interaction.goal, room.desk._interaction
    room.say(said.PreferPosture, pose="none")
    gestures.reset()
    room.click(480, 300)
    assert gestures.marker.reached
    assert np.abs(leaning - gestures.goal).max() > 0.05
    assert room.told()["status"]["preference"]["pose"] == "none"


def test_a_method_without_a_null_space_says_that_it_does_not_lean(room):
    room.say(said.PreferPosture, pose="rest")
    assert room.told()["status"]["preference"]["note"] == ""
    room.say(said.SetSolver, name="ccd")
    assert "does not lean" in room.told()["status"]["preference"]["note"]


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"pose": "nowhere"}, "no pose"),
        ({"pose": "rest", "weights": {"knee": 1.0}}, "no joint"),
    ],
)
def test_a_preference_that_makes_no_sense_is_refused(room, fields, why):
    with pytest.raises(BadMessageError, match=why):
        room.say(said.PreferPosture, **fields)
    assert room.told()["status"]["preference"]["pose"] == "none"


def test_an_iteration_that_ends_elsewhere_does_not_call_it_the_nearest_point(room):
    room.say(said.SetSolver, name="transpose")
    room.click(60, 60)
    assert "transpose ended" in room.told()["status"]["messages"][-1]["message"]


def posture_rows(told):
    return {name: words for name, words, _ in told["status"]["posture"]}


def later(room, name):
    """Return words about the posture that take a while to be found out."""
    for _ in range(500):
        told = room.told()
        if "status" in told and name in posture_rows(told):
            return posture_rows(told)[name]
        threading.Event().wait(0.01)
    raise AssertionError(f"{name} is never told")


def test_manipulability_is_that_of_the_jacobian(room):
    q = room.pilot.snapshot.measured[:5]
    J = room.arm.chain.jacobian(q)[:3]
    value, unit = posture_rows(room.told())["manipulability"].split(",")[0].split()
    assert float(value) == pytest.approx(math.sqrt(np.linalg.det(J @ J.T)), rel=0.05)
    assert unit == "m³"


def test_the_nearest_singularity_and_hidden_links_are_told_once_the_arm_rests(room):
    assert later(room, "singularity").endswith(("inside the limits", "elbow_flex"))
    room.say(said.SetViewport, w=900, h=700, dpr=1, view="top")
    assert "shoulder (by " in later(room, "hidden here")


def asks_in_vain(room, visitor, asking, why):
    """Say that nothing of all that is done, and for which reason."""
    wish = room.pilot.command
    for kind, fields in asking:
        with pytest.raises(BadMessageError, match=why):
            room.say(kind, visitor, **fields)
        assert room.pilot.command is wish, kind.__name__


def test_who_only_watches_changes_nothing(room):
    asks_in_vain(room, room.arrive(Permission.WATCH), ASKING, "for watching only")


def test_who_is_not_in_control_changes_nothing(room):
    free = (said.Stop, said.Acknowledge, said.TakeControl)
    asking = [(kind, fields) for kind, fields in ASKING if kind not in free]
    asks_in_vain(room, room.arrive(), asking, "Another page")


def test_everybody_with_the_key_may_stop(room):
    room.say(said.Stop, room.arrive())
    room.pilot.step()
    assert room.told()["status"]["mode"] == "stopped"


def test_taking_control_takes_live_off(room):
    room.throw_live()
    other = room.arrive()
    room.say(said.TakeControl, other, on=True)
    assert not room.pilot.command.live
    assert room.told(other)["status"]["controller"] == "you"


def test_who_comes_next_begins_slowly(room):
    room.throw_live()
    room.desk.disconnect(room.visitor)
    assert room.told(room.arrive())["status"]["speed"] == "slow"


def test_an_unknown_pose_is_refused_with_the_known_ones(room):
    for name in ("nowhere", "homes"):
        with pytest.raises(BadMessageError, match="no pose"):
            room.say(said.GoToPose, name=name)


@pytest.mark.parametrize(
    ("pose", "joint", "upper_deg"), [("rest", "elbow_flex", 80.0), ("home", "wrist_flex", 57.0)]
)
def test_a_pose_beyond_narrower_limits_is_gone_to_at_the_limit_and_told(pose, joint, upper_deg):
    model = narrowed("so101", **{joint: (-90.0, upper_deg)})
    with Room(open_arm(model, f"sim:{model.path}?pose=zero")) as room:
        room.say(said.GoToPose, name=pose)
        goal = dict(zip(room.arm.where().names, room.desk._interaction.goal, strict=True))
        assert math.degrees(goal[joint]) == pytest.approx(upper_deg, abs=0.1)
        assert any(words.startswith(joint) for words in room.desk._interaction.messages)


def test_what_stands_still_is_not_sent_sixty_times_a_second(room):
    room.told()
    assert [frame["kind"] for frame in room.desk.frames(room.visitor)] == []


def test_the_goal_of_a_wheel_is_a_degree_a_notch(room):
    hub = next(item for item in room.told()["scene"]["items"]
               if item["style"] == "hub" and item.get("joint") == "elbow_flex")  # fmt: skip
    room.say(said.Wheel, x=hub["at"][0], y=hub["at"][1], notches=3)
    turned = room.desk._interaction.goal - room.pilot.snapshot.measured
    assert math.degrees(np.abs(turned).max()) == pytest.approx(3.0, abs=0.3)


def test_commands_to_the_pilot_are_posted_whole(room):
    command = replace(room.pilot.command, speed="fast")
    room.pilot.post(command)
    assert room.pilot.command is command
    with pytest.raises(AttributeError):
        room.pilot.command = command


def test_a_page_that_has_told_no_size_has_no_camera(room):
    visitor = Client(9, Permission.WATCH, Viewpoint("side"))
    with pytest.raises(BadMessageError, match="size of its drawing"):
        FrameComposer(room.pilot, Interaction(room.arm), room.clock).camera(visitor)


def test_a_gesture_before_the_size_is_told_is_no_gesture(room):
    visitor = room.desk.connect(Permission.CONTROL)
    room.say(said.TakeControl, visitor, on=True)
    room.point("down", 400, 300, visitor)
    assert room.pilot.command.goal is None
