"""A user's first guesses in Python work, or the error names the right form."""

import inspect
import traceback

import numpy as np
import pytest

import ikservo
from ikservo.errors import FileFormatError
from ikservo.model.scene_file import make_shape, read_scene, scene_text
from ikservo.remedies import in_python


@pytest.fixture(scope="module")
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as opened:
        yield opened


@pytest.mark.parametrize("method", ["plan_to", "plan_line"])
def test_target_point_may_be_given_as_three_numbers(arm, method):
    plan = getattr(arm, method)
    apart = plan(0.25, np.float32(0), 0.1)
    assert np.allclose(apart.tip_m, plan((0.25, 0.0, 0.1)).tip_m)


@pytest.mark.parametrize("given", [(0.25, 0.0), (0.25, 0.0, 0.1, "slow"), ((0.25, 0, 0.1), 3, 4)])
def test_malformed_point_error_shows_expected_form(arm, given):
    for method in (arm.move_to, arm.move_line, arm.look_at, arm.plan_to, arm.plan_line):
        with pytest.raises(ikservo.IkservoError, match=r"\(x, y, z\) in metres"):
            method(*given)


def test_motion_signatures_show_options_and_defaults(arm):
    signature = inspect.signature(arm.move_to)
    assert signature.parameters["speed"].default == "normal"
    assert {"stance", "straight", "within", "wait", "on_progress"} <= set(signature.parameters)
    assert not any(
        parameter.kind is inspect.Parameter.VAR_KEYWORD
        for name in dir(arm)
        if name.startswith(("move", "plan", "draw", "pose", "look", "gripper", "replay"))
        and callable(getattr(arm, name))
        for parameter in inspect.signature(getattr(arm, name)).parameters.values()
    )


def test_dir_of_arm_lists_public_names_only(arm):
    names = {name for name in dir(arm) if not name.startswith("_")}
    assert not names & {"context", "runner", "preflight", "background", "request_stop"}
    assert {"move_to", "where", "scene", "stop", "relax", "poses", "limits", "camera"} <= names


@pytest.mark.parametrize("text", ["250mm -50mm 150mm", "0.25 -0.05 0.15", "25cm -5cm 0.15m"])
def test_move_command_hint_is_translated_to_python_method(text):
    hint = f"Try: ikservo move {text}."
    assert in_python(hint) == "Try: arm.move_to((0.25, -0.05, 0.15))."


def test_hint_for_point_in_millimetres_shows_call_in_metres(arm):
    with pytest.raises(ikservo.UnreachableError, match=r"arm.move_to\(\(0.25, 0, 0.1\)\)"):
        arm.plan_to((250, 0, 100))


@pytest.mark.parametrize("spelling", ["center_m", "centre_m"])
def test_center_and_centre_are_both_accepted_as_argument(arm, tmp_path, spelling):
    sphere = make_shape("sphere", "ball", {spelling: (0.3, 0.0, 0.1), "radius_m": 0.05})
    text = scene_text([sphere])
    assert "center_m = [0.3, 0.0, 0.1]" in text
    (tmp_path / "scene.toml").write_text(text.replace("center_m", spelling))
    assert [each.name for each in read_scene(tmp_path / "scene.toml")] == ["ball"]
    tip = arm.where().tip_m
    arc = arm.plan_arc(**{spelling: tip - (0.02, 0.0, 0.0)}, angle_rad=0.3)
    assert arc.duration_s > 0


def test_input_error_has_no_pydantic_traceback(arm):
    with pytest.raises(FileFormatError) as caught:
        arm.scene.add("box", "shelf", center_m=(0.3, 0.2, 0.1))
    assert "pydantic_core" not in "".join(traceback.format_exception(caught.value))


def test_str_of_result_is_one_line_and_repr_is_complete(arm):
    values = [
        arm.where(),
        arm.move_to((0.22, 0.02, 0.12)),
        arm.move_joints({"wrist_roll": 0.2}),
        arm.gripper("close"),
        ikservo.solve(arm.model.chain, (0.25, 0.0, 0.1)),
    ]
    for value in values:
        assert "\n" not in str(value)
        assert len(str(value)) <= 200, str(value)
        assert "array(" not in str(value)
    assert "motion_s" in repr(values[1])
    assert "limp" not in str(arm.where())
    assert str(values[1]).startswith("reached: ")
    assert str(values[3]).startswith("nothing grasped")


def test_unknown_scene_method_error_suggests_add(arm):
    with pytest.raises(AttributeError, match=r'arm.scene.add\("sphere", '):
        arm.scene.add_sphere  # noqa: B018
    assert not hasattr(arm.scene, "remove_box")
