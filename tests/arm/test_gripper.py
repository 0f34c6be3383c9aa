"""The gripper opens and closes, stops at an object between its jaws, and holds it gently."""

import itertools
import math

import pytest

import ikservo
from ikservo.errors import BadValueError, IkservoError, InputError, UnknownNameError
from servosim.joint import Hand, hold
from tests.arm.simulated import line_of, registers, servo_id
from tests.oracle import arm_file

# An arm with each way of limiting the force: Feetech, XL330, a slide on XM430, XL430.
ARMS = ("so101", "koch", "open_manipulator_x", "px100")
TWO = ("so101", "open_manipulator_x")  # in the suite: a torque limit, and a PWM goal on a slide
LIMITS = {"so101": ("torque_limit", 1000), "koch": ("goal_pwm", 885),
          "open_manipulator_x": ("goal_pwm", 885), "px100": ("goal_pwm", 885)}  # fmt: skip


@pytest.fixture
def so101():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:  # a third open
        yield machine


def jaws(arm):
    return arm.model.gripper


def open_jaws(arm):
    """Open the jaws by hand before torque comes on, because a first motion is slow."""
    line_of(arm).world.place(jaws(arm).joint, jaws(arm).open)


def put_between(arm, share):
    """Put something stiff between the jaws, at the given fraction of their opening."""
    closed, opened = jaws(arm).closed, jaws(arm).open
    at = closed + share * (opened - closed)
    only = 1 if opened > closed else -1
    line_of(arm).world.grasp(jaws(arm).joint, Hand(hold(at), limit=1e4, only=only))
    return at


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "name", [n if n in TWO else pytest.param(n, marks=pytest.mark.campaign) for n in ARMS]
)
def test_gripper_force_does_not_exceed_requested_force(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        open_jaws(arm)
        at = put_between(arm, 0.2)
        report = arm.gripper("close", force=0.2)
        own = servo_id(name, jaws(arm).joint)
        register, full = LIMITS[name]
        assert (report.grasped, report.reached) == (True, False)
        span = abs(jaws(arm).open - jaws(arm).closed)
        assert report.position_rad == pytest.approx(at, abs=0.04 * span)
        assert abs(line_of(arm).servos[own].motor.pwm) <= 0.21
        assert registers(arm, register)[own] == pytest.approx(0.2 * full, abs=1)


def test_empty_gripper_reports_no_grasp(so101):
    report = so101.gripper("close")
    assert (report.reached, report.grasped) == (True, False)
    assert report.position_rad == pytest.approx(jaws(so101).closed, abs=0.06)


LONG = pytest.mark.campaign
# Least forces: 1.5 times the friction of an STS3215 of 7.4 V, 2 % of its torque, and 0.7 % and
# 1.8 % of an XL330's and an XL430's, are below what moves fast enough.
LEAST = {"so101": 0.05, "koch": 0.05, "px100": 0.05}
FEW = (("so101", "open", 1.0), ("koch", "half-way", 1.4))
CREEPING = [
    pytest.param(*case, marks=() if case in FEW else LONG)
    for case in itertools.product(LEAST, ["open", "half-way"], [1.0, 1.4])
]


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(("name", "begun", "share"), CREEPING)
def test_slowly_closing_empty_jaws_report_no_grasp(name, begun, share):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        half = (jaws(arm).closed + jaws(arm).open) / 2
        line_of(arm).world.place(jaws(arm).joint, jaws(arm).open if begun == "open" else half)
        report = arm.gripper("close", force=share * LEAST[name])
        assert (report.reached, report.grasped) == (True, False)


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "name", ["so101", *(pytest.param(name, marks=LONG) for name in ("koch", "px100"))]
)
def test_gripper_minimum_force_grasps_object(name):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        open_jaws(arm)
        at = put_between(arm, 0.3)
        report = arm.gripper("close", force=LEAST[name])
        assert (report.reached, report.grasped) == (False, True)
        assert report.position_rad == pytest.approx(
            at, abs=0.04 * abs(jaws(arm).open - jaws(arm).closed)
        )


@pytest.mark.parametrize(("name", "least"), LEAST.items())
def test_gripper_force_error_names_minimum_force(name, least):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        with pytest.raises(BadValueError, match=f"a fraction from {least:g} to 1 on this arm"):
            arm.gripper("close", force=least - 0.01)
        assert not any(registers(arm, "torque_enable").values())


@pytest.mark.full
def test_gripper_closes_until_soft_object_stops_yielding(so101):
    open_jaws(so101)
    closed, opened = jaws(so101).closed, jaws(so101).open
    there, end = (closed + share * (opened - closed) for share in (0.6, 0.3))
    sponge = Hand(lambda s: (max(there - 0.15 * s, end), 0.0), limit=1e4, only=1)
    line_of(so101).world.grasp("gripper", sponge)
    report = so101.gripper("close")
    assert report.grasped
    assert report.position_rad == pytest.approx(end, abs=0.04 * (opened - closed))


