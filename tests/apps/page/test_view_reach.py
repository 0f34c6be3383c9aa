"""The region that the tip can reach in the plane of the view."""

import math
from functools import cache

import numpy as np
import pytest

from ikservo.apps.page.drawing.reachable_region import compute_region, slice_plane
from ikservo.apps.page.picking.viewpoints import arm_extent
from ikservo.ik import Target, solve
from tests.apps.page.planar_arm import planar_model
from tests.apps.page.view_fixtures import model_of, stage


@cache
def reach_of(view):
    return compute_region(model_of("so101").chain, plane_of("so101", view))


def plane_of(name, view, q=None):
    q = stage(name).home if q is None else q
    return slice_plane(stage(name), view, q, lambda: model_of(name).chain.forward(q)[:3, 3])


def wound(rings, at):
    """Return the winding number of rings around a point: 1 inside, 0 outside and in holes."""
    arms = [ring - at for ring in rings]
    turns = [
        np.angle(np.exp(1j * np.diff(np.arctan2(*np.vstack([a, a[:1]]).T[::-1])))) for a in arms
    ]
    return round(sum(float(t.sum()) for t in turns) / math.tau)


def test_reachable_region_of_two_links_is_a_ring():
    model = planar_model([0.2, 0.1])
    the_stage = arm_extent(model)
    plane = slice_plane(the_stage, "plane", the_stage.home, lambda: np.zeros(3))
    rings = compute_region(model.chain, plane).rings
    inside = [wound(rings, np.array([r, 0.0])) for r in (0.05, 0.15, 0.25, 0.35)]
    assert inside == [0, 1, 1, 0]


def test_shaded_region_matches_reachable_points():
    chain, plane = model_of("so101").chain, plane_of("so101", "side")
    reach, random = reach_of("side"), np.random.default_rng(3)
    wrong = 0
    for u, v in random.uniform((-0.4, 0.0), (0.5, 0.5), (40, 2)):
        there = (reach.T_world_plane @ (u, v, 0.0, 1.0))[:3]
        found = solve(chain, Target(there))
        is_border = 0 < found.position_error_m < 2 * plane.cell_m
        wrong += bool(wound(reach.rings, np.array([u, v]))) != found.reached and not is_border
    assert wrong <= 1  # one that is reached by less than a cell


def test_reachable_region_turns_with_arm_without_recomputation():
    chain, home = model_of("so101").chain, stage("so101").home
    turned = home + 0.7 * np.eye(chain.dof)[0]
    here, there = plane_of("so101", "side"), plane_of("so101", "side", turned)
    assert here.key == there.key
    assert not np.allclose(here.T_world_plane, there.T_world_plane)


def test_top_view_region_lies_at_tip_height_within_1_cm():
    tip_m = model_of("so101").chain.forward(stage("so101").home)[:3, 3]
    assert plane_of("so101", "top").T_world_plane[2, 3] == pytest.approx(tip_m[2], abs=0.0051)


def test_front_view_region_goes_through_tip_within_1_cm():
    tip_m = model_of("so101").chain.forward(stage("so101").home)[:3, 3]
    T = plane_of("so101", "front").T_world_plane
    assert abs((tip_m - T[:3, 3]) @ T[:3, 2]) < 0.0051


def test_orbit_view_does_not_show_reachable_region():
    assert plane_of("so101", "orbit") is None


@pytest.mark.parametrize("view", ["side", "top"])
def test_reachable_region_border_is_within_reach_of_shoulder(view):
    """Every border point is within the longest stretch of the arm from its shoulder."""
    chain, T = model_of("so101").chain, reach_of(view).T_world_plane
    border = np.vstack([np.array(ring) for ring in reach_of(view).rings]) @ T[:3, :2].T + T[:3, 3]
    shoulder = chain.forward(stage("so101").home, "upper_arm")[:3, 3]
    assert np.linalg.norm(border - shoulder, axis=1).max() < 0.55
