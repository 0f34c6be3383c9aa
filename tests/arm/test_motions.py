"""Motions as values: checked on creation, one form in JSON, planned and executed."""

import contextlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ikservo
from ikservo.apps.grasping.pick_and_place import Pick, Place
from ikservo.apps.teaching.program import Program, ProgramStep, read_program, write_program
from ikservo.apps.teaching.program_run import ProgramRun
from ikservo.apps.teaching.replaying import Replay
from ikservo.arm import ToolOrientation
from ikservo.errors import BadValueError, InputError
from ikservo.ik import Posture
from ikservo.planning.motions import (
    Draw,
    LookAt,
    Lower,
    MotionValue,
    MoveArc,
    MoveGripper,
    MoveJoints,
    MoveLine,
    MovePose,
    MoveThrough,
    MoveTo,
    MoveToRest,
    Wait,
    motion_fields,
    motion_kind,
    motion_names,
    parse_motion,
)
from tests.arm.simulated import context_of, registers, true_joints, true_tip_m

NEAR, FAR = (0.23, 0.02, 0.10), (0.22, -0.04, 0.12)
PLANNED = (
    MoveTo(NEAR, speed="fast", stance=ToolOrientation(pitch_rad=-0.9, roll_rad=0.1)),
    MoveTo(NEAR, stance=ToolOrientation(posture=Posture(np.zeros(5), np.ones(5)))),
    MoveLine(NEAR, tool_speed_m_s=0.05),
    MoveArc((0.22, 0.03, 0.1), NEAR, full_circle=True),
    MoveArc(center_m=NEAR, normal=(1, 0, 0), angle_rad=-1.5, tool_speed_m_s=0.05),
    MoveThrough([NEAR, FAR], blend_m=0.01, line=True),
    MoveThrough([FAR, NEAR]),
    Draw([[NEAR], [FAR, NEAR]], lift_m=0.02),
    MoveJoints({"wrist_roll": 0.1}, speed="slow"),
    MovePose("home"),
    LookAt([1.0, 0.5, 0.3], speed="slow"),
    MoveToRest(),
    Lower(),
)
"""What the simulated arm can do from its pose home: a new kind of motion is tried from here."""

EXAMPLES = (
    *PLANNED,
    MoveLine(np.array(NEAR), tool_speed_m_s=0.05, stance=ToolOrientation(keep=True)),
    MoveLine(NEAR, stance=ToolOrientation(direction=np.array([1.0, 0.0, -1.0]))),
    MoveGripper("close", force=0.2),
    MoveGripper(width_m=0.03),
    Replay("wave.jsonl"),
    Pick(NEAR, size_m=(0.02, 0.03, 0.04), yaw_rad=0.3),
    Place(FAR, speed="slow"),
    Wait(0.5),
)


def test_motion_examples_cover_every_motion_type():
    assert {type(each) for each in EXAMPLES} == {motion_kind(name) for name in motion_names()}


@pytest.mark.parametrize("motion", EXAMPLES, ids=str)
def test_motion_survives_conversion_to_json_and_back(motion):
    text = json.dumps(motion_fields(motion), allow_nan=False)
    read = parse_motion(json.loads(text))
    assert type(read) is type(motion)
    assert motion_fields(read) == motion_fields(motion)


def test_motion_json_omits_default_values():
    assert motion_fields(MoveTo(NEAR)) == {"move_to": {"position_m": list(NEAR)}}


@pytest.mark.parametrize("motion", EXAMPLES, ids=str)
def test_text_of_every_motion_is_shorter_than_80_characters(motion):
    assert 3 < len(str(motion)) < 80


def test_motions_with_equal_fields_are_equal_and_copy_arrays():
    point_m = np.array(NEAR)
    motion = MoveTo(point_m)
    point_m[:] = 0.0
    assert motion == MoveTo(NEAR)
    stances = [ToolOrientation(direction=np.array([0.0, 0.0, -1.0])) for _ in range(2)]
    assert MoveTo(NEAR, stance=stances[0]) == MoveTo(NEAR, stance=stances[1]) != motion
    assert len({motion, MoveTo(NEAR), MoveTo(FAR)}) == 2


def test_array_of_one_number_is_refused_as_list_of_points():
    for kind in (MoveThrough, Draw):
        with pytest.raises(BadValueError, match=r"list of points is array\(0\.5\)"):
            kind(np.array(0.5))


