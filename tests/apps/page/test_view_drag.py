"""Pointer, wheel and keys become drag commands, and their goals never leave the limits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

from ikservo.apps.page.dragging.drag import Drag
from ikservo.apps.page.dragging.drag_commands import DragTarget, HoldCommand, JointTarget
from ikservo.apps.page.dragging.drag_solver import MAX_STEP_RAD, DragSolver
from ikservo.apps.page.picking.picking import Picker, PointerContext
from ikservo.apps.page.picking.raycast import thing_shapes
from ikservo.errors import InputError, UnknownNameError
from ikservo.ik import METHODS, Posture, Target
from ikservo.kinematics import distance_to_limits
from ikservo.model.arm_model import KeepOutBox
from tests.apps.page.view_fixtures import (
    drag_of,
    looked_at,
    model_of,
    picker,
    pixel_of,
    pixel_on,
    sight,
    stage,
)
from tests.kinematics.chains import crane

EMPTY_PX = np.array([60.0, 60.0])
pixels = st.tuples(st.floats(0, 800), st.floats(0, 600)).map(np.array)


def play(name, drag, view_state, moves, q):
    """Move a pressed pointer; return the goals, one per frame."""
    solver, goals = DragSolver(model_of(name).chain), [q]
    for px in moves:
        goals.append(solver.solve_command(drag.move(px), goals[-1]).q)
    return np.array(goals)


# --- grabbing ---


@pytest.mark.parametrize("view", ["side", "top", "orbit"])
@pytest.mark.parametrize("link", ["forearm", "gripper"])
def test_press_grabs_link_under_pointer(link, view):
    home, view_state = stage("so101").home, sight("so101", view)
    px = pixel_on("so101", view_state, link)
    target = drag_of("so101").press(px, view_state).target
    assert target.frame == link
    there = model_of("so101").chain.forward(home, target.frame, target.offset_m)[:3, 3]
    np.testing.assert_allclose(there, target.position, atol=1e-9)
    np.testing.assert_allclose(view_state.camera.project(there)[0], px, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.floats(-60, 60), st.floats(-60, 60))
def test_grabbed_point_follows_pointer_parallel_to_screen(dx, dy):
    view_state, drag = sight("so101", "orbit"), drag_of("so101")
    px = pixel_of("so101", "orbit", view_state.arms[0], "forearm", (-0.05, 0.0, 0.0))
    start = drag.press(px, view_state).target.position
    target = drag.move(px + np.array([dx, dy])).target
    seen, depth_m = view_state.camera.project(np.array([start, target.position]))
    np.testing.assert_allclose(seen[1] - seen[0], (dx, dy), atol=1e-6)
    assert depth_m[1] == pytest.approx(depth_m[0])


def test_dragged_link_moves_only_joints_up_to_it():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.03, 0.0, 0.0))
    assert drag.press(px, view_state).target.frame == "forearm"
    goals = play(
        "so101",
        drag,
        view_state,
        [px + np.array([0, 3.0 * k]) for k in range(12)],
        view_state.arms[0],
    )
    moved = np.abs(goals[-1] - goals[0])
    assert moved[:3].max() > 0.02
    np.testing.assert_array_equal(moved[3:], 0.0)


def test_dragged_link_follows_pointer():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.03, 0.0, 0.0))
    start = drag.press(px, view_state).target
    goals = play(
        "so101", drag, view_state, [px - (0, 1.5 * k) for k in range(20)], view_state.arms[0]
    )
    chain = model_of("so101").chain
    at = chain.forward(goals[-1], start.frame, start.offset_m)[:3, 3]
    held_px = view_state.camera.project(start.position)[0] - (0.0, 28.5)
    np.testing.assert_allclose(view_state.camera.project(at)[0], held_px, atol=0.1)


def test_dragged_jaw_moves_the_hand_that_carries_it():
    view_state = sight("so101", "side")
    view_state = PointerContext(view_state.camera, view_state.arms, other_joints={"gripper": 1.0})
    drag = drag_of("so101")
    target = drag.press(pixel_on("so101", view_state, "jaw"), view_state).target
    assert target.frame == "gripper"
    assert drag.grabbed_link == "jaw"


def test_preview_is_grabbed_before_measured_arm_behind_it():
    home = stage("so101").home
    goal = model_of("so101").chain.clip(home + np.array([0, 0.4, 0.3, 0, 0]))
    camera, drag = looked_at("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", goal, "forearm", (-0.05, 0.0, 0.0))
    command = drag.press(px, PointerContext(camera, (goal, home)))
    chain = model_of("so101").chain
    at = chain.forward(goal, command.target.frame, command.target.offset_m)[:3, 3]
    np.testing.assert_allclose(at, command.target.position, atol=1e-9)


def test_measured_arm_beside_preview_can_be_grabbed():
    home = stage("so101").home
    goal = model_of("so101").chain.clip(home + np.array([0, 0.9, 0.3, 0, 0]))
    px = pixel_of("so101", "side", home, "forearm", (-0.05, 0.0, 0.0))
    view_state = PointerContext(looked_at("so101", "side"), (goal, home))
    assert drag_of("so101").press(px, view_state).target.frame == "forearm"


def test_release_ends_the_drag():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.05, 0, 0)), view_state)
    drag.release()
    assert not drag.is_busy
    assert drag.move((400.0, 300.0)) is None


def test_second_finger_does_not_disturb_drag():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(EMPTY_PX, view_state, pointer=7)
    assert drag.press((400.0, 300.0), view_state, pointer=8) is None
    assert drag.move((400.0, 300.0), pointer=8) is None
    drag.release(pointer=8)
    assert drag.move((100.0, 100.0), pointer=7) is not None


def test_cancelled_drag_ends_and_arm_holds():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(EMPTY_PX, view_state)
    assert drag.cancel() == HoldCommand()
    assert not drag.is_busy


def test_camera_is_fixed_during_drag():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(EMPTY_PX, view_state)
    assert drag.camera is view_state.camera


# --- clicks on nothing ---


@pytest.mark.parametrize("view", ["side", "top", "front", "orbit"])
def test_click_on_empty_space_moves_tip_there_at_its_depth(view):
    view_state = sight("so101", view)
    command = drag_of("so101").press(EMPTY_PX, view_state)
    px, depth_m = view_state.camera.project(command.target.position)
    tip = model_of("so101").chain.forward(view_state.arms[0])[:3, 3]
    np.testing.assert_allclose(px, EMPTY_PX, atol=1e-6)
    assert command.target.frame is None
    assert depth_m == pytest.approx(view_state.camera.depth_of(tip))


def test_press_on_base_link_counts_as_empty_space():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "base", (0.0, 0.0, 0.01))
    assert drag.press(px, view_state).target.frame is None
    assert drag_of("so101").hover(px, view_state) is None


def test_press_counts_as_click_until_pointer_moves():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    assert drag.press(EMPTY_PX, view_state).is_click
    assert not drag.move(EMPTY_PX + 5.0).is_click


@pytest.mark.parametrize("name", ["so101", "wx250s", "planar3"])
def test_click_on_reachable_point_is_reached_at_once(name):
    chain, random = model_of(name).chain, np.random.default_rng(5)
    solver, q = DragSolver(chain), stage(name).home
    drag = Drag(chain, Picker({}))
    view = "plane" if name == "planar3" else "top"
    for _ in range(20):
        there = chain.forward(random.uniform(chain.lower_rad, chain.upper_rad))[:3, 3]
        camera = looked_at(name, view)
        command = drag.press(camera.project(there)[0], PointerContext(camera, (q,), plane_m=there))
        drag.release()
        answer = solver.solve_command(command, q)
        assert answer.marker.reached
        assert answer.settled
        np.testing.assert_allclose(chain.forward(answer.q)[:3, 3], there, atol=1e-4)


# --- limits ---


@settings(max_examples=25, deadline=None)
@given(st.lists(pixels, min_size=1, max_size=12), st.sampled_from(["side", "top", "orbit"]))
@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_drag_never_exceeds_joint_limits(name, path, view):
    chain, view_state, drag = model_of(name).chain, sight(name, view), drag_of(name)
    drag.press(pixel_of(name, view, view_state.arms[0], "forearm", (-0.05, 0, 0)), view_state)
    goals = play(name, drag, view_state, path, view_state.arms[0])
    assert distance_to_limits(chain, goals).min() >= 0.0


@settings(max_examples=25, deadline=None)
@given(st.lists(pixels, min_size=2, max_size=12), st.sampled_from(["side", "top", "orbit"]))
def test_single_joint_drag_never_exceeds_its_limits(path, view):
    chain, view_state, drag = model_of("so101").chain, sight("so101", view), drag_of("so101")
    q = view_state.arms[0]
    drag.press(pixel_of("so101", view, q, "forearm", (-0.05, 0, 0)), view_state, shift=True)
    goals = play("so101", drag, view_state, path, q)
    assert distance_to_limits(chain, goals).min() >= 0.0


def test_drag_started_outside_limits_moves_to_limits():
    chain = model_of("so101").chain
    outside = chain.upper_rad + 0.05
    np.testing.assert_array_equal(
        DragSolver(chain).solve_command(HoldCommand(), outside).q, chain.upper_rad
    )


def test_drag_target_of_unknown_joint_is_refused():
    with pytest.raises(UnknownNameError):
        DragSolver(model_of("so101").chain).solve_command(
            JointTarget("knee", 0.0), stage("so101").home
        )


# --- past the reach ---

ARMS = ["so101", "koch", "open_manipulator_x", "px100", "wx250s", "planar2", "planar3"]


def path_outside(name, turns=1.0, frames=400):
    """Return the drag, and pixels of a path that leaves the reach and returns."""
    view = "plane" if name.startswith("planar") else "side"
    view_state, drag = sight(name, view), drag_of(name)
    tip_px = view_state.camera.project(model_of(name).chain.forward(view_state.arms[0])[:3, 3])[0]
    drag.press(EMPTY_PX, view_state)
    centre = pixel_of(name, view, view_state.arms[0], "upper_arm")
    way = tip_px - centre
    angles = turns * np.linspace(0.0, 1.2, frames)
    stretch = 1.0 + 2.5 * np.sin(np.linspace(0.0, math.pi, frames)) ** 2
    c, s = np.cos(angles) * stretch, np.sin(angles) * stretch
    path = centre + np.stack([c * way[0] + s * way[1], c * way[1] - s * way[0]], axis=1)
    return view_state, drag, path


@pytest.mark.parametrize("name", ARMS)
def test_drag_follows_pointer_out_of_reach_without_jump(name):
    view_state, drag, path = path_outside(name)
    goals = play(name, drag, view_state, path, view_state.arms[0])
    assert np.abs(np.diff(goals, axis=0)).max() <= MAX_STEP_RAD + 1e-12


@pytest.mark.parametrize("name", ARMS)
def test_drag_follows_pointer_out_of_reach_without_chatter(name):
    """A joint reverses where it meets a limit, and not repeatedly."""
    view_state, drag, path = path_outside(name)
    goals = play(name, drag, view_state, path, view_state.arms[0])
    steps = np.diff(goals[20:], axis=0)
    to_and_fro = np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) * (steps[1:] * steps[:-1] < 0)
    assert (to_and_fro > math.radians(0.5)).sum() <= 3


@pytest.mark.parametrize("name", ARMS)
def test_arm_rests_while_pointer_rests_out_of_reach(name):
    view_state, drag, path = path_outside(name)
    goals = play(name, drag, view_state, [*path[:200], *([path[200]] * 60)], view_state.arms[0])
    assert np.abs(np.diff(goals[-20:], axis=0)).max() < 1e-9


@pytest.mark.parametrize("name", ARMS)
def test_pointer_out_of_reach_moves_tip_to_nearest_point(name):
    chain, random = model_of(name).chain, np.random.default_rng(11)
    view_state, drag, path = path_outside(name)
    goals = play(name, drag, view_state, [*path[:200], *([path[200]] * 60)], view_state.arms[0])
    target = drag.move(path[200]).target.position
    here = math.dist(chain.forward(goals[-1])[:3, 3], target)
    around = chain.clip(goals[-1] + random.normal(scale=0.05, size=(400, chain.dof)))
    others = np.linalg.norm(chain.forward(around)[:, :3, 3] - target, axis=1)
    assert others.min() >= here - 1e-6


def test_unreachable_target_reports_gap_to_nearest_point():
    chain, q = model_of("planar2").chain, stage("planar2").home
    view_state = sight("planar2", "plane")
    command = drag_of("planar2").press((5.0, 300.0), view_state)
    aim = DragSolver(chain).solve_command(command, q).marker
    assert not aim.reached
    assert aim.gap_m == pytest.approx(math.dist(aim.nearest_m, command.target.position))


def test_drag_follows_pointer_jump_in_bounded_steps():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(pixel_of("so101", "side", view_state.arms[0], "gripper", (0, 0, -0.02)), view_state)
    command, solver, q, answers = (
        drag.move((200.0, 150.0)),
        DragSolver(model_of("so101").chain),
        None,
        [],
    )
    q = view_state.arms[0]
    for _ in range(60):
        answers.append(solver.solve_command(command, q))
        assert np.abs(answers[-1].q - q).max() <= MAX_STEP_RAD + 1e-12
        q = answers[-1].q
    assert not answers[0].settled
    assert answers[-1].settled


# --- one joint ---


@pytest.mark.parametrize("view", ["side", "orbit"])
def test_shift_drag_turns_only_joint_of_link(view):
    view_state, drag = sight("so101", view), drag_of("so101")
    q = view_state.arms[0]
    px = pixel_of("so101", view, q, "forearm", (-0.05, 0.0, 0.0))
    drag.press(px, view_state, shift=True)
    command = drag.move(px + np.array([0.0, 20.0]))
    assert command.joint == "elbow_flex"
    goal = DragSolver(model_of("so101").chain).solve_command(command, q).q
    assert np.flatnonzero(goal != q).tolist() == [2]


@pytest.mark.parametrize("view", ["side", "orbit"])
@pytest.mark.parametrize("link", ["upper_arm", "forearm"])
@pytest.mark.parametrize("angle_rad", [-0.3, 0.2])
def test_a_shift_drag_turns_the_link_to_the_pointer(view, link, angle_rad):
    """The grabbed point follows the pointer as far as its circle allows."""
    chain, view_state, drag = model_of("so101").chain, sight("so101", view), drag_of("so101")
    q = view_state.arms[0]
    offset = {"upper_arm": (-0.08, 0.0, 0.0), "forearm": (-0.08, 0.0, 0.0)}[link]
    column = {"upper_arm": 1, "forearm": 2}[link]
    target = q + angle_rad * np.eye(chain.dof)[column]
    drag.press(pixel_of("so101", view, q, link, offset), view_state, shift=True)
    path = [
        view_state.camera.project(chain.forward(q + s * (target - q), link, offset)[:3, 3])[0]
        for s in np.linspace(0, 1, 15)
    ]
    goals = play("so101", drag, view_state, path, q)
    assert goals[-1][column] == pytest.approx(target[column], abs=0.04)


def test_joint_dragged_past_limit_returns_with_pointer():
    chain, view_state, drag = (
        model_of("planar2").chain,
        sight("planar2", "plane"),
        drag_of("planar2"),
    )
    q = view_state.arms[0]
    hub, px = (pixel_of("planar2", "plane", q, "upper_arm", (x, 0, 0)) for x in (0.0, 0.09))
    drag.press(px, view_state, shift=True)
    angles = np.concatenate([np.linspace(0, -3.0, 60), np.linspace(-3.0, 0, 60)])
    arm = px - hub
    path = [hub + np.array([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]])
            for c, s in zip(np.cos(angles), np.sin(angles), strict=True)]  # fmt: skip
    goals = play("planar2", drag, view_state, path, q)
    assert distance_to_limits(chain, goals)[:, 0].min() == 0.0
    np.testing.assert_allclose(goals[-1], q, atol=1e-9)


def test_shift_press_on_empty_space_does_nothing():
    assert drag_of("so101").press(EMPTY_PX, sight("so101", "side"), shift=True) is None


@pytest.mark.parametrize("notches", [1.0, -3.0])
def test_mouse_wheel_notch_turns_joint_under_pointer_by_1_deg(notches):
    view_state = sight("so101", "side")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.06, 0.0, 0.0))
    command = drag_of("so101").wheel(px, notches, view_state)
    assert command.joint == "elbow_flex"
    assert command.position == pytest.approx(view_state.arms[0][2] + notches * math.radians(1.0))


def test_mouse_wheel_with_alt_key_turns_joint_by_0_1_degree():
    view_state = sight("so101", "side")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.06, 0.0, 0.0))
    command = drag_of("so101").wheel(px, 1.0, view_state, fine=True)
    assert command.position == pytest.approx(view_state.arms[0][2] + math.radians(0.1))


def test_mouse_wheel_over_empty_space_does_nothing():
    assert drag_of("so101").wheel(EMPTY_PX, 1.0, sight("so101", "side")) is None


def test_mouse_wheel_over_joint_hub_turns_that_joint():
    view_state = sight("so101", "side")
    wrist = pixel_of("so101", "side", view_state.arms[0], "wrist")
    assert drag_of("so101").wheel(wrist, 1.0, view_state).joint == "wrist_flex"


def test_mouse_wheel_moves_sliding_joint_by_1_mm():
    chain, q = crane(), np.array([0.3, 0.2])
    view_state = PointerContext(looked_at("so101", "orbit"), (q,))
    px = view_state.camera.project(chain.forward(q, "cart")[:3, 3])[0]
    assert Drag(chain, Picker({})).wheel(px, 1.0, view_state) == JointTarget(
        "slide", pytest.approx(0.201)
    )


# --- keys ---


@pytest.mark.parametrize(
    ("key", "way"),
    [("ArrowLeft", (-1, 0)), ("ArrowRight", (1, 0)), ("ArrowUp", (0, -1)), ("ArrowDown", (0, 1))],
)
@pytest.mark.parametrize(("fine", "step_m"), [(False, 0.005), (True, 0.001)])
def test_arrow_key_moves_target_on_screen(key, way, fine, step_m):
    view_state = sight("so101", "side")
    tip = model_of("so101").chain.forward(view_state.arms[0])[:3, 3]
    command = drag_of("so101").on_key(key, view_state, fine=fine)
    before, after = view_state.camera.project(np.array([tip, command.target.position]))[0]
    np.testing.assert_allclose(after - before, step_m * view_state.camera.scale_px * np.array(way),
                               atol=1e-6)  # fmt: skip


def test_arrow_keys_add_up_from_last_target():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    first = drag.on_key("ArrowUp", view_state).target.position
    second = drag.on_key("ArrowUp", view_state).target.position
    assert math.dist(first, second) == pytest.approx(0.005)


def test_arrow_key_continues_from_clicked_target():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    clicked = drag.press(EMPTY_PX, view_state).target.position
    drag.release()
    assert math.dist(drag.on_key("ArrowUp", view_state).target.position, clicked) == pytest.approx(
        0.005
    )


def test_arrow_key_after_mouse_wheel_starts_at_tip():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(EMPTY_PX, view_state)
    drag.release()
    drag.wheel(
        pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.06, 0, 0)), 1.0, view_state
    )
    tip = model_of("so101").chain.forward(view_state.arms[0])[:3, 3]
    assert math.dist(drag.on_key("ArrowUp", view_state).target.position, tip) == pytest.approx(
        0.005
    )


@pytest.mark.parametrize("key", ["Escape", " "])
def test_escape_or_space_ends_a_drag_and_holds_the_arm(key):
    view_state, drag = sight("so101", "side"), drag_of("so101")
    drag.press(EMPTY_PX, view_state)
    assert drag.on_key(key, view_state) == HoldCommand()
    assert not drag.is_busy


def test_drag_ignores_keys_without_assigned_function():
    assert drag_of("so101").on_key("a", sight("so101", "side")) is None


def test_hovering_shows_link_that_a_press_would_grab():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.06, 0.0, 0.0))
    assert drag.hover(px, view_state) == "forearm"
    assert drag.hover(EMPTY_PX, view_state) is None


# --- a chosen method, and a preferred posture ---


def answers_of(solver, command, q, count=400):
    """Answer one drag command until it settles, one answer per frame."""
    answers = []
    while len(answers) < count and not (answers and answers[-1].settled):
        answers.append(solver.solve_command(command, q))
        q = answers[-1].q
    return answers


@pytest.mark.parametrize("method", METHODS)
def test_drag_uses_chosen_solver_method(method):
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_on("so101", view_state, "gripper")
    drag.press(px, view_state)
    solver, command = DragSolver(model_of("so101").chain), drag.move(px + np.array([20.0, 15.0]))
    solver.method = method
    answers = answers_of(solver, command, view_state.arms[0])
    steps = np.diff([view_state.arms[0], *(answer.q for answer in answers)], axis=0)
    assert answers[-1].marker.gap_m < 1e-3
    assert answers[0].text.startswith((method, "bounded"))
    assert np.abs(steps).max() <= MAX_STEP_RAD + 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_every_solver_keeps_joints_beyond_grabbed_link(method):
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.03, 0.0, 0.0))
    drag.press(px, view_state)
    solver, command = DragSolver(model_of("so101").chain), drag.move(px + np.array([6.0, 9.0]))
    solver.method = method
    last = answers_of(solver, command, view_state.arms[0])[-1]
    np.testing.assert_array_equal(last.q[3:], view_state.arms[0][3:])
    assert last.marker.gap_m < 2e-3


def leaning(name, method="auto", weights=None):
    """Return a drag solver with a preferred posture, and that posture."""
    chain = model_of(name).chain
    solver, wanted = DragSolver(chain), chain.clip(stage(name).home + 0.3)
    solver.method = method
    solver.posture = Posture(wanted, np.ones(chain.dof) if weights is None else weights)
    return solver, wanted


@pytest.mark.parametrize("method", ["auto", "pseudo_inverse"])
def test_drag_approaches_preferred_posture_and_keeps_tip(method):
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "gripper", (-0.009, -0.023, -0.006))
    drag.press(px, view_state)
    command, (solver, wanted) = drag.move(px + np.array([10.0, 5.0])), leaning("so101", method)
    plain = answers_of(DragSolver(model_of("so101").chain), command, view_state.arms[0])[-1]
    answers = answers_of(solver, command, view_state.arms[0])
    last = answers[-1]
    assert last.settled
    assert last.marker.gap_m < 1e-4
    assert np.linalg.norm(last.q - wanted) < 0.8 * np.linalg.norm(plain.q - wanted)
    assert np.abs(np.diff([view_state.arms[0], *(a.q for a in answers)], axis=0)).max() <= 0.14


def clicked(solver, q):
    """Return the answer to a click 5 cm beside the tip of an SO-101 at joints q."""
    tip_m = model_of("so101").chain.forward(q)[:3, 3]
    return solver.solve_command(
        DragTarget(Target(tip_m + np.array([0.0, 0.03, 0.04])), is_click=True), q
    )


def test_click_reaches_nearest_posture_to_preferred_one():
    """No posture near it with the same tip is closer to the preferred one in weighted distance."""
    weights, chain = np.array([1.0, 1.0, 0.5, 1.0, 1.0]), model_of("so101").chain
    solver, wanted = leaning("so101", weights=weights)
    answer = clicked(solver, stage("so101").home)
    assert answer.marker.reached
    assert distance_to_limits(chain, answer.q).min() > 0.01
    free = null_space(chain.jacobian(answer.q)[:3])
    np.testing.assert_allclose(free.T @ (weights * (answer.q - wanted)), 0.0, atol=1e-3)


def test_only_weighted_joint_takes_its_preferred_angle():
    solver, wanted = leaning("so101", weights=np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
    answer = clicked(solver, stage("so101").home)
    assert answer.q[4] == pytest.approx(wanted[4], abs=1e-3)


def test_preferred_posture_keeps_joints_beyond_grabbed_link():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "forearm", (-0.03, 0.0, 0.0))
    drag.press(px, view_state)
    solver, _ = leaning("so101")
    last = answers_of(solver, drag.move(px + 5.0), view_state.arms[0])[-1]
    np.testing.assert_array_equal(last.q[3:], view_state.arms[0][3:])


# --- what lies behind ---


def behind_each_other():
    """Return a pixel at which two links of the arm at home overlap, and the view."""
    view_state, drag = sight("so101", "front"), drag_of("so101")
    for link in ("wrist", "forearm", "upper_arm", "shoulder"):
        px = pixel_of("so101", "front", view_state.arms[0], link)
        names = [
            f.hit.link for f in drag.candidates_under(px, view_state)[0] if f and f.kind == "link"
        ]
        if len(names) > 1:
            return px, view_state, names
    raise AssertionError("nothing lies behind anything")


def test_links_behind_each_other_are_listed_by_depth():
    px, view_state, names = behind_each_other()
    options, index = drag_of("so101").candidates_under(px, view_state)
    depths = [found.hit.depth_m for found in options if found and found.kind == "link"]
    assert depths == sorted(depths)
    assert len(set(names)) == len(names)
    assert index == 0


def test_preview_at_measured_posture_is_not_listed_twice():
    px, view_state, names = behind_each_other()
    q, drag = view_state.arms[0], drag_of("so101")

    def listed(*arms):
        options, _ = drag.candidates_under(px, PointerContext(view_state.camera, arms))
        return [found.hit.link for found in options if found and found.kind == "link"]

    assert listed(q + 1e-4, q) == names
    assert len(listed(q + 0.05, q)) > len(names)


def test_select_next_cycles_through_links_behind_each_other():
    px, view_state, names = behind_each_other()
    drag, hovered = drag_of("so101"), []
    for _ in drag.candidates_under(px, view_state)[0]:
        hovered.append(drag.hover(px, view_state))
        drag.select_next(px, view_state)
    assert hovered[: len(names)] == names
    assert drag.hover(px, view_state) == names[0]
    drag.select_next(px, view_state, -1)
    drag.select_next(px, view_state, 1)
    assert drag.hover(px, view_state) == names[0]


def test_second_click_at_same_place_grabs_link_behind():
    px, view_state, names = behind_each_other()
    drag = drag_of("so101")
    for name in names:
        drag.press(px, view_state)
        assert drag.grabbed_link == name
        drag.release()


def test_drag_moves_selected_link_behind_others():
    px, view_state, names = behind_each_other()
    drag = drag_of("so101")
    drag.select_next(px, view_state)
    assert drag.press(px, view_state).target.frame == names[1]


def test_drag_resets_selection_to_nearest_link():
    px, view_state, names = behind_each_other()
    drag = drag_of("so101")
    drag.select_next(px, view_state)
    drag.press(px, view_state)
    drag.move(px + 20.0)
    drag.release()
    assert drag.hover(px, view_state) == names[0]


def test_click_at_other_place_selects_nearest_link_again():
    px, view_state, names = behind_each_other()
    drag = drag_of("so101")
    drag.select_next(px, view_state)
    other_place = px + np.array([0.0, 6.0])
    assert drag.hover(px + 0.5, view_state) == names[1]
    assert drag.hover(other_place, view_state) in {*names, None}
    assert drag.candidates_under(other_place, view_state)[1] == 0


def test_press_behind_all_links_moves_tip_to_that_point():
    px, view_state, names = behind_each_other()
    drag = drag_of("so101")
    for _ in names:
        drag.select_next(px, view_state)
    command = drag.press(px, view_state)
    assert command.target.frame is None
    assert command.is_click


def test_base_is_listed_last_and_cannot_be_dragged():
    view_state, drag = sight("so101", "side"), drag_of("so101")
    px = pixel_of("so101", "side", view_state.arms[0], "base", (0.0, 0.0, 0.01))
    assert drag.candidates_under(px, view_state)[0][-1].kind == "fixed"
    drag.select_next(px, view_state, -1)
    drag.press(px, view_state)
    with pytest.raises(InputError, match="base cannot be dragged"):
        drag.move(px + 10.0)


# --- objects of the scene ---

CUP = KeepOutBox("the cup", (0.15, 0.12, 0.0), (0.25, 0.2, 0.1))


def with_a_cup(view):
    """Return the drag and the view of an arm beside a cup, and the pixel of the cup's centre."""
    model = replace(model_of("so101"), keep_out=(CUP,))
    view_state = sight("so101", view)
    drag = Drag(model.chain, picker("so101"), Picker(thing_shapes(model.keep_out)))
    return drag, view_state, view_state.camera.project(np.array([0.2, 0.16, 0.05]))[0]


