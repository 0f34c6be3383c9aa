"""An arm follows a stream of setpoints and stops when it ends; a jog lasts while it is fed."""

import math
import subprocess
import sys

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, InputError, RefusedError, UnknownNameError
from ikservo.planning.context import ArmContext
from servosim.joint import Hand, glide
from tests.arm.audit import Auditor
from tests.arm.simulated import (
    line_of,
    motion_runner,
    registers,
    servo_group,
    servo_id,
    true_joints,
    true_tip_m,
)
from tests.oracle import tip_from_joints


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


def cycle_count(arm, seconds):
    return round(seconds / motion_runner(arm).loop.measure_cycle_time_s())


def circle(centre_m, radius_m, count):
    for angle in np.linspace(0.0, 2 * math.pi, count):
        yield centre_m + radius_m * np.array([0.0, math.sin(angle), 1.0 - math.cos(angle)])


@pytest.mark.full
def test_follow_traces_circle_and_reports_final_position(arm):
    centre_m = arm.where().tip_m
    seen = []
    report = arm.follow(
        circle(centre_m, 0.02, cycle_count(arm, 0.8)), speed="fast", on_progress=seen.append
    )
    tips = np.array([p.tip_m for p in seen])
    assert (report.unreached, report.refused, report.ended) == (0, 0, "end of the targets")
    assert np.ptp(tips[:, 1]) == pytest.approx(0.04, abs=0.01)
    np.testing.assert_allclose(report.measured_tip_m, true_tip_m(arm), atol=2e-3)
    assert np.linalg.norm(true_tip_m(arm) - centre_m) < 0.02


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "setpoint",
    [
        lambda T: ikservo.Target(T[:3, 3] + (0.0, 0.02, 0.0)),
        lambda T: ikservo.Target(T[:3, 3], direction=T[:3, 2]),
        lambda T: T,
        lambda T: T[:3, 3].tolist(),
        lambda T: {"gripper": 0.6},
    ],
)
def test_follow_accepts_every_kind_of_setpoint(arm, setpoint):
    joints = np.array([state.position_rad for state in arm.where().joints])
    T = arm.chain.forward(arm.joint_index.chain_joints(joints))
    report = arm.follow([setpoint(T)] * 5)
    assert (report.setpoints, report.refused) == (5, 0)


LOADED = """
import sys, ikservo
seen = []
with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
    near = arm.where().tip_m + (0.0, 0.001, 0.0)
    arm.follow([near] * 5, on_progress=lambda _: seen.append(set(sys.modules)))
print(*sorted(seen[-1] - seen[0]))
"""


@pytest.mark.full
def test_follow_imports_no_modules_between_goals():
    ran = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == []


def test_follow_ends_with_arm_holding_after_300_ms_silence(arm):
    def stream():
        yield {"shoulder_pan": 1.0}
        while True:
            yield None

    times_s = []
    report = arm.follow(stream(), on_progress=lambda _: times_s.append(arm.clock.now_s()))
    assert report.ended == "no target for 0.3 s"
    assert 0.3 <= times_s[-1] - times_s[0] <= 0.9
    assert all(registers(arm, "torque_enable").values())
    assert true_joints(arm)["shoulder_pan"] < 0.6


def test_follow_checks_collision_from_start_pose_of_each_goal(arm, monkeypatch):
    began, rests = list(true_joints(arm).values()), []
    monkeypatch.setattr(ArmContext, "check_trajectory", lambda *words: rests.append(words[2]))
    arm.follow({"shoulder_pan": pan} for pan in np.linspace(0.0, 0.5, cycle_count(arm, 0.5)))
    assert len(rests) > 10
    np.testing.assert_allclose(rests, [began] * len(rests), atol=0.01)


def test_blocked_setpoint_iterator_counts_as_silent_stream(arm):
    def stream():
        yield {"shoulder_pan": 1.0}
        servo_group(arm).clock.sleep_until(arm.clock.now_s() + 1.0)
        yield {"shoulder_pan": -1.0}

    assert arm.follow(stream()).ended == "no target for 0.3 s"
    assert true_joints(arm)["shoulder_pan"] > -0.05


@pytest.mark.full
def test_delayed_progress_callback_is_not_stream_silence(arm):
    delays_s = iter([0.0, 0.0, 0.5])

    def delayed(_):
        servo_group(arm).clock.sleep_until(arm.clock.now_s() + next(delays_s, 0.0))

    report = arm.follow([{"shoulder_pan": 0.2}] * 200, on_progress=delayed)
    assert report.ended == "end of the targets"
    assert report.setpoints == 200


def test_follow_report_counts_unreachable_setpoints(arm):
    report = arm.follow([(0.9, 0.0, 0.2)] * 20)
    assert report.unreached == 20


