"""The path of the body is checked for collisions before anything moves."""

import contextlib
import itertools
import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, RefusedError
from ikservo.guard import CollisionChecker, KeepOutBox
from ikservo.kinematics import Chain
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.joints import Joint, JointType
from ikservo.kinematics.se3 import make_pose
from tests.guard.arms import body, model_of
from tests.oracle import ARMS

SO101 = model_of("so101")
BODY = body("so101")
HOME = SO101.chain_pose("home")


def straight(start, goal):
    return [start + share * (goal - start) for share in np.linspace(0, 1, 40)]


@pytest.mark.parametrize("name", ARMS)
def test_collision_checker_accepts_paths_between_named_poses(name):
    model, space = model_of(name), CollisionChecker(body(name))
    poses = [model.chain_pose(pose) for pose in ("rest", "home", "zero", "rest")]
    for start, goal in itertools.pairwise(poses):
        space.check_path(straight(start, goal))


def test_collision_checker_dof_equals_number_of_arm_joints():
    assert CollisionChecker(BODY).dof == len(HOME)


def test_collision_error_names_link_table_and_position():
    below = HOME + np.array([0, 0.8, 0, 0, 0])
    with pytest.raises(RefusedError, match=r"\w+ would touch the table: .* at the goal"):
        CollisionChecker(BODY).check_path(straight(HOME, below))


def test_collision_checker_accepts_low_goal_with_lower_floor():
    below = HOME + np.array([0, 0.8, 0, 0, 0])
    CollisionChecker(BODY, floor_m=-1.0).check_path(straight(HOME, below))


def test_collision_checker_finds_obstacle_between_free_ends():
    middle_m = SO101.chain.forward(HOME)[:3, 3]
    left, right = HOME.copy(), HOME.copy()
    left[0], right[0] = -1.2, 1.2
    cup = KeepOutBox("the cup", middle_m - 0.02, middle_m + 0.02)
    with pytest.raises(RefusedError, match="would touch the cup"):
        CollisionChecker(BODY, boxes=[cup]).check_path(straight(left, right))
    CollisionChecker(BODY).check_path(straight(left, right))


def test_collision_checker_lets_arm_leave_box_it_touches():
    tip_m = SO101.chain.forward(HOME)[:3, 3]
    lid = KeepOutBox("the lid", tip_m - 0.005, tip_m + 0.005)
    away = HOME - np.array([0, 0.3, 0, 0, 0])
    CollisionChecker(BODY, boxes=[lid]).check_path(straight(HOME, away))


def test_arm_in_table_contact_may_rise_but_not_sink_deeper():
    sunk = HOME + np.array([0, 0.8, 0, 0, 0])
    CollisionChecker(BODY).check_path(straight(sunk, HOME))
    with pytest.raises(RefusedError, match="would touch the table"):
        CollisionChecker(BODY).check_path(straight(sunk, sunk + np.array([0, 0.1, 0, 0, 0])))


def test_collision_checker_refuses_second_contact_of_path():
    sunk = HOME + np.array([0, 0.8, 0, 0, 0])
    with pytest.raises(RefusedError, match="would touch the table"):
        CollisionChecker(BODY).check_path([*straight(sunk, HOME), *straight(HOME, sunk)])


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ((0, 0, 0), (0, 1, 1)),
        ((0, 0, 0), (1, 1, -1)),
        ((0, 0, math.nan), (1, 1, 1)),
        ((0, 0, 0), (1, 1, math.inf)),
        ((-math.inf, 0, 0), (1, 1, 1)),
    ],
)
def test_keep_out_box_without_volume_is_refused(low, high):
    with pytest.raises(BadValueError, match="the cup"):
        KeepOutBox("the cup", np.array(low), np.array(high))


# --- one posture, and ways of two, as a stream looks at them


def ball_on_a_rail(radius_m=0.1, postures=()):
    """Return a ball that slides vertically above its base, with another ball on an arm."""
    axis = np.array([0.0, 0.0, 1.0])
    side = np.array([1.0, 0.0, 0.0])
    joints = [
        Joint("lift", JointType.PRISMATIC, "base", "lift", make_pose(np.zeros(3)), axis, -9.0, 9.0),
        Joint(
            "reach", JointType.PRISMATIC, "lift", "reach", make_pose(np.zeros(3)), side, -9.0, 9.0
        ),
    ]
    here = np.zeros(3)
    balls = [Capsule(link, here, here, radius_m) for link in ("base", "lift", "reach")]
    return CollisionBody(Chain.from_joints(joints, "base", "reach"), balls, postures)


