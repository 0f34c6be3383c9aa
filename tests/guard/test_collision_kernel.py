"""The compiled distances equal those of the plain body for all joint types and points."""

import math

import numpy as np
import pytest

from ikservo.guard import CollisionChecker, KeepOutBox
from ikservo.kernels import capsule_distances as collision_kernel
from ikservo.kinematics import Chain
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.kinematics.joints import Joint, JointType, Mimic
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from tests.guard.arms import body, model_of
from tests.kinematics.box_distance import box_distances

TURN, SLIDE, FIXED = JointType.REVOLUTE, JointType.PRISMATIC, JointType.FIXED
BOXES = [
    KeepOutBox("the cup", np.array([0.1, -0.1, 0.0]), np.array([0.2, 0.05, 0.1])),
    KeepOutBox("the wall", np.array([-0.3, -0.5, -0.1]), np.array([-0.25, 0.5, 0.4])),
]


def joint(name, kind, parent, axis, xyz=(0.0, 0.0, 0.1), rpy=(0.0, 0.0, 0.0), mimic=None):
    unit = np.array(axis, dtype=float) / math.sqrt(sum(x * x for x in axis))
    origin = make_pose(np.array(xyz), rotation_rpy(*rpy))
    return Joint(name, kind, parent, name, origin, unit, -2.0, 2.0, mimic)


def every_kind_of_joint():
    """Return an arm with one joint of every kind; its links are named after their joints."""
    joints = [
        joint("column", TURN, "base", (0.0, 0.0, 1.0)),
        joint("rail", SLIDE, "column", (1.0, 2.0, -0.5), (0.05, 0.02, 0.1), (0.1, 0.2, -0.3)),
        joint("plate", FIXED, "rail", (1.0, 0.0, 0.0), (0.1, -0.02, 0.03), (0.5, -0.4, 0.2)),
        joint("arm", TURN, "plate", (1.0, -1.0, 0.3), (0.0, 0.05, 0.1), (0.0, 0.7, 0.0)),
        joint("finger", TURN, "arm", (0.2, 1.0, 0.1), mimic=Mimic("arm", -0.7, 0.2)),
        joint("hand", TURN, "finger", (0.0, 0.3, 1.0), (0.02, 0.03, 0.08)),
    ]
    chain = Chain.from_joints(joints, "base", "hand")
    rng = np.random.default_rng(5)
    capsules = [
        Capsule(link, *rng.uniform(-0.05, 0.05, (2, 3)), radius)
        for link, radius in (("base", 0.03), ("column", 0.02), ("rail", 0.01), ("plate", 0.02),
                             ("arm", 0.01), ("arm", 0.02), ("finger", 0.015), ("hand", 0.005))
    ]  # fmt: skip
    ball = rng.uniform(-0.05, 0.05, 3)
    return CollisionBody(
        chain, [*capsules, Capsule("hand", ball, ball, 0.02)], [np.zeros(chain.dof)]
    )


def plain_gaps(body, q):
    """Return the gaps computed with numpy's arrays, by pair."""
    checks = [body.link_distances(q), body.floor_distances(q, 0.02)]
    checks += [box_distances(body, q, box.low_m, box.high_m, box.name) for box in BOXES]
    return {pair: gaps.gap_m[:, i] for gaps in checks for i, pair in enumerate(gaps.pairs)}


def compiled_gaps(body, q):
    space = CollisionChecker(body, 0.02, BOXES)
    found = space.distances(list(q))
    return {pair: found[:, i] for i, pair in enumerate(space.pairs) if found[0, i] < math.inf}


def compare(body, q):
    plain, compiled = plain_gaps(body, q), compiled_gaps(body, q)
    assert plain.keys() == compiled.keys()
    for pair, gap_m in plain.items():
        np.testing.assert_allclose(compiled[pair], gap_m, atol=1e-9, err_msg=str(pair))


def test_compiled_distances_equal_numpy_for_all_joint_kinds():
    compare(every_kind_of_joint(), np.random.default_rng(1).uniform(-2.0, 2.0, (6, 4)))


@pytest.mark.parametrize("name", ["so101", "open_manipulator_x", "planar2"])
def test_compiled_distances_equal_numpy_for_shipped_arms(name):
    chain = model_of(name).chain
    q = np.random.default_rng(2).uniform(chain.lower_rad, chain.upper_rad, (3, chain.dof))
    compare(body(name), q)


def two_sticks(a, b, c, d):
    """Return the distance of segments ab and cd, each fixed to a link of its own."""
    joints = [
        joint("one", TURN, "base", (0, 0, 1), (0, 0, 0)),
        joint("two", TURN, "one", (0, 0, 1), (0, 0, 0)),
    ]
    chain = Chain.from_joints(joints, "base", "two")
    sticks = [Capsule("base", np.array(a), np.array(b), 0.0)]
    body = CollisionBody(chain, [*sticks, Capsule("two", np.array(c), np.array(d), 0.0)])
    return float(CollisionChecker(body, None).distances([np.zeros(2)])[0, 0])


