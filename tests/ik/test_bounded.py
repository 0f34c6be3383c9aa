"""The production solver on the shipped arms: seeded and short; long versions are campaigns."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.ik import Options, Solver, Target, solve
from ikservo.ik.batch import solve_batch
from ikservo.kinematics import Chain, JointType
from ikservo.model import load_model
from tests.ik.campaigns import (
    closest_of_many,
    missed_within_narrowed_limits,
    narrowed,
    out_of_reach,
    points_out_of_reach,
    tool_axis,
)
from tests.ik.line_tracking import MIN_LEVER, STEP_M, largest_step_on_lines
from tests.kinematics.chains import joint, planar
from tests.oracle import ARMS

# What the worst lever allowed asks of a joint for one step along a line.
GEOMETRY_RAD = STEP_M / MIN_LEVER
KINDS = ("position", "direction", "pose")
FEW_JOINTS = ("koch", "omx_f", "open_manipulator_x", "px100", "so100", "so101")


@pytest.mark.parametrize("kind", KINDS)
def test_bounded_solver_reaches_targets_in_narrowed_limits(kind):
    assert sum(missed_within_narrowed_limits(name, kind, 3, 60, seed=1) for name in ARMS) == 0


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    ("kind", "share"), [("position", 1e-4), ("direction", 1e-4), ("pose", 1e-3)]
)
def test_bounded_solver_reaches_100000_targets(name, kind, share):
    assert missed_within_narrowed_limits(name, kind, 200, 500) <= share * 100_000


def test_bounded_solver_matches_dense_search_out_of_reach():
    random = np.random.default_rng(5)
    for _ in range(2):
        chain, target_m = out_of_reach("so101", random, narrow=True)
        found_m = solve(chain, Target(target_m), method="bounded").position_error_m
        assert found_m - closest_of_many(chain, target_m) < 1e-3


def gaps_to_dense_search_m(chain, count, random, starts=40):
    """Return how much farther off than those of a dense search the nearest points are (count,).

    The dense search takes the best of five times as many starting points as the solver, and of
    walks from as many random joints for each point.
    """
    targets_m = points_out_of_reach(chain, count, random)
    many = Options(restarts=5 * Options().restarts)
    best_m = solve_batch(chain, targets_m, options=many).position_error_m
    for _ in range(starts):
        q0s = random.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof))
        once = solve_batch(chain, targets_m, q0s, options=Options(restarts=1))
        best_m = np.minimum(best_m, once.position_error_m)
    return solve_batch(chain, targets_m).position_error_m - best_m


@pytest.mark.campaign
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", ARMS)
def test_bounded_solver_matches_dense_search_of_10000_targets(name):
    random = np.random.default_rng(6)
    assert gaps_to_dense_search_m(load_model(name).chain, 10_000, random).max() < 1e-3


@pytest.mark.campaign
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", ARMS)
def test_bounded_solver_misses_nearest_point_in_0_2_percent(name):
    chain, random = load_model(name).chain, np.random.default_rng(6)
    gaps_m = [
        gaps_to_dense_search_m(narrowed(chain, random), 50, random, starts=20) for _ in range(200)
    ]
    assert np.mean(np.concatenate(gaps_m) > 1e-3) <= 0.002


def turned_poses(chain, count, random):
    """Return poses (count, 4, 4) in reach with random orientations that are out of reach."""
    T = chain.forward(random.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof)))
    for pose in T:
        turned, _ = np.linalg.qr(random.normal(size=(3, 3)))
        pose[:3, :3] = turned * np.linalg.det(turned)
    return T


def worse_than_dense_search_deg(name, kind, T, starts, random):
    """Return the excess errors of rotations of T (n, 4, 4) over a dense search (n,).

    The dense search slides to the best turn from many random joints, and from none of the starting
    points that the solver would use first.
    """
    model, count = load_model(name), len(T)
    chain, axis = model.chain, tool_axis(name)
    found = solve_batch(chain, T, model.chain_pose("home"), kind=kind, tool_axis=axis)
    assert (found.position_error_m < 1e-4).all()
    best_rad = np.full(count, math.pi)
    for _ in range(starts):
        q0s = random.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof))
        once = Options(restarts=1)
        tried = solve_batch(chain, T, q0s, kind=kind, tool_axis=axis, options=once)
        met = tried.position_error_m < 1e-5
        best_rad[met] = np.minimum(best_rad, tried.orientation_error_rad)[met]
    return np.degrees(found.orientation_error_rad - best_rad)


@pytest.mark.parametrize("name", FEW_JOINTS)
def test_bounded_solver_finds_best_direction_with_few_joints(name):
    random = np.random.default_rng(4)
    T = turned_poses(load_model(name).chain, 10, random)
    assert worse_than_dense_search_deg(name, "direction", T, 40, random).max() < 1.0


@pytest.mark.parametrize("row", [3, 2926])
def test_bounded_solver_finds_best_angle_at_full_turn_limit(row):
    """Row 3 is 20 µm from the first axis, row 2926 40 µrad inside the gap of its joint."""
    name, random = "open_manipulator_x", np.random.default_rng(4)
    T = turned_poses(load_model(name).chain, 10_000, random)[[row]]
    assert worse_than_dense_search_deg(name, "pose", T, 40, random).max() < 1.0


@pytest.mark.parametrize("end", [-3.14, 3.14])
def test_target_in_gap_of_full_turn_is_reached_from_nearer_end(end):
    arm = planar(0.3, 0.2).with_limits([-3.14, 0.2], [3.14, 1.0])
    beyond = arm.forward([1.000003 * end, 0.5])
    q, reached = Solver(arm)(beyond, [0.9 * end, 0.4])
    assert reached
    assert q[0] == end


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", FEW_JOINTS)
@pytest.mark.parametrize("kind", ["direction", "pose"])
def test_bounded_solver_finds_best_of_10000_orientations(name, kind):
    random = np.random.default_rng(4)
    T = turned_poses(load_model(name).chain, 10_000, random)
    assert worse_than_dense_search_deg(name, kind, T, 300, random).max() < 1.0


def test_ik_error_is_shared_without_position_priority():
    chain = planar(0.3, 0.2, limit_rad=2.5)
    target = Target((0.35, 0.1, 0.0), direction=(0, 1, 0), tool_axis=(1, 0, 0))
    first = solve(chain, target, method="bounded")
    shared = solve(chain, target, method="bounded", position_first=False)
    assert first.position_error_m < 1e-5 < shared.position_error_m
    assert shared.orientation_error_rad < first.orientation_error_rad


def test_bounded_solver_follows_lines_without_branch_flips():
    assert largest_step_on_lines("so101", "position", 8, seed=3) < 1.5 * GEOMETRY_RAD
    assert largest_step_on_lines("wx250s", "pose", 8, seed=3) < 1.5 * GEOMETRY_RAD


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("name", "kind"),
    [*((name, "position") for name in ARMS), ("vx300s", "pose"), ("wx250s", "pose")],
)
def test_bounded_solver_follows_1000_lines_without_flips(name, kind):
    assert largest_step_on_lines(name, kind, 1000, seed=3) < 1.5 * GEOMETRY_RAD


def test_ik_tracking_out_of_reach_follows_workspace_edge():
    arm = planar(0.3, 0.2).with_limits([-0.5, 0.3], [0.8, 1.5])
    solver, q, gaps_m = Solver(arm), np.array([0.4, 0.9]), []
    for y in np.linspace(0.3, 0.6, 60):
        T = np.eye(4)
        T[:3, 3] = (0.3, y, 0.0)
        q, reached = solver.track(T, q)
        gaps_m.append(solver.result.position_error_m)
    assert not reached
    best = solve(arm, Target((0.3, 0.6, 0.0)), method="bounded")
    assert gaps_m[-1] == pytest.approx(best.position_error_m, abs=1e-9)
    assert [str(limit) for limit in solver.result.binding] == [str(limit) for limit in best.binding]


def test_ik_tracking_moves_arm_out_of_stretched_posture():
    solver, T = Solver(planar(0.3, 0.2)), np.eye(4)
    T[0, 3] = 0.4  # straight inwards, where the gradient is zero
    assert solver.track(T, [0.0, 0.0])[1]


def test_solver_tracking_stops_at_limit_of_full_turn_joint():
    arm = planar(0.3, 0.2)
    beyond = arm.forward([math.pi + 0.2, 0.5])
    q, reached = Solver(arm).track(beyond, [math.pi - 0.1, 0.5])
    assert not reached
    assert q[0] == math.pi


def test_solve_may_cross_full_turn_but_stays_inside_limits():
    arm = planar(0.3, 0.2)
    q, reached = Solver(arm)(arm.forward([-math.pi + 0.1, 0.5]), [math.pi - 0.1, 0.5])
    assert reached
    np.testing.assert_allclose(q, [-math.pi + 0.1, 0.5], atol=1e-6)


def test_bounded_solver_trace_begins_at_start_and_ends_at_result():
    chain = load_model("so101").chain
    result = solve(chain, Target((0.25, 0.05, 0.15)), chain.mid_range(), "bounded", trace=True)
    np.testing.assert_array_equal(result.trace[0], chain.mid_range())
    np.testing.assert_allclose(result.trace[-1], result.q, atol=1e-12)


def test_solver_object_gives_same_result_as_solve():
    chain = load_model("so101").chain
    T = chain.forward([0.3, -0.5, 0.7, 0.2, 1.0])
    expected = solve(chain, Target(T[:3, 3], orientation=T[:3, :3]), chain.mid_range(), "bounded")
    q, reached = Solver(chain, "pose")(T, chain.mid_range())
    assert reached
    np.testing.assert_array_equal(q, expected.q)


def test_ik_solver_writes_solution_to_out_array():
    chain, out = planar(0.3, 0.2), np.zeros(2)
    q, _ = Solver(chain)(chain.forward([0.3, 0.5]), [0.0, 0.1], out)
    assert q is out
    np.testing.assert_allclose(
        chain.forward(out)[:3, 3], chain.forward([0.3, 0.5])[:3, 3], atol=1e-6
    )


@pytest.mark.parametrize(
    ("T", "q0"),
    [
        (np.eye(3), [0, 0]),
        (np.diag([math.nan, 1, 1, 1]), [0, 0]),
        (np.diag([1.0, 1, -1, 1]), [0, 0]),
        (np.diag([2.0, 2, 2, 1]), [0, 0]),
        (np.eye(4), [0, 0, 0]),
        (np.eye(4), [0, math.inf]),
    ],
)
def test_ik_solver_refuses_invalid_pose_or_start(T, q0):
    with pytest.raises(BadValueError):
        Solver(planar(0.3, 0.2), "pose")(T, q0)


def test_unknown_ik_target_kind_error_suggests_known_kind():
    with pytest.raises(UnknownNameError, match="Did you mean pose"):
        Solver(planar(0.3, 0.2), "poses")


def test_batch_solutions_equal_single_solutions():
    model, random = load_model("so101"), np.random.default_rng(0)
    chain, home = model.chain, model.chain_pose("home")
    T = chain.forward(random.uniform(chain.lower_rad, chain.upper_rad, (600, chain.dof)))
    batch, solver = solve_batch(chain, T, home, workers=3), Solver(chain, "pose")
    np.testing.assert_array_equal(batch.q[::20], [solver(pose, home)[0] for pose in T[::20]])


def test_batch_of_points_reports_reached_and_position_errors():
    arm = planar(0.3, 0.2)
    batch = solve_batch(arm, [[0.3, 0.1, 0.0], [2.0, 0.0, 0.0]])
    assert batch.reached.tolist() == [True, False]
    assert batch.position_error_m[1] == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("targets", "q0s"),
    [
        (np.zeros((2, 2)), None),
        (np.zeros((2, 3, 3)), None),
        (np.full((2, 3), math.nan), None),
        (np.zeros((2, 4, 4)), None),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.zeros((2, 3)), [math.nan, 0.0]),
    ],
)
def test_invalid_ik_batch_is_refused(targets, q0s):
    with pytest.raises(BadValueError):
        solve_batch(planar(0.3, 0.2), targets, q0s)


def test_ik_target_copies_arrays_of_caller():
    chain = load_model("so101").chain.with_limits([0.2] * 5, [0.5] * 5)
    point_m, R = np.array([0.25, 0.05, 0.15]), np.eye(3)
    target = Target(point_m, orientation=R)
    point_m[0], R[:] = math.nan, 0.0
    result = solve(chain, target, method="bounded")
    assert (result.q >= 0.2).all()
    assert result.position_error_m > 1e-3


def test_tracking_result_is_nearest_point_of_its_trace():
    chain = load_model("px100").chain
    q0 = [3.14, -0.7484679547850437, -0.4953207087147677, -0.4964276064906111]
    target = Target((0.029513373749903996, 0.044802052564755765, 0.39496740011708964))
    result = solve(chain, target, q0, "bounded", track=True, trace=True)
    on_the_way_m = [np.linalg.norm(chain.forward(q)[:3, 3] - target.position) for q in result.trace]
    assert result.position_error_m <= min(on_the_way_m) + 1e-9


@pytest.mark.parametrize(
    ("low", "high"),
    [([-0.5, -5.2], [0.5, -1.0]), ([2.0, 3.2], [7.0, 9.0]), ([-9.0, 1.0], [9.0, 4.0])],
)
def test_joint_ranges_beyond_half_turn_are_searched_completely(low, high):
    arm, random = planar(0.3, 0.2).with_limits(low, high), np.random.default_rng(2)
    T = arm.forward(random.uniform(low, high, (500, 2)))
    assert solve_batch(arm, T[:, :3, 3]).reached.all()


def test_long_prismatic_joint_range_is_searched_completely():
    rail = joint(
        "rail", JointType.PRISMATIC, "base", "cart", axis=(1, 0, 0), lower=0.0, upper=200.0
    )
    arm = joint("arm", JointType.REVOLUTE, "cart", "hand", lower=-2.0, upper=2.0)
    tip = joint("tip", JointType.FIXED, "hand", "tip", xyz=(0.3, 0, 0))
    chain = Chain.from_joints([rail, arm, tip], "base", "tip")
    points_m = chain.forward(np.random.default_rng(3).uniform([0, -2], [200, 2], (200, 2)))[
        :, :3, 3
    ]
    assert solve_batch(chain, points_m).reached.all()


@pytest.mark.parametrize("q0", [[0.0, 1e15], [1e17, 0.0]])
def test_ik_start_of_huge_magnitude_is_refused(q0):
    arm = planar(0.3, 0.2)
    with pytest.raises(BadValueError, match=r"1e6|1e\+12"):
        Solver(arm)(arm.forward([0.1, 0.2]), q0)
    with pytest.raises(BadValueError, match=r"1e6|1e\+12"):
        solve_batch(arm, [[0.3, 0.1, 0.0]], [q0])


def test_ik_target_beyond_1_km_is_refused():
    T = np.eye(4)
    T[0, 3] = 1e10
    with pytest.raises(BadValueError, match="1 km"):
        Solver(planar(0.3, 0.2))(T, [0.0, 0.1])


@pytest.mark.parametrize(
    "out", [np.zeros(2, dtype=int), np.zeros(2, dtype=np.float32), np.zeros((1, 2)), [0.0, 0.0]]
)
def test_out_array_of_wrong_dtype_or_shape_is_refused(out):
    arm = planar(0.3, 0.2)
    with pytest.raises(BadValueError, match="out"):
        Solver(arm)(arm.forward([0.1, 0.2]), [0.0, 0.1], out)


def test_ik_solver_has_no_result_before_first_solve():
    with pytest.raises(InputError, match="no result yet"):
        _ = Solver(planar(0.3, 0.2)).result
