"""A result says whether it is the only solution, one of several, or one of a family."""

import math

import numpy as np
import pytest

from ikservo.ik import Solver, Target, solve
from ikservo.ik.closed_form import solutions
from ikservo.ik.other_solutions import solution_set
from ikservo.kinematics.se3 import make_pose
from ikservo.model import load_model
from tests.ik.lecture import pantograph
from tests.kinematics.chains import planar


def test_planar_2r_point_has_two_solutions():
    found = solve(planar(0.3, 0.2), Target((0.3, 0.2, 0.0))).solutions
    assert (found.kind, found.count, found.freedom) == ("several", 2, 0)
    assert str(found) == "one of 2 solutions"


def test_joint_limit_leaves_one_ik_solution():
    chain = planar(0.3, 0.2).with_limits([-3.0, 0.1], [3.0, 3.0])
    found = solve(chain, Target((0.3, 0.2, 0.0))).solutions
    assert (found.kind, found.count) == ("one", 1)


def test_stretched_planar_2r_has_one_solution():
    chain = planar(0.3, 0.2)
    found = solution_set(chain, Target((0.5, 0.0, 0.0)), np.zeros(2))
    assert (found.kind, found.count) == ("one", 1)


def test_point_out_of_reach_has_no_solution():
    found = solve(planar(0.3, 0.2), Target((0.8, 0.2, 0.0))).solutions
    assert (found.kind, str(found)) == ("none", "no solution found")


def test_planar_3r_point_has_one_parameter_family():
    found = solve(planar(0.3, 0.2, 0.1), Target((0.3, 0.2, 0.0))).solutions
    assert (found.kind, found.freedom) == ("family", 1)
    assert found.count == len(found.directions) >= 1
    assert str(found).startswith("one of a one-parameter family with ")


def test_planar_3r_point_and_direction_have_two_solutions():
    chain = planar(0.3, 0.2, 0.1)
    T = chain.forward([0.3, 0.5, 0.4])
    target = Target(T[:3, 3], direction=T[:3, 0], tool_axis=(1, 0, 0))
    found = solve(chain, target).solutions
    assert (found.kind, found.count) == ("several", 2)


def test_tight_joint_limits_leave_no_solution_family():
    q = np.array([0.3, 0.5, 0.4])
    chain = planar(0.3, 0.2, 0.1)
    T = chain.forward(q)
    held = np.array([2.0, 1e-12, 2.0])
    tight = chain.with_limits(q - held, q + held)
    assert solution_set(tight, Target(T[:3, 3]), q).kind != "family"


@pytest.mark.parametrize(
    ("name", "kind", "freedom"),
    [("so101", "position", 2), ("wx250s", "position", 2), ("wx250s", "direction", 1),
     ("px100", "position", 1)],
)  # fmt: skip
def test_redundancy_gives_solution_family_of_that_dimension(name, kind, freedom):
    chain = load_model(name).chain
    T = chain.forward(chain.mid_range() + 0.2)
    target = Target(T[:3, 3], direction=T[:3, 2] if kind == "direction" else None)
    found = solve(chain, target).solutions
    assert (found.kind, found.freedom) == ("family", freedom)


def test_pose_solution_count_equals_closed_form_count():
    chain, rng = load_model("wx250s").chain, np.random.default_rng(6)
    counts = set()
    for q in rng.uniform(chain.lower_rad, chain.upper_rad, (12, chain.dof)):
        T = chain.forward(q)
        target = Target(T[:3, 3], orientation=T[:3, :3])
        found = solve(chain, target, chain.mid_range()).solutions
        assert found.count == len(solutions(chain, target))
        assert found.kind == ("one" if found.count == 1 else "several")
        counts.add(found.count)
    assert max(counts) > 2


def test_point_on_base_yaw_axis_has_solution_family():
    chain = load_model("px100").chain
    T = chain.forward(np.zeros(4))
    on_axis = Target((T[0, 3] * 0.0, 0.0, 0.25))
    result = solve(chain, on_axis)
    assert result.reached
    assert result.solutions.kind == "family"


def test_aligned_wrist_has_one_parameter_family():
    chain, q = load_model("wx250s").chain, np.array([0.3, -0.4, 0.5, 0.6, 0.0, -0.2])
    T = chain.forward(q)
    found = solution_set(chain, Target(T[:3, 3], orientation=T[:3, :3]), q)
    assert (found.kind, found.freedom) == ("family", 1)


def test_solution_count_without_closed_form_is_unknown():
    chain = pantograph()
    result = solve(chain, Target(chain.forward([0.4, 0.5])[:3, 3]))
    assert (result.solutions.kind, str(result.solutions)) == ("unknown", "others not known")


def test_solver_object_does_not_count_solutions():
    chain = planar(0.3, 0.2)
    solver = Solver(chain)
    solver(make_pose(np.array([0.3, 0.2, 0.0])), np.zeros(2))
    assert solver.result.solutions.kind == "unknown"
    assert solver.result.conditioning is None
    assert solver.result.singularity is None


def test_ik_result_reports_conditioning_and_singularity():
    result = solve(planar(0.3, 0.2), Target((0.3, 0.2, 0.0)))
    assert result.conditioning is not None
    assert 0.0 < result.conditioning.slowest_m_rad < 0.5
    assert result.singularity is not None
    elbow = abs(result.q[1])
    assert result.singularity.distance_rad == pytest.approx(min(elbow, math.pi - elbow), abs=1e-3)