AT, X, Y = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("a", "b", "c", "d", "distance"),
    [
        (AT, X, (0.5, -1.0, 0.2), (0.5, 1.0, 0.2), 0.2),  # crossing
        (AT, X, (2.0, -1.0, 0.0), (2.0, 1.0, 0.0), 1.0),  # past the end of the first
        (AT, X, (0.5, 0.5, 0.0), (0.5, 2.0, 0.0), 0.5),  # before the start of the second
        (AT, X, (0.5, -2.0, 0.0), (0.5, -0.5, 0.0), 0.5),  # past the end of the second
        (AT, X, (2.0, 1.0, 0.0), (3.0, 2.0, 0.0), math.sqrt(2)),  # from corner to corner
        (AT, X, (-1.0, 1.0, 0.0), (-2.0, 3.0, 0.0), math.sqrt(2)),
        (AT, X, (0.2, 0.3, 0.0), (0.8, 0.3, 0.0), 0.3),  # side by side
        (AT, X, (2.0, 0.0, 0.0), (3.0, 0.0, 0.0), 1.0),  # one behind the other
        (AT, X, (3.0, 0.0, 0.0), (2.0, 0.0, 0.0), 1.0),
        (X, AT, (-1.0, 0.0, 0.0), (-2.0, 0.0, 0.0), 1.0),
        (AT, AT, (0.0, -1.0, 2.0), (0.0, 1.0, 2.0), 2.0),  # a point and a stick
        (AT, X, (0.4, 0.0, 0.7), (0.4, 0.0, 0.7), 0.7),  # a stick and a point
        (AT, X, (4.0, 4.0, 0.0), (4.0, 4.0, 0.0), 5.0),
        (X, X, Y, Y, math.sqrt(2)),  # two points
        (AT, X, (0.5, 0.0, 0.0), (0.5, 1.0, 0.0), 0.0),  # touching
    ],
)
def test_capsule_distance_equals_hand_computed_value(a, b, c, d, distance):
    assert two_sticks(a, b, c, d) == pytest.approx(distance, abs=1e-12)
    assert two_sticks(c, d, a, b) == pytest.approx(distance, abs=1e-12)
    assert two_sticks(b, a, d, c) == pytest.approx(distance, abs=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ((-1.0, 2.0, 0.5), (2.0, 2.0, 0.5), 1.0),  # along a face
        ((2.0, 0.5, 0.5), (5.0, 0.5, 0.5), 1.0),  # the near end
        ((5.0, 0.5, 0.5), (2.0, 0.5, 0.5), 1.0),
        ((-5.0, 0.5, 0.5), (-2.0, 0.5, 0.5), 2.0),
        ((0.5, 0.5, -4.0), (0.5, 0.5, -3.0), 3.0),
        ((0.5, 0.5, 0.5), (0.6, 0.6, 0.6), 0.0),  # inside
        ((-1.0, 0.3, 0.5), (0.61, 1.91, 0.5), 0.212132034356),  # past an edge
        ((1.3, -0.7, 0.5), (0.31, -0.03, 0.5), 0.03),
        ((2.0, 0.0, 0.5), (0.0, 2.0, 0.5), 0.0),  # touching an edge in one point
        ((1.7, 0.3, 0.5), (0.1, 1.9, 0.5), 0.0),
    ],
)
def test_capsule_to_box_distance_equals_hand_computed_value(a, b, distance):
    chain = Chain.from_joints([joint("one", TURN, "base", (0, 0, 1), (0, 0, 0))], "base", "one")
    stick = CollisionBody(chain, [Capsule("one", np.array(a), np.array(b), 0.0)])
    box = KeepOutBox("the die", np.zeros(3), np.ones(3))
    space = CollisionChecker(stick, None, [box])
    assert space.distances([np.zeros(1)])[0].min() == pytest.approx(distance, abs=1e-8)


def test_shape_distances_equal_dense_sampling():
    random = np.random.default_rng(3)
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    for trial in range(60):
        R = rotation_rpy(*random.uniform(-3.0, 3.0, 3))
        centre, half = random.uniform(-0.5, 0.5, 3), random.uniform(0.02, 0.4, 3)
        rounding, kind = random.uniform(0.0, 0.1), float(trial % 2)
        half[1] = half[0] if kind else half[1]
        shape = np.array([[*R.ravel(), *centre, *half, rounding, kind]])
        ends = random.uniform(-1.0, 1.0, (1, 6))
        points = (ends[0, :3] + along * (ends[0, 3:] - ends[0, :3]) - centre) @ R
        outside = np.maximum(np.abs(points) - half, 0.0)
        if kind:
            aside = np.maximum(np.hypot(points[:, 0], points[:, 1]) - half[0], 0.0)
            outside = np.column_stack([aside, outside[:, 2]])
        nearest_m = np.linalg.norm(outside, axis=1).min() - rounding
        found_m = collision_kernel.segment_shape_distance(ends, 0, shape, 0)
        assert nearest_m - 5e-7 <= found_m <= nearest_m + 1e-8
        start = collision_kernel.point_shape_distance(*ends[0, :3], shape, 0)
        assert start == pytest.approx(np.linalg.norm(outside[0]) - rounding, abs=1e-12)
