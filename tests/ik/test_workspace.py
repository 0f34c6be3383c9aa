"""The reach of the tip: compared with geometry, forward kinematics and the solver."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError
from ikservo.ik import Target, solve
from ikservo.ik.workspace import quasi_random_joints, tip_positions, workspace
from ikservo.ik.workspace_grid import boundary_polygons, front_plane, side_plane, top_plane
from tests.kinematics.chains import crane, planar

CELL_M = 0.02
HALF_DIAGONAL_M = CELL_M * math.sqrt(0.5)


def two_links(lower=(-2.618, -2.618), upper=(2.618, 2.618)):
    return planar(0.15, 0.15).with_limits(lower, upper)


def gaps_by_hand(points_m, lower, upper):
    """Return the distances of points (n, 2) from the nearest arc of the open second joint."""
    bend = np.linspace(lower[1], upper[1], 2000)
    radius_m, swing = 0.3 * np.cos(bend / 2), bend / 2
    gaps_m = []
    for x, y in points_m:
        angle = math.atan2(y, x) - swing
        off = angle - 0.5 * (lower[0] + upper[0])
        off = (off + math.pi) % (2 * math.pi) - math.pi
        off = np.sign(off) * np.maximum(np.abs(off) - 0.5 * (upper[0] - lower[0]), 0.0)
        distance_m = math.hypot(x, y)
        gap_m2 = radius_m**2 + distance_m**2 - 2 * radius_m * distance_m * np.cos(off)
        gaps_m.append(math.sqrt(max(gap_m2.min(), 0.0)))
    return np.array(gaps_m)


@pytest.fixture(scope="module")
def annulus():
    arm = two_links()
    return workspace(arm, top_plane(arm, [0.5, 1.0]), CELL_M, samples=2048)


def all_centres(region):
    cells = np.argwhere(np.ones_like(region.reachable))
    return region.grid.centres(cells), region.reachable.ravel()


def test_workspace_of_two_links_is_ring(annulus):
    arm = planar(0.15, 0.15, limit_rad=math.pi)
    arm = arm.with_limits([-math.pi, 0.8], [math.pi, 2.4])
    region = workspace(arm, top_plane(arm, [0, 1.0]), CELL_M, samples=2048)
    centres, inside = all_centres(region)
    radius_m = np.hypot(*centres.T[:2])
    nearest_m, farthest_m = (0.3 * math.cos(angle / 2) for angle in (2.4, 0.8))
    off_m = np.maximum(nearest_m - radius_m, radius_m - farthest_m)
    assert inside[off_m < 0].all()
    assert not inside[off_m > HALF_DIAGONAL_M].any()


@pytest.mark.parametrize(
    ("lower", "upper"),
    [((-2.618, -2.618), (2.618, 2.618)), ((-0.4, 0.2), (0.9, 1.3)), ((0.0, -2.0), (1.5, 0.5))],
)
def test_workspace_of_limited_joints_has_exactly_reached_cells(lower, upper):
    arm = two_links(lower, upper)
    region = workspace(arm, top_plane(arm, arm.mid_range()), CELL_M, samples=1024)
    centres, inside = all_centres(region)
    off_m = gaps_by_hand(centres[:, :2], lower, upper)
    assert inside[off_m < 0.49 * CELL_M].all()
    assert not inside[off_m > HALF_DIAGONAL_M].any()


def test_workspace_contains_every_tip_position(annulus):
    arm = two_links()
    rng = np.random.default_rng(3)
    tip_m = tip_positions(arm, rng.uniform(arm.lower_rad, arm.upper_rad, (2000, 2)))
    missed = tip_m[~annulus.contains_many(tip_m)]
    # The tip may touch the corner of a cell in passing; then the next cell is reachable.
    inward = 0.5 * CELL_M * missed / np.linalg.norm(missed, axis=1, keepdims=True)
    beside = annulus.contains_many(missed + inward) | annulus.contains_many(missed - inward)
    assert beside.all()
    assert len(missed) < 20


def test_workspace_contains_its_own_samples(annulus):
    arm = two_links()
    assert annulus.contains_many(tip_positions(arm, quasi_random_joints(arm, 2048))).all()


def test_workspace_agrees_with_solver_within_two_cells(annulus):
    arm = two_links()
    rng = np.random.default_rng(4)
    for point in rng.uniform(-0.33, 0.33, (150, 2)):
        found = solve(arm, Target((*point, 0.0)))
        if annulus.contains((*point, 0.0)):
            assert found.position_error_m < 2 * HALF_DIAGONAL_M
        if found.reached:
            assert contains_nearby(annulus, point)


def contains_nearby(region, point):
    shifts = [(0, 0), (CELL_M, 0), (-CELL_M, 0), (0, CELL_M), (0, -CELL_M)]
    return any(region.contains((point[0] + a, point[1] + b, 0.0)) for a, b in shifts)


def test_point_off_the_plane_is_not_in_workspace_slice(annulus):
    assert annulus.contains((0.2, 0.0, 0.4 * CELL_M))
    assert not annulus.contains((0.2, 0.0, 0.6 * CELL_M))


def test_point_outside_grid_is_not_in_workspace(annulus):
    assert not annulus.contains((100.0, 0.0, 0.0))


@pytest.mark.parametrize("point", [(math.nan, 0, 0), (0.1, 0.2), "abc"])
def test_workspace_refuses_invalid_point(annulus, point):
    with pytest.raises(BadValueError, match="point_m"):
        annulus.contains(point)


def test_workspace_area_is_sum_of_its_cells(annulus):
    assert annulus.size == pytest.approx(annulus.count * CELL_M**2)
    ring_m2 = math.pi * (0.3**2 - (0.3 * math.cos(2.618 / 2)) ** 2)
    assert annulus.size == pytest.approx(ring_m2, rel=0.1)


def test_workspace_extends_by_arm_length_to_either_side(annulus):
    lower, upper = annulus.extent_m
    assert upper[0] == pytest.approx(0.3, abs=CELL_M)
    assert lower[1] == pytest.approx(-0.3, abs=CELL_M)


def test_workspace_outline_has_outer_ring_and_hole(annulus):
    areas = sorted(area_of(loop) for loop in annulus.outline())
    assert len(areas) == 2
    assert areas[0] < 0 < areas[1]
    assert sum(areas) == pytest.approx(annulus.size)


def area_of(loop):
    """Return the signed area of a polygon (k, 2): positive counterclockwise."""
    following = np.roll(loop, -1, axis=0)
    return 0.5 * float((loop[:, 0] * following[:, 1] - loop[:, 1] * following[:, 0]).sum())


def test_workspace_outline_of_one_cell_is_its_four_corners():
    (loop,) = boundary_polygons(np.array([[True]]))
    np.testing.assert_array_equal(loop, [[0, 0], [1, 0], [1, 1], [0, 1]])


def test_workspace_outline_of_diagonal_cells_keeps_their_area():
    loops = boundary_polygons(np.array([[True, False], [False, True]]))
    assert sum(area_of(loop) for loop in loops) == pytest.approx(2.0)


def test_workspace_outline_of_no_cells_is_empty():
    assert boundary_polygons(np.zeros((3, 3), dtype=bool)) == ()


def test_workspace_computation_is_repeatable(annulus):
    arm = two_links()
    again = workspace(arm, top_plane(arm, [0.5, 1.0]), CELL_M, samples=2048)
    np.testing.assert_array_equal(annulus.reachable, again.reachable)


def test_quasi_random_joint_samples_cover_joint_limits():
    arm = two_links((-0.4, 0.2), (0.9, 1.3))
    q = quasi_random_joints(arm, 500)
    assert (q >= arm.lower_rad).all()
    assert (q <= arm.upper_rad).all()
    np.testing.assert_allclose(q.mean(axis=0), arm.mid_range(), atol=0.01)
    np.testing.assert_allclose(q.max(axis=0) - q.min(axis=0), [1.3, 1.1], rtol=0.02)


def test_workspace_volume_of_planar_arm_is_one_cell_thick(annulus):
    region = workspace(two_links(), cell_m=CELL_M, samples=2048)
    assert region.grid.shape[2] == 1
    assert region.count == annulus.count
    assert region.size == pytest.approx(region.count * CELL_M**3)


def test_side_workspace_slice_of_planar_arm_is_a_line():
    arm = two_links()
    region = workspace(arm, side_plane(arm, [0.0, 0.1]), CELL_M, samples=4096)
    assert region.mask().any(axis=0).sum() == 1
    assert region.contains((0.25, 0.0, 0.0))


def test_workspace_of_prismatic_joint_ends_at_its_limits():
    region = workspace(crane(), side_plane(crane(), [0.0, 0.2]), CELL_M, samples=8192)
    lower, upper = region.extent_m
    assert upper[0] == pytest.approx(0.4, abs=CELL_M)
    assert upper[1] == pytest.approx(0.4, abs=CELL_M)
    assert lower[1] == pytest.approx(0.2, abs=CELL_M)


TURNED_RAD = np.array([np.pi / 6, 0, 0, 0, 0])


def test_workspace_side_plane_follows_direction_of_arm():
    so100 = ikservo.load_model("so100")
    plane = side_plane(so100.chain, so100.chain_pose("home") + TURNED_RAD)
    np.testing.assert_allclose(plane[:3, 0], [np.cos(np.pi / 6), 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(plane[:3, 1], [0, 0, 1], atol=1e-12)


def test_workspace_side_plane_goes_through_first_axis():
    so101 = ikservo.load_model("so101")
    plane = side_plane(so101.chain, so101.chain_pose("home") + TURNED_RAD)
    across_m = plane[:3, 2] @ (np.array([0.0388353, 0, 0]) - plane[:3, 3])
    assert abs(across_m) < 1e-7
    assert np.linalg.norm(plane[:3, 3]) > 0.01  # the axis is beside the origin


def test_workspace_front_plane_is_perpendicular_to_side_plane():
    arm = ikservo.load_model("so101")
    home = arm.chain_pose("home")
    side, front = side_plane(arm.chain, home), front_plane(arm.chain, home)
    assert abs(side[:3, 0] @ front[:3, 0]) < 1e-12


def test_workspace_side_plane_is_turned_by_yaw():
    arm = ikservo.load_model("so101")
    plane = side_plane(arm.chain, arm.chain_pose("home"), yaw_rad=0.5)
    np.testing.assert_allclose(plane[:3, 0], [math.cos(0.5), math.sin(0.5), 0.0])


def test_workspace_slice_of_real_arm_agrees_with_solver():
    so101 = ikservo.load_model("so101")
    plane = side_plane(so101.chain, so101.chain_pose("home"))
    region = workspace(so101.chain, plane, 0.04)
    rng = np.random.default_rng(5)
    local = np.column_stack([rng.uniform(-0.4, 0.5, 40), rng.uniform(-0.3, 0.5, 40), np.zeros(40)])
    for point in region.grid.to_world(local):
        found = solve(so101.chain, Target(point))
        if region.contains(point):
            assert found.position_error_m < 0.04 * math.sqrt(2)
        else:
            assert not found.reached or near_edge(region, point)


def near_edge(region, point):
    shifts = 0.02 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    around = region.grid.to_world(region.grid.to_grid([point]) + shifts)
    return region.contains_many(around).any()


@pytest.mark.parametrize("cell_m", [-0.01, math.nan, math.inf])
def test_workspace_cell_size_must_be_positive_and_finite(cell_m):
    with pytest.raises(BadValueError, match="cell_m"):
        workspace(two_links(), cell_m=cell_m, samples=16)


def test_empty_workspace_has_no_extent_and_no_outline():
    region = workspace(two_links(), top_plane(two_links(), [0, 0], 0.5), CELL_M, samples=16)
    assert region.count == 0
    assert region.extent_m is None
    assert region.outline() == ()


def test_workspace_with_too_many_cells_is_refused():
    with pytest.raises(BadValueError, match="larger cells"):
        workspace(two_links(), top_plane(two_links(), [0, 0]), 1e-6, samples=16)