def space_of_balls(**kwargs):
    return CollisionChecker(ball_on_a_rail(), **kwargs)


def deepest_contact(space, *q):
    """Return the deepest contact in a posture, with its depth; empty in a free one."""
    if space.collision_free(np.array([q]))[0]:
        return ""
    (gap_m,) = space.distances(np.array([q]))
    pair = int(np.argmin(gap_m))
    return f"{'-'.join(space.pairs[pair])}, {-gap_m[pair] * 1e3:.1f} mm"


@pytest.mark.parametrize("height_m", [0.1001, 0.5])
def test_posture_above_floor_has_no_contact(height_m):
    assert deepest_contact(space_of_balls(), height_m, 1.0) == ""


def test_deepest_contact_names_pair_and_depth():
    assert deepest_contact(space_of_balls(), 0.08, 1.0) == "lift-the table, 20.0 mm"


def test_collision_refusal_hint_suggests_another_pose():
    with pytest.raises(RefusedError, match="lift would touch the table") as caught:
        space_of_balls().check_path([np.array([0.5, 1.0]), np.array([0.08, 1.0])])
    assert "another pose" in caught.value.command_hint
    assert "collisions=False" not in caught.value.hint


def test_base_link_below_floor_is_not_a_collision():
    space = space_of_balls(floor_m=0.05)  # the base's ball is 5 cm deep
    assert deepest_contact(space, 1.0, 1.0) == ""


def test_raised_floor_is_in_contact_at_greater_height():
    assert deepest_contact(space_of_balls(floor_m=0.25), 0.3, 1.0) == "lift-the table, 50.0 mm"


def test_collision_error_names_both_links():
    assert deepest_contact(space_of_balls(floor_m=None), 0.15, 0.0) == "base-reach, 50.0 mm"


@pytest.mark.parametrize("depth_m", [0.0, 0.9e-9])
def test_posture_touching_at_zero_depth_is_collision_free(depth_m):
    space, q = space_of_balls(), np.array([0.1 - depth_m, 1.0])
    assert deepest_contact(space, *q) == ""
    space.check_path([np.array([0.5, 1.0]), q])


def test_contact_deeper_than_1_nm_is_refused():
    space, q = space_of_balls(), np.array([0.1 - 1.1e-9, 1.0])
    assert deepest_contact(space, *q) == "lift-the table, 0.0 mm"
    with pytest.raises(RefusedError, match="the table"):
        space.check_path([np.array([0.5, 1.0]), q])


def test_contact_with_several_boxes_names_the_right_box():
    cups = [
        KeepOutBox("the cup", np.array([0.5, -0.1, 0.5]), np.array([0.7, 0.1, 0.7])),
        KeepOutBox("the jug", np.array([1.5, -0.1, 0.5]), np.array([1.7, 0.1, 0.7])),
    ]
    space = space_of_balls(boxes=cups)
    assert deepest_contact(space, 0.6, 1.1) == ""
    for reach_m, name in ((0.75, "cup"), (1.45, "jug")):
        assert deepest_contact(space, 0.6, reach_m) == f"reach-the {name}, 50.0 mm"


def test_path_of_two_samples_with_contact_at_goal_is_refused():
    with pytest.raises(RefusedError, match=r"the table: 10\.0 mm inside it at the goal"):
        space_of_balls().check_path([np.array([0.5, 1.0]), np.array([0.09, 1.0])])


@pytest.mark.parametrize(
    ("heights_m", "refused"),
    [
        ((0.05,), False),
        ((0.06,), False),
        ((0.0496, 0.05), False),
        ((0.0494, 0.05), True),
        ((0.0499,), True),  # many motions of a tenth of a millimetre would add up
        ((0.02, 0.06), True),
    ],
)
def test_arm_in_floor_contact_may_stay_or_rise_but_not_sink(heights_m, refused):
    way = [np.array([height_m, 1.0]) for height_m in (0.05, *heights_m)]
    if refused:
        with pytest.raises(RefusedError, match="the table"):
            space_of_balls().check_path(way)
    else:
        space_of_balls().check_path(way)


