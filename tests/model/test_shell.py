"""The capsules cover the shapes, and contacts are found, compared with Pinocchio's shapes."""

import itertools

import coal
import numpy as np
import pinocchio
import pytest

from ikservo.kinematics.collision_body import CollisionBody
from ikservo.model import load_model
from ikservo.model.collision_capsules import bounding_capsules, collision_body
from ikservo.model.urdf_types import Box, Cylinder, Sphere
from tests.kinematics.box_distance import box_distances
from tests.oracle import ARMS, CONFIGS

SHAPES = [
    Box((0.10, 0.09, 0.026), (0.01, 0, 0.02), (0.1, 0.2, 0.3)),
    Box((0.02, 0.02, 0.02), (0, 0, 0), (0, 0, 0)),
    Box((0.3, 0.001, 0.05), (0, 0.1, 0), (1.5, 0, 0)),
    Cylinder(0.02, 0.1, (0, 0, 0.05), (0, 1.57, 0)),
    Sphere(0.03, (0.1, 0, 0), (0, 0, 0)),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_collision_capsules_contain_every_point_of_shape(shape):
    capsules = bounding_capsules("link", shape)
    for point in _surface(shape):
        depths = [_distance(point, c.start_m, c.end_m) - c.radius_m for c in capsules]
        assert min(depths) <= 1e-9


@pytest.mark.parametrize("name", ARMS)
def test_every_unconnected_link_pair_is_collision_checked(name):
    model = load_model(name)
    with_shape = [link.name for link in model.urdf.links if link.collisions]
    carriers = {joint.child: joint.parent for joint in model.urdf.joints}
    joined = {frozenset(pair) for pair in carriers.items()}
    pairs = {frozenset(pair) for pair in itertools.combinations(with_shape, 2)}
    assert {frozenset(pair) for pair in collision_body(model).pairs} >= pairs - joined - _welded(
        model
    )


def test_link_pair_overlapping_in_rest_pose_is_no_contact_there():
    model = load_model("wx250s")
    rest = model.chain_pose("rest")
    assert collision_body(model).link_distances([rest]).gap_m.min() >= 0
    bare = CollisionBody(model.chain, [c for link in model.urdf.links for shape in link.collisions
                              for c in bounding_capsules(link.name, shape)])  # fmt: skip
    assert bare.link_distances([rest]).gap_m.min() < 0


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["so101", "open_manipulator_x", "wx250s"])
def test_collision_capsules_find_every_exact_contact(name):
    model = load_model(name)
    body, random = collision_body(model), np.random.default_rng(3)
    exact = pinocchio.buildModelFromUrdf(str(CONFIGS / name / "arm.urdf"))
    shapes = pinocchio.buildGeomFromUrdf(
        exact, str(CONFIGS / name / "arm.urdf"), pinocchio.COLLISION
    )
    watched = {frozenset(pair) for pair in body.pairs}
    touching = 0
    for _ in range(150):
        q = random.uniform(model.chain.lower_rad, model.chain.upper_rad)
        pairs = _touching(exact, shapes, model.chain, q) & watched
        touching += bool(pairs)
        assert not pairs or body.link_distances([q]).gap_m.min() <= 1e-9
    assert touching > 3


@pytest.mark.parametrize("name", ARMS)
def test_no_link_is_below_table_in_rest_pose(name):
    model = load_model(name)
    above = collision_body(model).floor_distances([model.chain_pose("rest")], model.floor_m)
    assert {other for _, other in above.pairs} == {"the table"}
    assert above.gap_m.min() > 0


def test_nearest_pair_in_contact_names_link_and_box():
    model = load_model("so101")
    tip_m = model.chain.forward(model.chain_pose("home"))[:3, 3]
    home = [model.chain_pose("home")]
    near = box_distances(collision_body(model), home, tip_m - 0.01, tip_m + 0.01, "the cup")
    link, other = near.pairs[int(near.gap_m[0].argmin())]
    assert (link in ("gripper", "jaw"), other) == (True, "the cup")
    assert near.gap_m.min() <= 0


def _welded(model):
    """Return the pairs of links with fewer than two moving joints between them."""
    ways = {link.name: {j.name for j in model.urdf.joints_to(link.name) if j.kind.is_movable}
            for link in model.urdf.links}  # fmt: skip
    return {frozenset(pair) for pair in itertools.combinations(ways, 2)
            if len(ways[pair[0]] ^ ways[pair[1]]) <= 1}  # fmt: skip


def _touching(model, shapes, chain, q):
    configuration = pinocchio.neutral(model)
    for joint, value in zip(chain.names, q, strict=True):
        configuration[model.joints[model.getJointId(joint)].idx_q] = value
    data, placed = model.createData(), shapes.createData()
    pinocchio.updateGeometryPlacements(model, data, shapes, placed, configuration)
    objects = list(shapes.geometryObjects)
    found = set()
    for i, a in enumerate(objects):
        for j, b in enumerate(objects[:i]):
            links = frozenset(model.frames[o.parentFrame].name for o in (a, b))
            if len(links) == 2 and _collide(a, placed.oMg[i], b, placed.oMg[j]):
                found.add(links)
    return found


def _collide(a, placed_a, b, placed_b):
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    at_a = coal.Transform3s(placed_a.rotation, placed_a.translation)
    at_b = coal.Transform3s(placed_b.rotation, placed_b.translation)
    return bool(coal.collide(a.geometry, at_a, b.geometry, at_b, request, result))


def _surface(shape):
    from ikservo.kinematics.se3 import rotation_rpy

    R, centre = rotation_rpy(*shape.rpy_rad), np.array(shape.xyz_m)
    directions = np.random.default_rng(1).normal(size=(400, 3))
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    if isinstance(shape, Box):
        points = directions * np.array(shape.size_m) / 2
    elif isinstance(shape, Sphere):
        points = directions / np.linalg.norm(directions, axis=1, keepdims=True) * shape.radius_m
    else:
        flat = np.linalg.norm(directions[:, :2], axis=1, keepdims=True).clip(1e-9)
        ring = directions[:, :2] / np.maximum(flat, 1) * shape.radius_m
        points = np.column_stack([ring, directions[:, 2] * shape.length_m / 2])
    return points @ R.T + centre


def _distance(point, a, b):
    d = b - a
    t = np.clip((point - a) @ d / max(d @ d, 1e-18), 0, 1)
    return np.linalg.norm(point - a - t * d)
