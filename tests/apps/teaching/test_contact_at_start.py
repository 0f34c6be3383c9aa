"""An arm that rests on something may leave it, and is never moved deeper into it."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.recorder import recording_header
from ikservo.apps.teaching.recording import RecordingWriter
from ikservo.errors import CollisionError
from ikservo.guard import KeepOutBox
from ikservo.model.catalogue import arm_names
from tests.arm.seeds import log
from tests.arm.simulated import clock_of, context_of, line_of, registers

DOWN_M = np.array([0.0, 0.0, -0.03])
# Postures in which a person sets a limp arm down, degrees from zero: elbow up, elbow down, aside.
SET_DOWN = [{"shoulder_lift": 45, "elbow_flex": 10}, {"shoulder_lift": 20, "elbow_flex": -50}]


def open_limp(name, **kwargs):
    """Open an arm that has come to rest without torque."""
    arm = ikservo.open_arm(name, port="sim", **kwargs)
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 15.0)
    return arm


def set_down(arm, degrees):
    """Place joints of a limp arm by hand, and release them."""
    for joint, angle in degrees.items():
        line_of(arm).world.place(joint, math.radians(angle))
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 15.0)


def distances_m(arm, joints):
    context = context_of(arm)
    return context.collision.distances([context.index.body_joints(joints)])[0]


def measured_joints(arm):
    return np.array(list(arm.where().positions.values()))


def motions_down(arm):
    tip_m = arm.where().tip_m
    yield lambda: arm.plan_to(tip_m + DOWN_M)
    yield lambda: arm.plan_line(tip_m + DOWN_M)
    yield lambda: arm.plan_through([tip_m + DOWN_M, tip_m])
    yield lambda: arm.plan_arc(tip_m + DOWN_M, tip_m + np.array([0.02, 0.0, 0.0]))


def assert_no_plan_goes_deeper(arm):
    """Try motions down and back: each is refused, or stays as deep as the arm lies."""
    for plan_motion in motions_down(arm):
        try:
            plan = plan_motion()
        except ikservo.IkservoError:
            continue
        lying_m = np.minimum(distances_m(arm, plan.start), 0.0)
        for joints in plan.sample(0.02).positions:
            assert (distances_m(arm, joints) >= lying_m - 0.0015).all()


@pytest.mark.full
@pytest.mark.parametrize("name", ["koch", "px100"])
def test_arm_sagged_into_table_is_not_moved_deeper(name):
    with open_limp(name) as arm:
        assert_no_plan_goes_deeper(arm)


def test_downward_motion_in_table_contact_is_refused():
    with open_limp("koch") as arm:
        before = registers(arm, "goal_position")
        tip_m = arm.where().tip_m
        with pytest.raises(CollisionError, match="the table"):
            arm.move_through([tip_m + DOWN_M, tip_m])
        assert registers(arm, "goal_position") == before


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("degrees", SET_DOWN)
@pytest.mark.parametrize("name", ["so101", "so100"])
def test_arm_resting_on_table_is_not_moved_deeper(name, degrees):
    with open_limp(name) as arm:
        set_down(arm, degrees)
        assert_no_plan_goes_deeper(arm)


def refusal_of_home(name, seed):
    """Send an arm dropped in a random posture to its pose home; return the refusal, or None.

    A refused arm is moved by hand to where the hint says, and goes home from there.
    """
    with open_limp(name) as arm:
        lower, upper = arm.limits()
        postures = np.random.default_rng(seed).uniform(lower, upper, (500, len(lower)))
        joints = next(q for q in postures if distances_m(arm, q).min() > 0.0)
        set_down(arm, dict(zip(arm.joint_names, np.degrees(joints), strict=True)))
        refused = None
        try:
            assert arm.pose("home").reached
        except CollisionError as error:
            refused = error
        if refused is not None:
            assert "by hand" in refused.command_hint
            arm.relax()
            for joint, position in arm.model.pose("home").items():
                line_of(arm).world.place(joint, position)
            assert arm.pose("home").reached
        return refused


@pytest.mark.full
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_limp_arm_leaves_the_table_for_its_home_pose(seed):
    assert refusal_of_home("koch", seed) is None


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", arm_names())
def test_limp_arm_goes_home_from_nearly_every_posture(name, capsys):
    refused = list(filter(None, (refusal_of_home(name, seed) for seed in range(20))))
    log(capsys, f"{name}: home from {20 - len(refused)} of 20 limp postures; refused: {refused}")
    assert len(refused) <= 1


@pytest.fixture
def recorded(tmp_path):
    """Write joints (k, n) of an arm as a recording, half a second apart; return the file."""

    def write(arm, joints):
        path = tmp_path / "path.jsonl"
        with RecordingWriter(path, recording_header(arm.model, 0.5)) as writer:
            for i, q in enumerate(joints):
                writer.write(0.5 * i, q)
        return path

    return write


def lowered(arm, joints, height_m):
    """Return joints (n,) with the shoulder lowered until the arm is that deep in the table."""
    for angle in np.arange(0.0, 2.0, 0.01):
        low = arm.joint_index.with_position(
            joints, "shoulder_lift", joints[arm.joint_index.column("shoulder_lift")] + angle
        )
        if distances_m(arm, low).min() < height_m:
            return low
    raise AssertionError("the arm does not reach the table")


@pytest.mark.full
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_recording_that_starts_or_ends_in_table_is_refused(recorded, order):
    with ikservo.open_arm("so101", port="sim") as arm:
        arm.pose("home")
        home = measured_joints(arm)
        before = registers(arm, "goal_position")
        path = recorded(arm, [home, lowered(arm, home, -0.08)][order])
        with pytest.raises(CollisionError, match="the table"):
            arm.replay(path)
        assert registers(arm, "goal_position") == before


def test_recording_inside_obstacle_is_refused_even_from_inside(recorded):
    model = ikservo.load_model("so101")
    tip_m = model.chain.forward(model.chain_pose("home"))[:3, 3]
    box = KeepOutBox("the cup", tip_m - 0.02, tip_m + 0.02)
    with ikservo.open_arm(replace(model, keep_out=(box,)), port="sim") as arm:
        for joint, angle_rad in model.pose("home").items():
            line_of(arm).world.place(joint, angle_rad)
        arm.enable()
        path = recorded(arm, [measured_joints(arm)] * 2)
        with pytest.raises(CollisionError, match="the cup"):
            arm.replay(path)


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_recording_that_enters_obstacle_again_is_refused(name, tmp_path):
    model = ikservo.load_model(name)
    tip_m = model.chain.forward(model.chain_pose("home"))[:3, 3]
    cup = KeepOutBox("the cup", tuple(tip_m - 0.02), tuple(tip_m + 0.02))
    with ikservo.open_arm(replace(model, keep_out=(cup,)), port="sim:?pose=home") as arm:
        arm.enable()
        inside = arm.where().positions_rad
        outside = inside + 0.6 * (np.arange(len(inside)) == 0)
        path = tmp_path / "a.jsonl"
        with RecordingWriter(path, recording_header(arm.model, 1.5)) as writer:
            for k, joints in enumerate((outside, outside, inside, outside)):
                writer.write(1.5 * k, joints)
        before = registers(arm, "goal_position")
        with pytest.raises(CollisionError, match="the cup"):
            arm.replay(path)
        assert registers(arm, "goal_position") == before


@pytest.fixture
def recording_of_falling_arm(tmp_path):
    """Record an arm that was just opened and falls onto its table; return a function of its name.

    The function returns the file, and the joints (n,) in which the arm lay at the end.
    """

    def record(name):
        path = tmp_path / f"{name}.jsonl"
        with ikservo.open_arm(name, port="sim") as arm:
            arm.record(path, duration_s=1.0)
            return path, measured_joints(arm)

    return record


@pytest.mark.parametrize(
    "name",
    ["koch", *(pytest.param(n, marks=pytest.mark.full) for n in ("so100", "so101", "wx250s"))],
)
def test_recording_of_arm_that_fell_limp_can_be_replayed(recording_of_falling_arm, name):
    path, lying = recording_of_falling_arm(name)
    with ikservo.open_arm(name, port="sim") as fresh:
        assert fresh.load_replay(path)[0].joints.shape[1] == len(lying)
        fresh.replay(path)
        reached = np.array([joint.position for joint in line_of(fresh).world.joints])
        depth_m = np.minimum(distances_m(fresh, lying), 0.0)
        assert (distances_m(fresh, reached) >= depth_m - 0.0015).all()
        lower, upper = fresh.limits()
        within_limits = np.clip(lying[: len(lower)], lower, upper)
    np.testing.assert_allclose(reached[: len(within_limits)], within_limits, atol=math.radians(1.5))


@pytest.mark.full
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_refused_replay_hint_names_end_posture_of_recording(recording_of_falling_arm, name):
    path, lying = recording_of_falling_arm(name)
    with ikservo.open_arm(name, port="sim") as arm:
        arm.pose("home")
        with pytest.raises(CollisionError) as refused:
            arm.replay(path)
        assert "posture at the end of the recording" in refused.value.command_hint
        arm.disable_torque()
        set_down(arm, dict(zip(arm.joint_names, np.degrees(lying), strict=True)))
        arm.replay(path)
        reached = np.array([joint.position for joint in line_of(arm).world.joints])
    np.testing.assert_allclose(reached, lying, atol=math.radians(1.5))
