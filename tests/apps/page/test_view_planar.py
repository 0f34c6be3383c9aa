"""The planar arm of the lecture: any number of links, any method, all iterations visible."""

import math

import numpy as np
import pytest

from ikservo.apps.page.dragging.solver_demo import SOLVERS, trace_method
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.picking import Picker
from ikservo.apps.page.picking.projection import Viewport
from ikservo.apps.page.picking.raycast import link_shapes
from ikservo.apps.page.picking.viewpoints import (
    Viewpoint,
    arm_extent,
    available_views,
    make_camera,
)
from ikservo.errors import UnknownNameError
from ikservo.kinematics import distance_to_limits
from ikservo.model.collision_capsules import capsules_of
from tests.apps.page.planar_arm import planar_model
from tests.apps.page.view_fixtures import selected

LENGTHS_M = [0.12, 0.10, 0.08]
MODEL = planar_model(LENGTHS_M)
START = np.array([0.3, 0.6, -0.4])
TARGET_M = np.array([0.05, 0.18, 0.0])
CAMERA = make_camera(arm_extent(MODEL), Viewpoint("plane"), Viewport(600, 600), 0.0)


@pytest.mark.parametrize("lengths_m", [[0.1], [0.2, 0.1], LENGTHS_M, [0.05] * 12])
def test_planar_arm_is_as_long_as_its_links(lengths_m):
    chain = planar_model(lengths_m).chain
    assert chain.dof == len(lengths_m)
    assert chain.forward(np.zeros(chain.dof))[0, 3] == pytest.approx(sum(lengths_m))


def test_planar_tip_is_sum_of_rotated_links():
    angles = np.cumsum(START)
    expected = np.array(LENGTHS_M) @ np.column_stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(MODEL.chain.forward(START)[:2, 3], expected, atol=1e-12)


def test_planar_arm_offers_only_view_along_its_axes():
    assert available_views(arm_extent(MODEL)) == ("plane",)


def test_planar_arm_is_picked_like_any_arm():
    chain = MODEL.chain
    picker, poses = Picker(link_shapes(capsules_of(MODEL))), link_poses(chain, START, {})
    middle = chain.forward(START, "link2", (0.05, 0.0, 0.0))[:3, 3]
    hit = selected(picker.pick_all_at(CAMERA, poses, CAMERA.project(middle)[0]))
    assert hit.link == "link2"


@pytest.mark.parametrize("method", SOLVERS)
def test_solver_methods_start_at_same_joints_and_reach_target(method):
    solver_trace = trace_method(MODEL.chain, TARGET_M, START, method)
    np.testing.assert_allclose(
        solver_trace.lines_m[0, -1], MODEL.chain.forward(START)[:3, 3], atol=1e-12
    )
    assert solver_trace.result.reached
    assert solver_trace.distance_left_m(solver_trace.count - 1) < 1e-4


@pytest.mark.parametrize("method", SOLVERS)
def test_solver_methods_end_nearest_to_unreachable_target(method):
    solver_trace = trace_method(MODEL.chain, np.array([0.5, 0.2, 0.0]), START, method)
    assert not solver_trace.page_fields["reached"]
    assert solver_trace.distance_left_m(solver_trace.count - 1) == pytest.approx(
        math.hypot(0.5, 0.2) - 0.3, abs=2e-3
    )


@pytest.mark.parametrize("method", SOLVERS)
def test_solver_iterations_stay_inside_joint_limits(method):
    solver_trace = trace_method(MODEL.chain, TARGET_M, START, method)
    assert distance_to_limits(MODEL.chain, np.array(solver_trace.result.trace)).min() >= 0.0


def test_page_receives_link_positions_of_every_solver_step():
    solver_trace = trace_method(MODEL.chain, TARGET_M, START, "ccd")
    sent = np.array(solver_trace.page_fields["lines"])
    assert len(sent) == solver_trace.count
    step = solver_trace.count // 2
    q = solver_trace.result.trace[solver_trace.numbers[step]]
    links = ("link1", "link2", "link3", "tool")
    expected = [MODEL.chain.forward(q, link)[:3, 3] for link in links]
    np.testing.assert_allclose(sent[step], expected, atol=1e-5)


def test_long_solver_trace_is_thinned_and_keeps_both_ends():
    far = MODEL.chain.forward(np.array([-2.9, -2.0, 2.5]))[:3, 3]
    solver_trace = trace_method(MODEL.chain, far, START, "transpose")
    assert solver_trace.count <= 200
    assert solver_trace.numbers[0] == 0
    assert solver_trace.numbers[-1] == len(solver_trace.result.trace) - 1


def test_solver_step_text_has_number_and_remaining_distance():
    solver_trace = trace_method(MODEL.chain, TARGET_M, START, "ccd")
    last = solver_trace.numbers[-1]
    assert (
        solver_trace.format_step(solver_trace.count - 1)
        == f"ccd, iteration {last} of {last}: 0.0 mm left"
    )


def test_unknown_solver_method_is_refused():
    with pytest.raises(UnknownNameError):
        trace_method(MODEL.chain, TARGET_M, START, "magic")
