"""Compiled distances and torques equal those of the Python code, bit for bit."""

import numpy as np
import pytest

from ikservo.guard import CollisionChecker
from ikservo.guard.sag import GravitySag, Weight
from ikservo.kernels import capsule_distances as collision_kernel
from ikservo.kernels.compiled import uncompiled
from ikservo.kinematics.inertia import LinkMass
from tests.both_ways import needs_extension, run_both_ways
from tests.guard.arms import body, model_of
from tests.guard.test_collision_kernel import BOXES, every_kind_of_joint


@needs_extension
@pytest.mark.parametrize("name", ["so101", "wx250s", "every kind of joint"])
def test_compiled_distances_equal_python_distances(monkeypatch, name):
    calls = run_both_ways(monkeypatch, collision_kernel, "min_distances")
    shape = every_kind_of_joint() if name == "every kind of joint" else body(name)
    checker = CollisionChecker(shape, 0.02, BOXES)
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (8, checker.dof))
    checker.distances(q)
    assert len(calls) == 1


@needs_extension
def test_compiled_gravity_torques_equal_python_torques(monkeypatch):
    calls = run_both_ways(monkeypatch, collision_kernel, "gravity_torques_kernel")
    shape, dof = every_kind_of_joint(), 4
    masses = [LinkMass(link, 0.3, np.array([0.02, 0.01, -0.03])) for link in ("arm", "hand")]
    free = np.full(dof, np.inf)
    sag = GravitySag(shape, Weight(masses, np.ones(dof), -free, free))
    sag(np.random.default_rng(1).uniform(-2.0, 2.0, (20, dof)))
    assert len(calls) == 1


@pytest.mark.parametrize(
    ("argument", "change"),
    [
        (0, lambda a: a[:, :19]),
        (0, lambda a: np.where(a == -1.0, 3.0, a)),
        (1, lambda a: a + 99.0 * np.eye(8)[7]),
        (1, lambda a: a[:, :7]),
        (2, lambda a: a + 99.0),
        (2, lambda a: a - 1.0),
        (2, lambda a: a[:, :2]),
        (4, lambda a: a[:, :5]),
        (5, lambda a: a[:, :3]),
        (6, lambda a: a[1:]),
        (6, lambda a: a[:, :11]),
        (7, lambda a: a[1:]),
        (8, lambda a: a[:, :5]),
        (8, lambda a: a[1:]),
    ],
)
@pytest.mark.parametrize("way", ["compiled", "uncompiled"])
def test_collision_kernel_refuses_arrays_of_wrong_shape(monkeypatch, way, argument, change):
    given = []
    with monkeypatch.context() as patch:
        patch.setattr(collision_kernel, "min_distances", lambda *arguments: given.extend(arguments))
        chain = model_of("so101").chain
        CollisionChecker(body("so101"), 0.0, BOXES).distances(np.zeros((2, chain.dof)))
    given[argument] = np.ascontiguousarray(change(given[argument]), dtype=np.float64)
    run = uncompiled["min_distances"] if way == "uncompiled" else collision_kernel.min_distances
    with pytest.raises(ValueError, match="match"):
        run(*given)