def sink_by_checks(height_m, checks, **kwargs):
    """Return the height of a ball after checked paths, each followed to its deepest point."""
    space = space_of_balls()
    for _ in range(checks):
        lower_m = height_m - 0.0004
        with contextlib.suppress(RefusedError):
            space.check_path([np.array([z, 1.0]) for z in (height_m, lower_m, 0.06)], **kwargs)
            height_m = lower_m
    return height_m


def test_retargeted_paths_in_contact_sink_less_than_0_5_mm():
    assert sink_by_checks(0.05, 50) < 0.04
    assert sink_by_checks(0.05, 50, rest=np.array([0.05, 1.0])) >= 0.0495


def test_contact_depth_does_not_grow_over_stopped_paths():
    began_m = np.minimum(space_of_balls().distances([np.array([0.05, 1.0])])[0], 0.0)
    assert sink_by_checks(0.05, 50, began_m=began_m) >= 0.0495
    unknown_m = np.full(len(began_m), -np.inf)
    assert sink_by_checks(0.05, 50, began_m=unknown_m) < 0.04


def test_path_in_contact_may_not_sink_below_rest_position():
    way = [np.array([height_m, 1.0]) for height_m in (0.0497, 0.0497)]
    space_of_balls().check_path(way)
    with pytest.raises(RefusedError, match="the table"):
        space_of_balls().check_path(way, rest=np.array([0.05, 1.0]))


def test_fifty_paths_in_contact_sink_less_than_50_um_in_total():
    height_m, dice, space = 0.05, np.random.default_rng(5), space_of_balls()
    for _ in range(50):
        for end_m in height_m + dice.uniform(-6e-4, 1e-4, 20):
            with contextlib.suppress(RefusedError):
                space.check_path([np.array([z, 1.0]) for z in (height_m, end_m)])
                height_m = min(height_m, end_m)
    assert height_m >= 0.05 - 50 * 1e-6


def test_check_path_returns_smallest_distance_on_path():
    heights = [0.5, 0.2, 0.4]
    nearest_m = space_of_balls().check_path([np.array([z, 1.0]) for z in heights])
    assert nearest_m == pytest.approx(0.1)


def test_collision_error_names_depth_and_place_of_contact():
    heights = [0.5, 0.4, 0.08, 0.05, 0.5]
    with pytest.raises(RefusedError, match=r"lift would touch the table: 50\.0 mm deep, at 75 %"):
        space_of_balls().check_path([np.array([z, 1.0]) for z in heights])


def test_collision_error_names_first_contact_on_path():
    cup = KeepOutBox("the cup", np.array([0.5, -0.1, 0.5]), np.array([0.7, 0.1, 0.7]))
    way = [(0.6, 2.0), (0.6, 0.75), (0.02, 0.75), (0.6, 2.0), (0.6, 2.0)]
    with pytest.raises(RefusedError, match=r"reach would touch the cup: 50\.0 mm deep, at 25 %"):
        space_of_balls(boxes=[cup]).check_path([np.array(q) for q in way])


@pytest.mark.parametrize(
    ("heights", "refused"),
    [
        ((-1e-9,), False),
        ((0.5, -1e-9, 0.5), False),
        ((0.0, -1e-9), False),
        ((0.5, -1.1e-9, 0.5), True),
        ((-1e-9, -1.5e-9, 0.5), True),
        ((0.5e-9, -1.5e-9, 0.5), True),
        ((-2e-9, -1.5e-9, 0.5), False),
    ],
)
def test_path_overlap_up_to_1_nanometre_is_no_collision(heights, refused):
    points = CollisionChecker(ball_on_a_rail(radius_m=0.0))
    way = [np.array([height_m, 1.0]) for height_m in heights]
    if refused:
        with pytest.raises(RefusedError, match="the table"):
            points.check_path(way)
    else:
        points.check_path(way)


def test_penetration_of_1_nanometre_is_not_a_collision():
    points = CollisionChecker(ball_on_a_rail(radius_m=0.0))
    assert deepest_contact(points, -1e-9, 1.0) == ""