@pytest.mark.full
def test_follow_setpoint_beyond_limit_stops_at_joint_limit(arm):
    report = arm.follow([{"gripper": -5.0}] * cycle_count(arm, 2.5), speed="fast")
    lower = math.radians(-10.0)
    low_tick = 2048 + math.ceil(lower / (2 * math.pi) * 4096)
    assert registers(arm, "goal_position")[6] == low_tick
    assert report.measured_rad["gripper"] == pytest.approx(lower, abs=0.06)


def test_follow_skips_setpoint_refused_by_guard_with_reason(arm):
    before = true_tip_m(arm)
    report = arm.follow([{"shoulder_lift": 1.7, "elbow_flex": 0.5}] * cycle_count(arm, 1.0))
    assert report.refused == 1
    assert "would touch" in report.reason
    assert np.linalg.norm(true_tip_m(arm) - before) < 0.01


def exact_tip_m(arm):
    """Return the tip (3,) [m] of the true joints, without the rounding of ticks."""
    at = {joint.name: joint.position for joint in line_of(arm).world.joints}
    return tip_from_joints(arm.model.name, at)


# Friction of the koch's elbow, an XL330, grows with the square of its load: 1.04 mm are left.
@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "most_m"), [("so101", 1e-3), ("koch", 1.2e-3)])
def test_loaded_follow_ends_within_about_1_mm_of_last_point(name, most_m):
    with ikservo.open_arm(name, port="sim:?pose=home&backlash_deg=0.5") as arm:
        start_m = arm.where().tip_m
        way_m = np.linspace((0.0, 0.0, 0.0), (0.0, 0.04, 0.03), cycle_count(arm, 2.0))
        report = arm.follow(start_m + way_m)
        last_m = start_m + way_m[-1]
        assert (report.refused, report.ended) == (0, "end of the targets")
        assert np.linalg.norm(report.measured_tip_m - last_m) < most_m
        assert np.linalg.norm(exact_tip_m(arm) - last_m) < most_m


@pytest.mark.full
def test_follow_ends_at_last_setpoint_before_a_refused_one(arm):
    point_m = np.add(arm.where().tip_m, (0.02, 0.0, 0.02))
    below_m = point_m * (1.0, 1.0, 0.0) - (0.0, 0.0, 0.05)
    report = arm.follow([*[point_m] * cycle_count(arm, 1.5), *[below_m] * cycle_count(arm, 0.2)])
    assert report.refused == 1
    assert np.linalg.norm(exact_tip_m(arm) - point_m) < 1e-3


@pytest.mark.full
def test_arm_does_not_sag_after_braking_during_follow(arm):
    arm.pose("home")
    start = true_joints(arm)
    arm.follow([{"shoulder_pan": 1.0}])
    end = true_joints(arm)
    assert 0.02 < end["shoulder_pan"] - start["shoulder_pan"] < 0.6
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"):
        assert end[joint] == pytest.approx(start[joint], abs=math.radians(0.3)), joint


@pytest.mark.full
def test_follow_keeps_joints_not_named_by_setpoint_in_place(arm):
    arm.move_to((0.23, 0.02, 0.10))
    before = true_joints(arm)
    furthest = dict.fromkeys(before, 0.0)

    def observe(_):
        for joint, at in true_joints(arm).items():
            furthest[joint] = max(furthest[joint], abs(at - before[joint]))

    arm.follow([{"shoulder_pan": 0.1}] * cycle_count(arm, 1.0), on_progress=observe)
    observe(None)
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"):
        assert furthest[joint] < math.radians(0.6), joint


@pytest.mark.full
def test_follow_without_setpoints_moves_nothing(arm):
    arm.move_to((0.23, 0.02, 0.10))
    before = registers(arm, "goal_position")
    report = arm.follow([None] * 5)
    assert (report.setpoints, report.ended) == (0, "end of the targets")
    assert registers(arm, "goal_position") == before


@pytest.mark.campaign
def test_correction_of_constant_setpoint_ends_for_stuck_joint(arm):
    line_of(arm).servos[servo_id("so101", "wrist_flex")].motor.stuck = True
    auditor = Auditor(arm)
    arm.follow([{"wrist_flex": true_joints(arm)["wrist_flex"] + 0.04}] * cycle_count(arm, 6.0))
    end_s = auditor.goals[-1].time_s
    late = [g for g in auditor.goals if end_s - 3.5 < g.time_s < end_s - 3.0]
    assert late
    assert {g.tick - g.last for g in late} == {0}