MISTAKES = [
    (MoveTo, {"position_m": [0.1, 0.2]}),
    (MoveTo, {"position_m": None}),
    (MoveTo, {"position_m": "near"}),
    (MoveTo, {"position_m": [0.1, 0.2, 2000.0]}),
    (MoveTo, {"position_m": NEAR, "speed": "warp"}),
    (MoveTo, {"position_m": NEAR, "speed": None}),
    (LookAt, {"point_m": [0.1, 0.2]}),
    (LookAt, {"point_m": NEAR, "speed": "warp"}),
    (MoveLine, {"position_m": NEAR, "tool_speed_m_s": 0.0}),
    (MoveArc, {}),
    (MoveArc, {"via_m": NEAR, "end_m": FAR, "center_m": NEAR}),
    (MoveArc, {"center_m": NEAR, "full_circle": True}),
    (MoveArc, {"via_m": NEAR, "end_m": FAR, "full_circle": "yes"}),
    (MoveThrough, {"points_m": []}),
    (MoveThrough, {"points_m": 0.5}),
    (MoveThrough, {"points_m": [NEAR], "blend_m": 0.0}),
    (MoveThrough, {"points_m": [NEAR], "tool_speed_m_s": 0.1}),
    (Draw, {"strokes_m": [[]]}),
    (Draw, {"strokes_m": [[NEAR]], "lift_m": -0.1}),
    (MoveJoints, {"positions": [1.0]}),
    (MoveJoints, {"positions": {"wrist_roll": True}}),
    (MovePose, {"name": 3}),
    (MoveGripper, {}),
    (MoveGripper, {"to": "ajar"}),
    (MoveGripper, {"to": "open", "width_m": 0.1}),
    (Wait, {"duration_s": 0.0}),
    (Wait, {"duration_s": 1e9}),
]


@pytest.mark.parametrize(("kind", "fields"), MISTAKES)
def test_invalid_motion_raises_same_error_in_python_and_json(kind, fields):
    with pytest.raises(InputError) as made:
        kind(**fields)
    with pytest.raises(InputError) as read:
        parse_motion({kind.kind: json.loads(json.dumps(fields))})
    assert type(read.value) is type(made.value)
    assert read.value.message.replace("[", "(").replace("]", ")") == made.value.message.replace(
        "[", "("
    ).replace("]", ")")


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ([], "The motion"),
        ({}, "The motion"),
        ({"move_to": {"position_m": NEAR}, "wait": {}}, "The motion"),
        ({"hop": {}}, "no motion named 'hop'"),
        ({"move_to": 3}, "move_to"),
        ({"move_to": {}}, "move_to lacks the field position_m"),
        ({"move_line": {"position_m": NEAR, "tool_sped_m_s": 1}}, "no field 'tool_sped_m_s'"),
        ({"move_to": {"position_m": NEAR, "stance": {"pich_rad": 1}}}, "no field 'pich_rad'"),
        ({"move_to": {"position_m": NEAR, "stance": {"keep": "yes"}}}, "keep"),
    ],
)
def test_motion_json_error_names_invalid_key(value, named):
    with pytest.raises(InputError, match=named):
        parse_motion(value)


def test_motion_json_error_suggests_closest_key():
    with pytest.raises(InputError) as raised:
        parse_motion({"move_line": {"position_m": NEAR, "tool_sped_m_s": 1}})
    assert "Did you mean tool_speed_m_s?" in raised.value.hint


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=8,
)


@given(data=st.data(), motion=st.sampled_from(EXAMPLES))
def test_motion_json_with_random_value_is_read_or_refused(data, motion):
    ((kind, fields),) = motion_fields(motion).items()
    name = data.draw(st.sampled_from([*motion_kind(kind).__dataclass_fields__, "other"]))
    with contextlib.suppress(InputError):
        parse_motion({kind: {**fields, name: data.draw(ANYTHING)}})


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        yield machine


@pytest.mark.parametrize("motion", PLANNED, ids=str)
def test_planning_a_motion_does_not_move_arm(arm, motion):
    arm.enable()
    before = registers(arm, "goal_position")
    plan = arm.plan(motion)
    assert plan.motion is motion
    assert arm.plan(plan.motion).duration_s == plan.duration_s
    assert registers(arm, "goal_position") == before


@pytest.mark.sample(5)
@pytest.mark.full
@pytest.mark.parametrize("motion", PLANNED, ids=str)
def test_each_motion_runs_as_a_program_step(arm, tmp_path, motion):
    arm.pose("home")
    step = ProgramStep(motion=motion_fields(motion.with_speed("normal")), speed="fast")
    write_program(tmp_path / "one.toml", Program(format=1, arm="so101", steps=(step,)))
    run = ProgramRun(arm, read_program(tmp_path / "one.toml"), tmp_path, arm.poses)
    assert [each.error for each in run.check()] == [None]
    plan = arm.plan(motion)
    (step,) = run.steps()
    report = run.run_step(step)
    assert report.reached
    np.testing.assert_allclose(true_tip_m(arm), plan.tip_m, atol=4e-3)
    if plan.is_cartesian:
        assert 0.0 < report.path_error_rms_m <= report.path_error_max_m < 5e-3