def test_gripper_motion_ends_although_jaws_never_rest(so101):
    open_jaws(so101)
    there = 0.5 * (jaws(so101).open + jaws(so101).closed)

    def swing(time_s):
        return there + 0.02 * math.sin(2.0 * time_s), 0.04 * math.cos(2.0 * time_s)

    line_of(so101).world.grasp(jaws(so101).joint, Hand(swing, limit=1e4, only=1))
    clock = so101.context.servos.clock
    begun_s = clock.now_s()
    so101.gripper("close")
    assert 30.0 < clock.now_s() - begun_s < 70.0


def test_jaws_that_are_stuck_open_report_no_grasp(so101):
    open_jaws(so101)
    line_of(so101).servos[servo_id("so101", "gripper")].motor.stuck = True
    report = so101.gripper("close")
    assert (report.reached, report.grasped) == (False, False)


def test_slowly_closing_jaws_do_not_stop_arm():
    with ikservo.open_arm("koch", port="sim:?pose=home") as arm:
        assert not arm.gripper("close", force=0.1).grasped
        assert arm.stopped_for == ""


@pytest.mark.full
def test_enable_keeps_grasp_force_of_gripper(so101):
    open_jaws(so101)
    put_between(so101, 0.2)
    so101.gripper("close", force=0.2)
    so101.enable()  # as the next program does with an arm that holds
    so101.move_joints({"shoulder_pan": 0.1}, speed="fast")
    assert abs(line_of(so101).servos[servo_id("so101", "gripper")].motor.pwm) <= 0.21


@pytest.mark.full
def test_grasp_holds_during_moves_until_gripper_opens(so101):
    put_between(so101, 0.3)
    held = so101.gripper("close").position_rad
    assert so101.move_joints({"shoulder_pan": 0.1}, speed="fast").reached
    gripper = so101.where().joints[-1]
    assert (gripper.torque, gripper.position_rad) == (True, pytest.approx(held, abs=0.02))
    assert so101.gripper("open").reached


def test_gripper_force_does_not_limit_torque_of_other_joints(so101):
    put_between(so101, 0.33)
    so101.gripper("close", force=0.25)
    others = [value for i, value in registers(so101, "torque_limit").items() if i != 6]
    assert others == [1000] * 5


def test_gripper_opens_to_requested_width():
    with ikservo.open_arm("open_manipulator_x", port="sim:?pose=home") as arm:
        report = arm.gripper(width_m=0.055)
        assert report.reached
        assert report.width_m == pytest.approx(0.055, abs=2e-3)
        assert arm.gripper(0.05).width_m == pytest.approx(0.05, abs=2e-3)


@pytest.mark.parametrize("name", ["px100", "wx250s", "vx300s"])
def test_gripper_width_of_cranked_jaws_follows_crank(name):
    radius_m, rod_m = (0.022, 0.036) if name == "vx300s" else (0.014, 0.024)
    gripper = ikservo.load_model(name).gripper
    for share in (0.0, 0.3, 0.6, 1.0):
        angle = gripper.closed + share * (gripper.open - gripper.closed)
        finger_m = radius_m * math.sin(angle) + math.sqrt(
            rod_m**2 - (radius_m * math.cos(angle)) ** 2
        )
        assert gripper.width_m(angle) == pytest.approx(2 * finger_m, abs=1e-3)


@pytest.mark.parametrize("width_m", [-0.01, 0.3, math.nan, math.inf])
def test_gripper_width_out_of_range_moves_nothing(width_m):
    with ikservo.open_arm("open_manipulator_x", port="sim") as arm:
        with pytest.raises(BadValueError, match=r"0\.020 to 0\.082 m"):
            arm.gripper(width_m=width_m)
        assert not any(registers(arm, "torque_enable").values())


def test_gripper_without_width_table_refuses_width(so101):
    with pytest.raises(BadValueError, match="has no widths"):
        so101.gripper(width_m=0.03)


@pytest.mark.parametrize("force", [0, -1, 1.01, math.nan, "hard"])
def test_gripper_force_outside_0_to_1_is_refused(so101, force):
    with pytest.raises(BadValueError, match="The force"):
        so101.gripper("close", force=force)
    assert not any(registers(so101, "torque_enable").values())


@pytest.mark.parametrize(("to", "width_m"), [(None, None), ("open", 0.02)])
def test_gripper_method_needs_either_open_close_or_width(so101, to, width_m):
    with pytest.raises(InputError, match="open, close and a width"):
        so101.gripper(to, width_m=width_m)


def test_unknown_gripper_command_error_lists_known_ones(so101):
    with pytest.raises(UnknownNameError, match="close, open"):
        so101.gripper("ajar")


def test_arm_without_gripper_refuses_gripper_command():
    with (
        ikservo.open_arm("planar3", port="sim") as arm,
        pytest.raises(IkservoError, match="has no gripper"),
    ):
        arm.gripper("open")


def test_shipped_gripper_closed_position_is_nearer_zero():
    for name in ("so101", "so100", "koch", "omx_f", "open_manipulator_x", "px100", "vx300s"):
        gripper = ikservo.load_model(name).gripper
        joint = next(j for j in arm_file(name)["joints"] if j["role"] == "gripper")
        assert gripper.joint == joint["name"]
        assert abs(gripper.closed) < abs(gripper.open)