@pytest.mark.parametrize(
    "setpoint",
    [(0.1, 0.2), "there", (math.nan, 0, 0), {"elbow_flex": math.inf}, {"elbow_flex": "up"},
     {3: 0.1}, np.zeros((4, 4)), 7],
)  # fmt: skip
def test_follow_refuses_invalid_setpoint_and_arm_holds(arm, setpoint):
    with pytest.raises(InputError):
        arm.follow([{"shoulder_pan": 0.1}, setpoint])
    assert all(registers(arm, "torque_enable").values())
    assert arm.stopped_for == ""


def test_unknown_joint_error_of_follow_suggests_closest_name(arm):
    with pytest.raises(UnknownNameError, match="Did you mean elbow_flex"):
        arm.follow([{"elbow_flexx": 0.1}])


def test_follow_brakes_arm_before_raising_iterator_exception(arm):
    def stream():
        yield {"shoulder_pan": 0.5}
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        arm.follow(stream())
    assert arm.move_joints({"gripper": 0.4}, speed="fast").reached


def test_joint_jog_continues_while_requested(arm):
    report = arm.jog(
        "shoulder_pan", 0.4, wanted=iter([True] * cycle_count(arm, 0.5) + [False]).__next__
    )
    assert report.ended == "no longer requested"
    assert true_joints(arm)["shoulder_pan"] == pytest.approx(0.2, abs=0.08)


def test_jog_ends_soon_after_last_request(arm):
    report = arm.jog("shoulder_pan", -0.3, wanted=lambda: None)
    assert report.ended == "no longer requested"
    assert -0.2 < true_joints(arm)["shoulder_pan"] < -0.03
    assert report.duration_s < 1.0


@pytest.mark.full
def test_jog_ends_at_joint_limit(arm):
    report = arm.jog("gripper", -1.0, wanted=lambda: True)
    assert report.ended == "gripper is at its limit"
    assert true_joints(arm)["gripper"] == pytest.approx(math.radians(-10), abs=0.06)


def test_tip_jog_moves_along_straight_line(arm):
    before = arm.where().tip_m
    end_s = arm.clock.now_s() + 0.8
    arm.jog("-y", 0.1, wanted=lambda: arm.clock.now_s() < end_s)
    way = true_tip_m(arm) - before
    assert way[1] == pytest.approx(-0.1 * 0.8, abs=0.03)  # it starts and brakes
    assert abs(way[[0, 2]]).max() < 0.015


def test_tip_jog_does_not_go_through_table(arm):
    report = arm.jog("down", 0.1, wanted=lambda: True)
    assert "would touch the table" in report.ended
    assert true_tip_m(arm)[2] > 0.0


def test_joint_jog_stops_before_contact_with_table(arm):
    before = true_joints(arm)["shoulder_lift"]
    report = arm.jog("shoulder_lift", 0.4, wanted=lambda: True)
    assert "gripper would touch the table" in report.ended
    assert true_joints(arm)["shoulder_lift"] > before + 0.3
    assert true_tip_m(arm)[2] > 0.0


@pytest.mark.parametrize("speed", [0, math.nan, math.inf, 2.0, "quick"])
def test_jog_with_invalid_speed_moves_nothing(arm, speed):
    with pytest.raises(BadValueError, match="The speed"):
        arm.jog("x", speed, wanted=lambda: True)
    assert not any(registers(arm, "torque_enable").values())


def test_jog_error_for_unknown_joint_lists_known_joints(arm):
    with pytest.raises(UnknownNameError, match="elbow_flex, gripper"):
        arm.jog("elbow", wanted=lambda: True)


@pytest.fixture
def leader():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


def test_follower_arm_mirrors_leader_moved_by_hand(arm, leader):
    hand = Hand(glide(0.0, 0.3, speed=0.8), limit=20.0)
    line_of(leader).world.grasp("shoulder_pan", hand)
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"):  # the other hand
        at = line_of(leader).world.joint(joint).position
        line_of(leader).world.grasp(joint, Hand(lambda _, at=at: (at, 0.0), limit=20.0))
    end_s = arm.clock.now_s() + 0.9
    report = arm.follow_arm(leader, speed="fast", until=lambda: arm.clock.now_s() > end_s)
    assert report.refused == 0
    assert true_joints(leader)["shoulder_pan"] == pytest.approx(0.3, abs=0.02)
    for joint, position in true_joints(leader).items():
        assert true_joints(arm)[joint] == pytest.approx(position, abs=0.05), joint
    assert not any(registers(leader, "torque_enable").values())


def test_silent_leader_makes_follower_hold(arm, leader):
    line_of(leader).world.servos[0].power_down()
    report = arm.follow_arm(leader)
    assert report.ended == "no target for 0.3 s"
    assert all(registers(arm, "torque_enable").values())