@pytest.mark.parametrize("view", ["top", "orbit"])
def test_box_is_picked_at_point_where_ray_meets_it(view):
    drag, view_state, px = with_a_cup(view)
    found = next(f for f in drag.candidates_under(px, view_state)[0] if f and f.kind == "object")
    assert found.hit.link == "the cup"
    point, low, high = found.hit.point_m, np.array(CUP.low_m), np.array(CUP.high_m)
    assert (point >= low - 1e-9).all()
    assert (point <= high + 1e-9).all()
    assert np.minimum(np.abs(point - low), np.abs(point - high)).min() < 1e-9
    np.testing.assert_allclose(view_state.camera.project(point)[0], px, atol=1e-6)


@pytest.mark.parametrize("view", ["top", "orbit"])
def test_dragged_box_moves_horizontally_with_pointer(view):
    drag, view_state, px = with_a_cup(view)
    assert drag.press(px, view_state) is None
    assert not drag.moved_thing.shift_m.any()
    found = next(f for f in drag.candidates_under(px, view_state)[0] if f and f.kind == "object")
    for step in (10.0, 20.0):
        assert drag.move(px + step) is None
    moved = drag.moved_thing
    assert (moved.name, moved.is_dropped) == ("the cup", False)
    assert moved.shift_m[2] == pytest.approx(0.0, abs=1e-12)
    at_px = view_state.camera.project(found.hit.point_m + moved.shift_m)[0]
    np.testing.assert_allclose(at_px, px + 20.0, atol=1e-6)
    drag.release()
    assert drag.moved_thing.is_dropped
    drag.cancel()
    assert drag.moved_thing is None


def test_second_click_on_box_moves_tip_to_clicked_point():
    drag, view_state, px = with_a_cup("top")
    drag.press(px, view_state)
    drag.release()
    assert drag.press(px, view_state).target.frame is None


def test_a_link_is_grabbed_before_the_box_around_it():
    model = replace(model_of("so101"), keep_out=(KeepOutBox("the cage", (-1, -1, 0), (1, 1, 1)),))
    view_state = sight("so101", "side")
    drag = Drag(model.chain, picker("so101"), Picker(thing_shapes(model.keep_out)))
    assert (
        drag.press(pixel_on("so101", view_state, "forearm"), view_state).target.frame == "forearm"
    )