def test_path_that_stays_in_one_contact_posture_is_accepted():
    space_of_balls().check_path([np.array([0.05, 1.0])])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_posture_with_nan_or_infinity_is_refused(bad):
    space = space_of_balls()
    with pytest.raises(BadValueError):
        space.collision_free(np.array([[0.5, bad]]))
    with pytest.raises(BadValueError):
        space.check_path([np.array([0.5, 1.0]), np.array([0.5, bad])])


def test_posture_with_wrong_number_of_joints_is_refused():
    with pytest.raises(BadValueError, match="shape"):
        space_of_balls().collision_free(np.array([[0.5, 1.0, 2.0]]))


def test_overlap_of_known_free_posture_plus_4_mm_is_allowed():
    body = ball_on_a_rail(postures=[np.array([0.15, 0.0])])
    space = CollisionChecker(body, None)
    assert deepest_contact(space, 0.1461, 0.0) == ""  # and 4 mm more
    assert deepest_contact(space, 0.145, 0.0).startswith("base-reach")


# --- between two looks, and under the arm's own weight


def plate(at_m, thick_m=0.002):
    """Return a plate across the path of the ball, above its rail."""
    low = np.array([at_m - thick_m / 2, -0.2, 0.4])
    return KeepOutBox("the plate", low, low + np.array([thick_m, 0.4, 0.4]))


def test_thin_plate_between_two_path_samples_is_found():
    space = space_of_balls(boxes=[plate(1.5)])
    for at_m in (1.37, 1.63):  # the ball's radius is 0.1 m: it is free on both sides
        assert deepest_contact(space, 0.6, at_m) == ""
    with pytest.raises(RefusedError, match="reach would touch the plate"):
        space.check_path([np.array([0.6, 1.37]), np.array([0.6, 1.63])])


def test_path_0_5_mm_beside_thin_plate_is_free():
    space = space_of_balls(boxes=[plate(1.5)])
    lift = [np.array([z, 1.5]) for z in (0.9005, 1.2, 0.9005)]
    space.check_path(lift)
    space.check_path([np.array([0.902, 1.0]), np.array([0.902, 2.0])])


def test_plate_of_2_mm_in_path_of_arm_is_always_found():
    middle_m = SO101.chain.forward(HOME)[:3, 3]
    left, right = HOME.copy(), HOME.copy()
    left[0], right[0] = -0.6, 0.6
    for y_m in np.linspace(-0.04, 0.04, 9):
        low = np.array([middle_m[0] - 0.01, y_m - 0.001, 0.0])
        thin = KeepOutBox("the plate", low, low + np.array([0.02, 0.002, 0.3]))
        with pytest.raises(RefusedError, match="the plate"):
            CollisionChecker(BODY, boxes=[thin]).check_path(np.linspace(left, right, 4))


def test_collision_distance_changes_at_most_step_times_reach():
    random = np.random.default_rng(5)
    for name in ("so101", "open_manipulator_x", "wx250s"):
        packed, space, chain = body(name).pack(), CollisionChecker(body(name)), model_of(name).chain
        reach_m = np.vstack([packed.pair_reach_m, packed.reach_m])
        for q in random.uniform(chain.lower_rad, chain.upper_rad, (40, chain.dof)):
            step = random.uniform(-0.1, 0.1, chain.dof)
            before, after = space.distances([q, q + step])
            seen = np.isfinite(before)
            changed_m, most_m = np.abs(after[seen] - before[seen]), (reach_m @ np.abs(step))[seen]
            assert (changed_m <= most_m + 1e-9).all()


def test_collision_checker_refuses_path_that_sags_into_floor():
    sagging = CollisionChecker(
        ball_on_a_rail(), sag=lambda q: np.broadcast_to([-0.03, 0.0], q.shape)
    )
    way = [np.array([0.5, 1.0]), np.array([0.12, 1.0])]
    space_of_balls().check_path(way)
    with pytest.raises(RefusedError, match=r"lift would touch the table: 10\.0 mm"):
        sagging.check_path(way)


def test_collision_checker_lets_arm_sagged_on_floor_rise():
    sagging = CollisionChecker(
        ball_on_a_rail(), sag=lambda q: np.broadcast_to([-0.03, 0.0], q.shape)
    )
    sagging.check_path([np.array([0.12, 1.0]), np.array([0.5, 1.0])])