def test_follow_arm_refuses_arm_without_common_joint(arm):
    with (
        ikservo.open_arm("planar3", port="sim") as other,
        pytest.raises(InputError, match="no joint in common"),
    ):
        arm.follow_arm(other)


@pytest.mark.full
def test_recorded_motion_is_replayed(arm, leader, tmp_path):
    world = line_of(leader).world
    world.grasp("shoulder_pan", Hand(glide(0.0, 0.2, speed=0.5), limit=20.0))
    for joint in ("shoulder_lift", "elbow_flex", "wrist_flex"):
        at = world.joint(joint).position
        world.grasp(joint, Hand(lambda _, at=at: (at, 0.0), limit=20.0))
    taken = leader.record(tmp_path / "wave.jsonl", duration_s=0.6)
    assert taken.samples == pytest.approx(30, abs=1)
    report = arm.replay(tmp_path / "wave.jsonl", speed="fast")
    assert report.samples == taken.samples
    for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex"):  # in spite of their load
        assert true_joints(arm)[joint] == pytest.approx(true_joints(leader)[joint], abs=0.005)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (('"so101"', '"koch"'), "has arm koch"),
        (('"elbow_flex"', '"ellbow"'), "has joints"),
        (('"rad", "rad", "rad", "rad", "rad", "rad"', '"rad", "rad", "rad", "rad", "rad", "m"'),
         "has units"),
    ],
)  # fmt: skip
def test_recording_of_another_arm_is_refused(arm, tmp_path, change, found):
    arm.record(tmp_path / "wave.jsonl", duration_s=0.1)
    text = (tmp_path / "wave.jsonl").read_text().replace(*change)
    (tmp_path / "wave.jsonl").write_text(text)
    with pytest.raises(InputError, match=found):
        arm.replay(tmp_path / "wave.jsonl")
    assert not any(registers(arm, "torque_enable").values())


def test_recording_outside_limits_is_refused_with_line_number(arm, tmp_path):
    arm.record(tmp_path / "wave.jsonl", duration_s=0.1)
    lines = (tmp_path / "wave.jsonl").read_text().splitlines(keepends=True)
    lines[3] = '{"t_s": 0.04, "q": [9.0, 0, 0, 0, 0, 0]}\n'
    (tmp_path / "wave.jsonl").write_text("".join(lines))
    with pytest.raises(RefusedError, match=r"line 4: shoulder_pan target 515\.7° is above"):
        arm.replay(tmp_path / "wave.jsonl")
    assert not any(registers(arm, "torque_enable").values())


@pytest.mark.parametrize("options", [{}, {"duration_s": 0}, {"duration_s": math.nan},
                                     {"duration_s": 1, "period_s": 0}])  # fmt: skip
def test_record_refuses_missing_duration_or_zero_period(arm, tmp_path, options):
    with pytest.raises(InputError):
        arm.record(tmp_path / "wave.jsonl", **options)
    assert not (tmp_path / "wave.jsonl").exists()


def fastest_deg_s(arm, motion):
    """Return the top speed of any servo's goal in a motion, over forty cycles.

    At slow speed this is 57 ticks; friction compensation shifts goals by up to four.
    """
    auditor = Auditor(arm)
    motion()
    at = {}
    for goal in auditor.goals:
        at.setdefault(goal.servo_id, []).append((goal.time_s, goal.tick))
    moved = [np.array(rows[40:]) - np.array(rows[:-40]) for rows in at.values() if len(rows) > 40]
    return (
        max(np.abs(ticks / times).max() for times, ticks in (rows.T for rows in moved)) * 360 / 4096
    )


MOTIONS = {
    "jog": lambda arm: arm.jog("elbow_flex", -2.0, wanted=iter([True] * 200 + [False]).__next__),
    "gripper": lambda arm: arm.gripper("close"),
    "follow": lambda arm: arm.follow([{"shoulder_pan": 0.5}] * cycle_count(arm, 0.8), speed="fast"),
}


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_first_motion_after_torque_on_is_slow(arm, motion):
    slow = math.degrees(arm.model.speed("slow").rad_s)
    assert fastest_deg_s(arm, lambda: motion(arm)) < 1.1 * slow
    arm.pose("home")
    assert fastest_deg_s(arm, lambda: motion(arm)) > 1.3 * slow


@pytest.mark.full
def test_follow_uses_full_speed_after_first_setpoint(arm):
    slow = math.degrees(arm.model.speed("slow").rad_s)
    here = [{"shoulder_pan": 0.02}] * cycle_count(arm, 0.2)
    there = [{"shoulder_pan": 0.8}] * cycle_count(arm, 0.8)
    assert fastest_deg_s(arm, lambda: arm.follow(here + there, speed="fast")) > 1.3 * slow
