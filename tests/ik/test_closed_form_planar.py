"""Two and three links in a plane, as in the lecture (L3, L4)."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.ik import Target, solve
from ikservo.ik.closed_form import closest_solution, direction_intervals, solutions
from ikservo.ik.planar import (
    nearest_planar_angles,
    planar_tip,
    solve_planar_2r,
    solve_planar_3r,
    within_limits,
)
from ikservo.ik.subproblems import nearest_equivalent_angle, solve_acos_bsin
from tests.kinematics.chains import planar

TWO, THREE = planar(0.3, 0.2), planar(0.3, 0.2, 0.1)
length = st.floats(0.05, 1.0)
angle = st.floats(-3.1, 3.1)


def link(length_m, bend_rad):
    return cmath.rect(length_m, bend_rad)


def narrowed(chain, rng):
    ends = np.sort(rng.uniform(-math.pi, math.pi, (2, chain.dof)), axis=0)
    return chain.with_limits(ends[0], ends[1])


@given(length, angle, length, angle, angle, angle)
def test_planar_2r_solutions_reach_the_point(a, b, c, d, e, f):
    l1, l2 = link(a, b), link(c, d)
    m = planar_tip((l1, l2), (e, f))
    for angles in solve_planar_2r(l1, l2, m):
        assert abs(planar_tip((l1, l2), angles) - m) < 1e-9


@given(length, length, st.floats(0.1, 3.0), angle)
def test_planar_2r_elbows_bend_to_opposite_sides(L1, L2, bend, turn):
    m = planar_tip((L1 + 0j, L2 + 0j), (turn, bend))
    (_, left), (_, right) = solve_planar_2r(L1 + 0j, L2 + 0j, m)
    assert left == pytest.approx(bend, abs=1e-6)
    assert right == pytest.approx(-left, abs=1e-12)


@pytest.mark.parametrize("d", [0.5000001, 0.0999999])
def test_planar_2r_has_no_solution_outside_annulus(d):
    assert solve_planar_2r(0.3 + 0j, 0.2 + 0j, d + 0j) == ()


@pytest.mark.parametrize(("d", "bend"), [(0.5, 0.0), (0.1, math.pi)])
@pytest.mark.parametrize("direction", [0.0, 0.7, -2.5])
def test_planar_2r_has_one_exact_solution_on_annulus_edge(d, bend, direction):
    found = solutions(TWO, Target((d * math.cos(direction), d * math.sin(direction), 0)))
    assert len(found) == 1
    assert abs(found[0][1]) == pytest.approx(bend, abs=1e-7)
    np.testing.assert_allclose(
        TWO.forward(found[0])[:2, 3], [d * math.cos(direction), d * math.sin(direction)], atol=1e-12
    )


def test_planar_2r_has_two_solutions_nearest_first():
    up, down = solutions(TWO, Target((0.35, 0.1, 0.0)), q0=[0.0, 1.0])
    assert up[1] > 0.1
    assert down[1] == pytest.approx(-up[1])


def test_planar_joint_limits_leave_only_allowed_elbow():
    arm = TWO.with_limits([-math.pi, -math.pi], [math.pi, 0.0])
    (only,) = solutions(arm, Target((0.35, 0.1, 0.0)), q0=[0.0, 1.0])
    assert only[1] < 0


def test_joint_limits_that_exclude_both_elbows_give_no_solution():
    arm = TWO.with_limits([-math.pi, -0.1], [math.pi, 0.1])
    assert solutions(arm, Target((0.35, 0.1, 0.0))) == ()


@pytest.mark.parametrize("target", [(3.0, 4.0), (0.03, 0.04)])
def test_nearest_point_outside_annulus_is_on_its_edge(target):
    result = solve(TWO, Target((*target, 0.0)), method="closed_form")
    d = 0.5 if target[0] > 1 else 0.1
    assert result.method == "closed_form"
    assert not result.reached
    np.testing.assert_allclose(result.nearest_m, [0.6 * d, 0.8 * d, 0.0], atol=1e-12)


@pytest.mark.parametrize("chain", [TWO, THREE])
def test_planar_nearest_point_in_limits_is_as_good_as_search(chain):
    rng = np.random.default_rng(5)
    for _ in range(25):
        arm = narrowed(chain, rng)
        target = rng.uniform(-0.7, 0.7, 2)
        grid = np.meshgrid(
            *(np.linspace(a, b, 40) for a, b in zip(arm.lower_rad, arm.upper_rad, strict=True))
        )
        headings = np.cumsum([axis.ravel() for axis in grid], axis=0)
        tips = (np.array([0.3, 0.2, 0.1])[: arm.dof, None] * np.exp(1j * headings)).sum(axis=0)
        densest = float(np.abs(tips - complex(*target)).min())
        result = solve(arm, Target((*target, 0.0)), method="closed_form")
        assert result.method == "closed_form"
        assert result.position_error_m <= densest + 1e-12
        assert result.position_error_m >= densest - 0.06


def test_nearest_planar_point_is_projection_of_target():
    result = solve(THREE, Target((0.3, 0.2, 0.15)), method="closed_form")
    np.testing.assert_allclose(result.nearest_m, [0.3, 0.2, 0.0], atol=1e-12)
    assert result.position_error_m == pytest.approx(0.15)


def test_planar_angles_at_limits_are_better_than_dense_search():
    limits = ((-1.0, 1.0), (0.3, 0.4), (-0.2, 0.2))
    best = nearest_planar_angles(
        (0.3 + 0j, 0.2 + 0j, 0.1 + 0j), limits, 2.0 + 0.5j, (0.0, 0.0, 0.0)
    )[0]
    reaches = [
        abs(planar_tip((0.3 + 0j, 0.2 + 0j, 0.1 + 0j), (a, 0.3, c)) - (2.0 + 0.5j))
        for a in np.linspace(-1, 1, 401)
        for c in np.linspace(-0.2, 0.2, 81)
    ]
    assert abs(planar_tip((0.3 + 0j, 0.2 + 0j, 0.1 + 0j), best) - (2.0 + 0.5j)) <= min(reaches)


@given(length, angle, length, length, angle, angle, angle)
def test_planar_3r_solutions_reach_point_and_tool_direction(a, b, c, d, e, f, g):
    links = (link(a, b), c + 0j, d + 0j)
    m = planar_tip(links, (e, f, g))
    for angles in solve_planar_3r(*links, m, e + f + g):
        assert abs(planar_tip(links, angles) - m) < 1e-9
        assert math.remainder(sum(angles) - (e + f + g), 2 * math.pi) == pytest.approx(0, abs=1e-9)


def test_planar_3r_reaches_direction_with_both_elbows():
    T = THREE.forward([0.4, -0.9, 1.3])
    found = solutions(THREE, Target(T[:3, 3], direction=T[:3, 0], tool_axis=(1, 0, 0)))
    assert len(found) == 2
    for q in found:
        np.testing.assert_allclose(THREE.forward(q), T, atol=1e-12)


def test_planar_3r_replaces_forbidden_direction_by_nearest():
    arm = THREE.with_limits([-1.0, -1.5, -0.5], [1.0, 1.5, 0.5])
    target = Target((0.45, 0.1, 0.0), direction=(0, 1, 0), tool_axis=(1, 0, 0))
    result = solve(arm, target, method="closed_form")
    ends = [end for i in direction_intervals(arm, target) for end in (i.lower_rad, i.upper_rad)]
    best = min(abs(0.5 * math.pi - end) for end in ends)
    assert result.method == "closed_form"
    assert result.position_error_m < 1e-12
    assert result.orientation_error_rad == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_reachable_direction_intervals_equal_dense_scan(seed):
    rng = np.random.default_rng(seed)
    arm = narrowed(THREE, rng)
    target = Target(arm.forward(rng.uniform(arm.lower_rad, arm.upper_rad))[:3, 3])
    found = direction_intervals(arm, target)
    assert found
    for alpha in np.linspace(-math.pi, math.pi, 721):
        edges = (end for i in found for end in (i.lower_rad, i.upper_rad))
        if min(abs(math.remainder(alpha - end, 2 * math.pi)) for end in edges) < 1e-6:
            continue
        m = complex(*target.position[:2])
        for elbow, angles in enumerate(solve_planar_3r(0.3 + 0j, 0.2 + 0j, 0.1 + 0j, m, alpha)):
            limits = zip(angles, arm.lower_rad, arm.upper_rad, strict=True)
            allowed = all(
                nearest_equivalent_angle(a, low, high, 0.0) is not None for a, low, high in limits
            )
            assert allowed == any(
                i.elbow == elbow
                and nearest_equivalent_angle(alpha, i.lower_rad, i.upper_rad, i.lower_rad)
                is not None
                for i in found
            )


@pytest.mark.parametrize("direction", [0.0, 1.0, 3.0])
def test_stretched_planar_3r_reaches_only_one_direction(direction):
    point = (0.6 * math.cos(direction), 0.6 * math.sin(direction), 0.0)
    assert direction_intervals(THREE, Target(point))
    for interval in direction_intervals(THREE, Target(point)):
        assert interval.lower_rad == pytest.approx(direction, abs=1e-5)
        assert interval.upper_rad == pytest.approx(direction, abs=1e-5)


def test_reachable_directions_of_near_point_are_full_circle():
    # Within 0.3 of the first joint no wrist point is out of reach of links of 0.3 and 0.3.
    arm = planar(0.3, 0.3, 0.1, limit_rad=10.0)
    for interval in direction_intervals(arm, Target((0.2, 0.1, 0.0))):
        assert interval.upper_rad - interval.lower_rad == pytest.approx(2 * math.pi)


def test_point_out_of_reach_has_no_reachable_directions():
    assert direction_intervals(THREE, Target((0.5, 0.5, 0.0))) == ()


@pytest.mark.parametrize("seed", range(12))
def test_planar_3r_chooses_direction_with_nearest_joints(seed):
    arm, rng = planar(0.3, 0.2, 0.1, limit_rad=2.5), np.random.default_rng(seed)
    target, q0 = Target(arm.forward(rng.uniform(-2, 2, 3))[:3, 3]), rng.uniform(-2, 2, 3)
    nearest = solutions(arm, target, q0)[0]
    m = complex(*target.position[:2])
    scan = (
        within_limits(angles, [(-2.5, 2.5)] * 3, tuple(q0))
        for alpha in np.linspace(-math.pi, math.pi, 721)
        for angles in solve_planar_3r(0.3 + 0j, 0.2 + 0j, 0.1 + 0j, m, alpha)
    )
    nearest_scanned = min(np.linalg.norm(q - q0) for q in scan if q is not None)
    assert np.linalg.norm(nearest - q0) <= nearest_scanned + 1e-3


def test_planar_3r_returns_start_if_it_reaches_target():
    q = np.array([0.3, 0.8, -0.4])
    np.testing.assert_allclose(solutions(THREE, Target(THREE.forward(q)[:3, 3]), q)[0], q,
                               atol=1e-9)  # fmt: skip


def test_planar_2r_chooses_turn_nearest_to_start():
    arm = planar(0.3, 0.2, limit_rad=10.0)
    q = solutions(arm, Target(arm.forward([6.5, 1.0])[:3, 3]), q0=[6.0, 0.8])[0]
    np.testing.assert_allclose(q, [6.5, 1.0], atol=1e-9)


def test_planar_solution_on_limit_is_exactly_inside_limit():
    arm = TWO.with_limits([-1.0, 0.3], [0.7, 1.1])
    for q in ([-1.0, 0.3], [0.7, 1.1], [0.7, 0.3]):
        found = solutions(arm, Target(arm.forward(q)[:3, 3]))[0]
        assert (arm.lower_rad <= found).all()
        assert (found <= arm.upper_rad).all()
        np.testing.assert_allclose(found, q, atol=1e-8)


def test_point_off_the_plane_has_only_nearest_solution():
    target = Target((0.3, 0.1, 0.2))
    assert solutions(THREE, target) == ()
    assert closest_solution(THREE, target)


@given(st.floats(-2, 2), st.floats(-2, 2), angle)
def test_solving_a_cos_plus_b_sin_recovers_known_angle(a, b, theta):
    found = solve_acos_bsin(a, b, a * math.cos(theta) + b * math.sin(theta))
    if found is not None:
        assert min(abs(math.remainder(t - theta, 2 * math.pi)) for t in found) < 1e-6
