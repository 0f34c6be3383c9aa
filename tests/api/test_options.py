"""An unknown option of a motion raises a TypeError that names it, and nothing moves."""

import dataclasses
import inspect

import numpy as np
import pytest

import ikservo
from ikservo.apps.remote.remote_arm import RemoteArm
from ikservo.arm import Arm, MotionProgress, ToolOrientation
from ikservo.arm.motion_methods import MotionMethods
from ikservo.model.tool import tool_frame
from ikservo.planning import motions
from tests.arm.simulated import registers, true_joints, true_tip_m
from tests.journeys.method_arguments import arguments, methods

NEAR = (0.23, 0.02, 0.10)


@pytest.fixture(scope="module")
def limp():
    """Return an arm that no test of this module may move or switch on."""
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine
        assert not any(registers(machine, "torque_enable").values())


def listed_options(method):
    """Return the options that ``help`` lists for a method that makes a motion; None for others."""
    function = getattr(Arm, method)
    taken = inspect.signature(getattr(function, "__wrapped__", function)).parameters.values()
    if all(each.kind is not inspect.Parameter.VAR_KEYWORD for each in taken):
        return None
    listed = inspect.signature(function).parameters.values()
    return {each.name for each in listed if each.kind is inspect.Parameter.KEYWORD_ONLY} - {"wait"}


OF_MOTION = [name for name in methods() if listed_options(name)]
"""The methods that make a motion of their arguments."""


def test_list_of_motion_methods_contains_known_methods():
    assert {"move_to", "draw", "gripper", "plan_arc"} <= set(OF_MOTION)


@pytest.mark.parametrize("method", OF_MOTION)
def test_method_options_are_fields_of_their_motion_class(limp, monkeypatch, tmp_path, method):
    made = []
    for name in ("plan", "execute"):
        monkeypatch.setattr(Arm, name, lambda _, motion, *_more: made.append(motion))
    getattr(limp, method)(**arguments(method, limp, tmp_path))
    names = {each.name for each in dataclasses.fields(made[0])}
    assert listed_options(method) - {"on_progress", "orientation"} <= names


@pytest.mark.parametrize("kind", motions.KINDS.values(), ids=motions.KINDS)
def test_motion_docstring_describes_every_field(kind):
    explained = inspect.getdoc(kind)
    for each in dataclasses.fields(kind):
        assert f"    {each.name}: " in explained


BLOCKING = [*OF_MOTION, "follow", "follow_arm", "plan_joints"]
WAITING = [name for name in OF_MOTION if "wait" in inspect.signature(getattr(Arm, name)).parameters]


@pytest.mark.parametrize(
    ("method", "wait"),
    [*((name, {}) for name in BLOCKING), *((name, {"wait": False}) for name in WAITING)],
)
def test_unknown_option_raises_type_error_with_its_name(limp, tmp_path, method, wait):
    given = arguments(method, limp, tmp_path) if method in OF_MOTION else {}
    with pytest.raises(TypeError, match="unexpected keyword argument 'qqq'"):
        getattr(limp, method)(**given, **wait, qqq=1)


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
def test_mistyped_option_error_suggests_closest_name(limp, tmp_path, method, slip, meant):
    with pytest.raises(TypeError, match=f"Did you mean '{meant}'"):
        getattr(limp, method)(**arguments(method, limp, tmp_path), **slip)


@pytest.mark.parametrize(
    ("method", "option"),
    [("move_joints", "stance"), ("move_to", "line"), ("plan_to", "on_progress"), ("pose", "force")],
)
def test_option_of_another_motion_is_refused(limp, tmp_path, method, option):
    with pytest.raises(TypeError, match=option):
        getattr(limp, method)(**arguments(method, limp, tmp_path), **{option: None})


def test_remote_arm_methods_have_same_signatures():
    for name, method in inspect.getmembers(MotionMethods, inspect.isfunction):
        for arm in (Arm, RemoteArm) if name[0] != "_" else ():
            assert inspect.signature(getattr(arm, name)) == inspect.signature(method)


@pytest.mark.full
def test_plan_and_move_to_apply_motion_options():
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
