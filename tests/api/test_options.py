"""Options of motions: an unknown one is a TypeError that names it, and nothing moves."""

import dataclasses
import inspect
from typing import get_args

import numpy as np
import pytest

import ikservo
from ikservo.arm import Arm, MotionProgress, ToolOrientation, motions
from ikservo.arm.motion_methods import MotionMethods
from ikservo.model.tool import tool_frame
from ikservo.network.remote_arm import RemoteArm
from tests.arm.simulated import registers, true_joints, true_tip_m

NEAR = (0.23, 0.02, 0.10)
OF_MOTION = {
    "plan_to": ("move_to", (NEAR,)),
    "plan_line": ("move_line", (NEAR,)),
    "plan_drawing": ("draw", ([[NEAR]],)),
    "plan_arc": ("move_arc", ((0.22, 0.03, 0.1), NEAR)),
    "plan_through": ("move_through", ([NEAR],)),
    "move_to": ("move_to", (NEAR,)),
    "move_line": ("move_line", (NEAR,)),
    "draw": ("draw", ([[NEAR]],)),
    "move_arc": ("move_arc", ((0.22, 0.03, 0.1), NEAR)),
    "move_through": ("move_through", ([NEAR],)),
    "move_joints": ("move_joints", ({"wrist_roll": 0.1},)),
    "pose": ("move_pose", ("home",)),
    "look_at": ("look_at", ((1.0, 0.5, 0.3),)),
    "gripper": ("move_gripper", ("open",)),
    "replay": ("replay", ("wave.jsonl",)),
}
"""The methods that make a motion: its kind, and arguments that can be used."""


@pytest.fixture(scope="module")
def limp():
    """Return an arm that no test of this module may move or switch on."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine
        assert not any(registers(machine, "torque_enable").values())


def listed_options(method):
    """Return the options of a method; None where it lists its parameters one by one."""
    for parameter in inspect.signature(getattr(Arm, method), eval_str=True).parameters.values():
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            return set(get_args(parameter.annotation)[0].__annotations__)
    return None


def test_methods_with_options_are_all_tried_here():
    public = [name for name, _ in inspect.getmembers(Arm, inspect.isfunction) if name[0] != "_"]
    assert {name for name in public if listed_options(name)} == set(OF_MOTION)


@pytest.mark.parametrize("method", OF_MOTION)
def test_options_of_a_method_are_fields_of_its_motion(method):
    kind = motions.KINDS[OF_MOTION[method][0]]
    names = {each.name for each in dataclasses.fields(kind)}
    assert listed_options(method) - {"on_progress", "orientation"} <= names


@pytest.mark.parametrize("kind", motions.KINDS.values(), ids=motions.KINDS)
def test_fields_of_a_motion_are_explained_with_it(kind):
    explained = inspect.getdoc(kind)
    for each in dataclasses.fields(kind):
        assert f"    {each.name}: " in explained


BLOCKING = [*OF_MOTION, "follow", "follow_arm", "plan_joints"]
WAITING = [name for name in OF_MOTION if "wait" in inspect.signature(getattr(Arm, name)).parameters]


@pytest.mark.parametrize(
    ("method", "wait"),
    [*((name, {}) for name in BLOCKING), *((name, {"wait": False}) for name in WAITING)],
)
def test_options_that_are_unknown_are_named_by_the_call(limp, method, wait):
    arguments = OF_MOTION[method][1] if method in OF_MOTION else ({"wrist_roll": 0.1},)
    with pytest.raises(TypeError, match="unexpected keyword argument 'qqq'"):
        getattr(limp, method)(*arguments, **wait, qqq=1)


@pytest.mark.parametrize(
    ("method", "slip", "meant"),
    [
        ("move_to", {"sped": "slow"}, "speed"),
        ("move_to", {"waits": False}, "wait"),
        ("move_line", {"orientaton": np.eye(3)}, "orientation"),
        ("move_line", {"tool_speed": 0.1}, "tool_speed_m_s"),
        ("move_through", {"blend": 0.01}, "blend_m"),
        ("move_joints", {"on_progres": print}, "on_progress"),
        ("gripper", {"width": 0.03}, "width_m"),
        ("plan_through", {"lines": True}, "line"),
    ],
)
def test_a_mistyped_option_is_answered_with_the_closest(limp, method, slip, meant):
    with pytest.raises(TypeError, match=f"Did you mean '{meant}'"):
        getattr(limp, method)(*OF_MOTION[method][1], **slip)


@pytest.mark.parametrize(
    ("method", "option"),
    [("move_joints", "stance"), ("move_to", "line"), ("plan_to", "on_progress"), ("pose", "force")],
)
def test_options_of_another_motion_are_unknown(limp, method, option):
    with pytest.raises(TypeError, match=option):
        getattr(limp, method)(*OF_MOTION[method][1], **{option: None})


def test_remote_arms_have_the_same_methods_with_the_same_parameters():
    for name, method in inspect.getmembers(MotionMethods, inspect.isfunction):
        for arm in (Arm, RemoteArm) if name[0] != "_" else ():
            assert inspect.signature(getattr(arm, name)) == inspect.signature(method)


@pytest.mark.full
def test_options_reach_the_motion():
    goal_m, seen = (0.2, 0.04, 0.08), []
    options = {"speed": "fast", "stance": ToolOrientation(pitch_rad=-0.9)}
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.move_to(NEAR)
        plan = arm.plan_to(goal_m, **options)
        assert plan.speed == "fast"
        report = arm.move_to(goal_m, on_progress=seen.append, **options)
        assert (report.reached, report.orientation_requested) == (True, True)
        assert -0.05 <= report.motion_s - plan.duration_s <= 0.25  # rotors cross their play first
        assert all(isinstance(progress, MotionProgress) for progress in seen)
        np.testing.assert_allclose(true_tip_m(arm), goal_m, atol=0.003)
        joints = true_joints(arm)
        T_base_tip = arm.chain.forward([joints[name] for name in arm.chain.names])
        pitch_rad = tool_frame(arm.model).pitch_rad(T_base_tip[:3, :3])
        assert pitch_rad == pytest.approx(-0.9, abs=0.03)
    assert seen
