"""A path is sampled more finely between two samples if a collision is possible there."""

import numpy as np
import pytest

from ikservo.errors import CollisionError, RefusedError
from ikservo.guard import CollisionChecker, KeepOutBox
from ikservo.kinematics import Chain, Joint, JointType
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.scene_file import KeepOutShape
from tests.guard.arms import body, model_of

BALL_RADIUS_M = 0.1


def slider(radius_m=BALL_RADIUS_M):
    """Return the body of a ball that slides along x, half a metre above the table."""
    origin = make_pose(np.array([0.0, 0.0, 0.5]))
    along_x = np.array([1.0, 0.0, 0.0])
    joint = Joint("reach", JointType.PRISMATIC, "base", "ball", origin, along_x, -9.0, 9.0)
    capsule = Capsule("ball", np.zeros(3), np.zeros(3), radius_m)
    return CollisionBody(Chain.from_joints([joint], "base", "ball"), [capsule])


def plate(middle_m, thickness_m=0.002, name="the plate"):
    half_m = np.array([thickness_m / 2, 0.2, 0.2])
    centre_m = np.array([middle_m, 0.0, 0.5])
    return KeepOutBox(name, centre_m - half_m, centre_m + half_m)


def check(path_m, *boxes):
    CollisionChecker(slider(), boxes=boxes).check_path([np.array([x]) for x in path_m])


@pytest.mark.parametrize(
    ("path_m", "percent"),
    [
        ([1.37, 1.63], 50),  # the middle of the plate is the first sample between both ends
        ([0.9, 3.3], 25),  # the second, after 2.1 m was free
        ([3.3, 0.9], 75),
        ([0.5, 0.9, 3.3, 3.5], 42),  # a quarter of the second interval of three
        ([3.5, 3.3, 0.9, 0.5], 58),
    ],
)
def test_reported_contact_position_is_of_refined_sample(path_m, percent):
    with pytest.raises(RefusedError, match=rf"touch the plate: 100\.0 mm deep, at {percent} %"):
        check(path_m, plate(1.5))


def test_collision_error_names_first_plate_between_samples():
    with pytest.raises(RefusedError, match="the near plate"):
        check([0.5, 4.5], plate(1.5, name="the near plate"), plate(3.5, name="the far plate"))


def test_collision_error_names_nearer_plate_in_any_order():
    with pytest.raises(RefusedError, match="the near plate"):
        check([0.5, 4.5], plate(2.5, name="the far plate"), plate(1.5, name="the near plate"))


def test_path_beside_plate_is_collision_free_both_ways():
    for path_m in ([0.5, 1.39], [1.39, 0.5], [1.61, 2.5], [2.5, 1.61], [0.5, 1.39, 0.5]):
        check(path_m, plate(1.5))


def test_link_may_leave_plate_that_it_touches():
    check([1.55, 2.5], plate(1.5))
    with pytest.raises(RefusedError, match="the far plate"):
        check([1.55, 4.5], plate(1.5), plate(3.5, name="the far plate"))


@pytest.mark.parametrize("path_m", [[1.45, 2.5], [1.45, 1.5, 2.5], [1.45, 1.5, 1.45]])
def test_body_inside_plate_may_not_leave_on_other_side(path_m):
    with pytest.raises(RefusedError, match="ball would touch the plate"):
        check(path_m, plate(1.5))


def test_thin_plate_is_found_at_any_sample_spacing():
    for end_m in np.linspace(2.0, 8.5, 27):
        with pytest.raises(RefusedError, match="the plate"):
            check([0.0, end_m], plate(1.5))


def test_body_that_left_plate_may_not_pass_through_it():
    checker = CollisionChecker(slider(), floor_m=None, boxes=[plate(1.5)])
    checker.check_path([np.array([x]) for x in (1.45, 0.9, 0.5)])
    with pytest.raises(RefusedError, match="ball would touch the plate"):
        checker.check_path([np.array([x]) for x in (1.45, 0.9, 3.3)])


def test_body_touching_plate_may_not_pass_through_it():
    against_m = 1.5 - 0.001 - BALL_RADIUS_M
    with pytest.raises(RefusedError, match="ball would touch the plate"):
        check([against_m, 2.5], plate(1.5))


@pytest.mark.parametrize(("apart_m", "refused"), [(0.00201, True), (0.00199, False)])
def test_contact_deeper_than_1_mm_between_samples_is_found(apart_m, refused):
    # the ball is free at both samples; between them it is as deep in the sheet as its radius
    path = [np.array([1.5 - apart_m / 2]), np.array([1.5 + apart_m / 2])]
    checker = CollisionChecker(slider(apart_m / 2 - 1e-6), boxes=[plate(1.5, thickness_m=1e-6)])
    if refused:
        with pytest.raises(RefusedError, match=r"touch the plate: 1\.0 mm deep, at 50 %"):
            checker.check_path(path)
    else:
        checker.check_path(path)


def test_path_far_from_obstacles_is_not_refined():
    looked_at = []

    def sag(q):
        looked_at.append(len(q))
        return np.zeros_like(q)

    checker = CollisionChecker(slider(), boxes=[plate(1.5)], sag=sag)
    checker.check_path([np.array([x]) for x in (5.0, 5.1, 5.2)])
    assert looked_at == [3]


@pytest.mark.parametrize("seed", range(6))
def test_plate_of_1_mm_is_found_between_two_path_samples(seed):
    """A plate anywhere in the sweep of the gripper; the path has only its two ends."""
    chain, random = model_of("so101").chain, np.random.default_rng(seed)
    start, goal = np.zeros(chain.dof), np.zeros(chain.dof)
    start[0], goal[0] = -1.2, 1.2
    on_way = start + random.uniform(0.2, 0.8) * (goal - start)
    T = chain.forward(on_way)
    half = np.array([0.02, 0.0005, 0.02])
    turn = rotation_rpy(0.0, 0.0, on_way[0] + random.uniform(-0.5, 0.5))
    thing = KeepOutShape("the plate", np.array([*turn.ravel(), *T[:3, 3], *half, 0.0, 0.0]))
    checker = CollisionChecker(body("so101"), None, [thing])
    ends_m = checker.distances([start, goal]).min()
    assert ends_m > 0.01
    with pytest.raises(CollisionError, match="the plate"):
        checker.check_path([start, goal])
    assert not checker.clear_space(0.0, load=0.0).is_free(np.array([start, goal]))