PATHS = [each for each in PLANNED if hasattr(each, "path_from")]


@pytest.mark.parametrize("motion", PATHS, ids=str)
def test_cartesian_path_starts_at_tip_with_right_derivatives(motion):
    tip_m = np.array([0.21, 0.0, 0.08])
    path = motion.path_from(tip_m)
    along = np.linspace(0.0, path.length, 4001)
    points, slopes, bends = (np.array(each) for each in zip(*map(path.at, along), strict=True))
    np.testing.assert_allclose(points[0], tip_m, atol=1e-9)
    np.testing.assert_allclose(np.diff(points, axis=0) / along[1], _middles(slopes), atol=1e-3)
    np.testing.assert_allclose(np.diff(slopes, axis=0) / along[1], _middles(bends), atol=1.0)
    assert path.breakpoints[0] == 0.0
    assert path.breakpoints[-1] == pytest.approx(path.length)
    lengths_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert path.path_length() == pytest.approx(lengths_m.sum(), rel=1e-4)


def _middles(values):
    return (values[1:] + values[:-1]) / 2


def test_execute_waits_for_motion_end_and_start_returns_at_once(arm):
    assert arm.execute(MoveTo(NEAR)).reached
    np.testing.assert_allclose(true_tip_m(arm), NEAR, atol=2e-3)
    running = arm.start(MoveJoints({"wrist_roll": 0.4}))
    queued = arm.start(MoveGripper("open"))
    assert running.wait().reached
    assert queued.wait().reached
    assert true_joints(arm)["wrist_roll"] == pytest.approx(0.4, abs=0.01)
    assert arm.execute(Wait(0.1)) is None


@pytest.mark.parametrize("motion", [MoveGripper("open"), Replay("wave.jsonl"), Wait(1.0)], ids=str)
def test_plan_refuses_motions_without_a_plan(arm, motion):
    with pytest.raises(BadValueError, match="to plan"):
        arm.plan(motion)


@pytest.mark.parametrize("what", [None, NEAR, {"move_to": {"position_m": NEAR}}, MoveTo])
def test_plan_execute_and_start_refuse_arguments_of_wrong_type(arm, what):
    for method in (arm.plan, arm.execute, arm.start):
        with pytest.raises(BadValueError):
            method(what)
    assert not any(registers(arm, "torque_enable").values())


@pytest.mark.full
def test_plan_of_limp_arm_is_recomputed_from_its_motion():
    with ikservo.open_arm("so101", port="sim") as limp:
        plan = limp.plan(MovePose("home"))
        assert plan.limp_arm is not None
        assert limp.execute(plan).reached
        assert limp.plan(MoveTo(NEAR)).limp_arm is None


def test_motion_is_immutable_and_replace_returns_changed_copy():
    motion = MoveTo(NEAR)
    assert replace(motion, speed="slow") == MoveTo(NEAR, speed="slow") == motion.with_speed("slow")
    assert Wait(1.0).with_speed("slow") == Wait(1.0)
    with pytest.raises(AttributeError):
        motion.speed = "fast"
    assert isinstance(motion, MotionValue)


@pytest.mark.parametrize(
    ("move", "planned_by"),
    [
        (lambda arm: arm.move_to(NEAR), "plan_to_point"),
        (lambda arm: arm.move_line(NEAR), "plan_path"),
        (lambda arm: arm.move_arc((0.22, 0.03, 0.1), NEAR), "plan_path"),
        (lambda arm: arm.move_through([FAR, NEAR]), "plan_waypoints"),
        (lambda arm: arm.draw([[NEAR]]), "plan_to_point"),
        (lambda arm: arm.pose("zero"), "plan_to_joints"),
    ],
)
def test_planner_is_called_without_closures(arm, monkeypatch, move, planned_by):
    names = []

    def note(*_args, **_options):
        frame = sys._getframe(1)
        while frame.f_code.co_filename != __file__:
            names.append(frame.f_code.co_qualname)
            frame = frame.f_back
        raise InterruptedError

    monkeypatch.setattr(context_of(arm).planner, planned_by, note)
    with pytest.raises(InterruptedError):
        move(arm)
    names = [name for name in names if not name.startswith("with_options.")]  # parses options only
    assert names[-1].startswith("MotionMethods.")
    assert [name for name in names if "<" in name] == []
