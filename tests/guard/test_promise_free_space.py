"""M5: true contact is refused, compared with an independent library's exact shapes."""

import itertools

import coal
import numpy as np
import pinocchio
import pytest

from ikservo.guard import CollisionChecker, KeepOutBox
from tests.guard.arms import body, model_of
from tests.oracle import ARMS, CONFIGS

BOX = KeepOutBox("the cup", np.array([0.12, -0.08, 0.0]), np.array([0.22, 0.02, 0.12]))


class Exact:
    """The shapes of an arm's URDF, a floor and a box, as Coal sees them."""

    def __init__(self, name):
        urdf = str(CONFIGS / name / "arm.urdf")
        self._model = pinocchio.buildModelFromUrdf(urdf)
        self._shapes = pinocchio.buildGeomFromUrdf(self._model, urdf, pinocchio.COLLISION)
        self._data, self._placed = self._model.createData(), self._shapes.createData()
        self._chain = model_of(name).chain
        size_m = BOX.high_m - BOX.low_m
        self._things = {
            "the table": (coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), coal.Transform3s()),
            "the cup": (coal.Box(*size_m), coal.Transform3s(np.eye(3), BOX.low_m + size_m / 2)),
        }

    def touching(self, q):
        """Return the pairs of names that touch."""
        configuration = pinocchio.neutral(self._model)
        for joint, value in zip(self._chain.names, q, strict=True):
            configuration[self._model.joints[self._model.getJointId(joint)].idx_q] = value
        pinocchio.updateGeometryPlacements(
            self._model, self._data, self._shapes, self._placed, configuration
        )
        parts = [
            (self._model.frames[shape.parentFrame].name, shape.geometry, _at(place))
            for shape, place in zip(self._shapes.geometryObjects, self._placed.oMg, strict=True)
        ]
        found = set()
        for (a, one, at_a), (b, other, at_b) in itertools.combinations(parts, 2):
            if a != b and _collide(one, at_a, other, at_b):
                found.add(frozenset((a, b)))
        for name, (thing, at) in self._things.items():
            found |= {frozenset((a, name)) for a, one, at_a in parts
                      if _collide(one, at_a, thing, at)}  # fmt: skip
        return found


def _at(place):
    return coal.Transform3s(place.rotation, place.translation)


def _collide(one, at_one, other, at_other):
    result = coal.CollisionResult()
    return bool(coal.collide(one, at_one, other, at_other, coal.CollisionRequest(), result))


def campaign(name, count, seed):
    """Return postures that touch, that were wrongly accepted or refused, and that are free."""
    chain, space, exact = (
        model_of(name).chain,
        CollisionChecker(body(name), 0.0, [BOX]),
        Exact(name),
    )
    columns = {frozenset(pair): i for i, pair in enumerate(space.pairs)}
    standing = {frozenset((chain.base, thing)) for thing in ("the table", "the cup")}
    margin_m = np.zeros(len(columns))
    margin_m[: len(body(name).pairs)] = body(name).pack().overlap_m
    random = np.random.default_rng(seed)
    touched = missed = refused_free = free = 0
    for q in random.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof)):
        gap_m = space.distances([q])[0]
        pairs = [columns[p] for p in exact.touching(q) - standing if p in columns]
        touched += bool(pairs)
        missed += any(gap_m[i] > margin_m[i] + 1e-9 for i in pairs)
        free += not pairs
        refused_free += not pairs and not space.collision_free(q[None])[0]
    print(  # noqa: T201  # a number to keep
        f"{name}: {count} postures, {touched} touch, {missed} missed beyond the stated margin, "
        f"{refused_free} of {free} free ones refused ({refused_free / max(free, 1):.1%})"
    )
    return touched, missed


@pytest.mark.parametrize("name", ["so101", "open_manipulator_x", "wx250s"])
def test_collision_checker_refuses_every_posture_in_contact(name):
    touched, missed = campaign(name, 120, seed=7)
    assert touched > 3
    assert missed == 0


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ARMS)
def test_collision_checker_refuses_all_contacts_in_campaign(name):
    touched, missed = campaign(name, 10_000, seed=11)
    assert touched
    assert missed == 0
