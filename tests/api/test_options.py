"""Options of motions: an unknown one is a TypeError that names it, and nothing moves."""

import inspect
from typing import get_args

import numpy as np
import pytest

import ikservo
from ikservo.arm import Arm, MotionProgress, ToolOrientation, motion_options
from ikservo.model.tool import tool_frame
from tests.arm.simulated import registers, true_joints, true_tip_m

NEAR = (0.23, 0.02, 0.10)
WITH_OPTIONS = {
    "plan_to": (NEAR,),
    "plan_line": (NEAR,),
    "plan_drawing": ([[NEAR]],),
    "plan_arc": ((0.22, 0.03, 0.1), NEAR),
    "plan_through": ([NEAR],),
    "move_to": (NEAR,),
    "move_line": (NEAR,),
    "draw": ([[NEAR]],),
    "move_arc": ((0.22, 0.03, 0.1), NEAR),
    "move_through": ([NEAR],),
    "move_joints": ({"wrist_roll": 0.1},),
    "pose": ("home",),
    "gripper": ("open",),
    "replay": ("wave.jsonl",),
    "follow": ([NEAR],),
    "follow_arm": (None,),
}


@pytest.fixture(scope="module")
def limp():
    """Return an arm that no test of this module may move or switch on."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine
        assert not any(registers(machine, "torque_enable").values())


def options_type(method):
    """Return the TypedDict of a method's options; None where it has none."""
    for parameter in inspect.signature(getattr(Arm, method), eval_str=True).parameters.values():
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            return get_args(parameter.annotation)[0]
    return None


def test_every_method_with_options_is_tried_here():
    public = [name for name, _ in inspect.getmembers(Arm, inspect.isfunction) if name[0] != "_"]
    assert {name for name in public if options_type(name)} == set(WITH_OPTIONS)


@pytest.mark.parametrize("method", WITH_OPTIONS)
def test_an_unknown_option_is_named_with_all_that_there_are(limp, method):
    known = options_type(method).__annotations__
    with pytest.raises(TypeError, match=rf"Arm\.{method}\(\) got .* 'qqq'\. Options: ") as raised:
        getattr(limp, method)(*WITH_OPTIONS[method], qqq=1)
    assert all(name in str(raised.value) for name in known)
    assert ("wait" in str(raised.value)) == (
        "wait" in inspect.signature(getattr(Arm, method)).parameters
    )


@pytest.mark.parametrize(
    ("method", "slip", "meant"),
    [
        ("move_to", {"sped": "slow"}, "speed"),
        ("move_to", {"waits": False}, "wait"),
        ("move_line", {"orientaton": np.eye(3)}, "orientation"),
        ("move_through", {"blend": 0.01}, "blend_m"),
        ("move_joints", {"on_progres": print}, "on_progress"),
        ("gripper", {"width": 0.03}, "width_m"),
        ("plan_through", {"lines": True}, "line"),
    ],
)
def test_a_slip_of_the_keys_is_told_the_closest_option(limp, method, slip, meant):
    with pytest.raises(TypeError, match=f"Did you mean '{meant}'"):
        getattr(limp, method)(*WITH_OPTIONS[method], **slip)


@pytest.mark.parametrize(
    ("method", "option"),
    [("move_joints", "stance"), ("move_to", "line"), ("plan_to", "on_progress"), ("pose", "force")],
)
def test_the_option_of_another_motion_is_unknown(limp, method, option):
    with pytest.raises(TypeError, match=option):
        getattr(limp, method)(*WITH_OPTIONS[method], **{option: None})


def test_an_unknown_option_of_a_background_motion_is_raised_by_the_call(limp):
    with pytest.raises(TypeError, match="sped"):
        limp.move_to(NEAR, wait=False, sped="slow")


@pytest.mark.parametrize("method", WITH_OPTIONS)
def test_the_help_of_a_method_names_each_option_and_where_it_is_explained(method):
    text, known = " ".join(inspect.getdoc(getattr(Arm, method)).split()), options_type(method)
    if method != "plan_line":  # "options as ``plan_to``"
        assert f"``{known.__name__}``" in text
        listed = text.split("Options: ")[1].split("; see")[0]
        assert all(name in listed for name in known.__annotations__)
    assert hasattr(motion_options, known.__name__)


def test_each_option_is_explained_with_its_default():
    explained = "".join(
        inspect.getdoc(known)
        for known in (
            motion_options.PointOptions,
            motion_options.LineOptions,
            motion_options.ArcOptions,
            motion_options.DrawOptions,
            motion_options.ThroughOptions,
            motion_options.GripperOptions,
        )
    )
    for method in WITH_OPTIONS:
        for option in options_type(method).__annotations__:
            assert f"    {option}: " in explained


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
        assert report.motion_s == pytest.approx(plan.duration_s, abs=0.05)
        assert all(isinstance(progress, MotionProgress) for progress in seen)
        np.testing.assert_allclose(true_tip_m(arm), goal_m, atol=0.003)
        joints = true_joints(arm)
        T_base_tip = arm.chain.forward([joints[name] for name in arm.chain.names])
        pitch_rad = tool_frame(arm.model).pitch_rad(T_base_tip[:3, :3])
        assert pitch_rad == pytest.approx(-0.9, abs=0.03)
    assert seen
