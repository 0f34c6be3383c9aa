"""Free motions keep their clearance everywhere, however thin an obstacle is."""

from dataclasses import replace

import numpy as np
import pytest

from ikservo.arm.opening import make_collision_checker
from ikservo.guard import CollisionChecker, KeepOutBox, clear_space
from ikservo.kernels import compiled
from ikservo.kernels import free_path as free_path_kernel
from ikservo.kinematics.se3 import rotation_rpy
from tests.guard.arms import body, model_of
from tests.guard.test_collision_kernel import BOXES, every_kind_of_joint


class Turned:
    """A box or a cylinder with a random orientation."""

    def __init__(self, random, name, size_m=0.04):
        R, half = rotation_rpy(*random.uniform(-3.0, 3.0, 3)), random.uniform(0.2, 1.0, 3) * size_m
        centre = random.uniform((-0.3, -0.3, 0.0), (0.4, 0.3, 0.4))
        self.name = name
        self.row = np.array([*R.ravel(), *centre, *half, 0.002, float(random.random() < 0.5)])


def things_around(seed, count=5):
    random = np.random.default_rng(seed)
    return [Turned(random, f"thing {i}") for i in range(count)]


def checker_of(name, things):
    return make_collision_checker(replace(model_of(name), keep_out=things))


@pytest.mark.parametrize("name", ["so101", "wx250s", "every kind of joint"])
def test_free_space_test_agrees_with_collision_distances(name):
    shape = every_kind_of_joint() if name == "every kind of joint" else body(name)
    checker = CollisionChecker(shape, 0.02, [*BOXES, *things_around(4)])
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (400, checker.dof))
    far = checker.distances(q).min(axis=1) >= -1e-9
    np.testing.assert_array_equal(checker.collision_free(q), far)
    assert 0.02 < far.mean() < 0.98
    space = checker.clear_space(0.01)
    np.testing.assert_array_equal(space.contains(q), checker.distances(q).min(axis=1) >= 0.01)


@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x"])
def test_free_space_test_keeps_distance_of_sagging_arm(name):
    checker = checker_of(name, things_around(5))
    q = np.random.default_rng(2).uniform(-1.5, 1.5, (300, checker.dof))
    space = checker.clear_space(0.004, load=1.7)
    near_m = checker.distances_with_sag(q, 1.7).min(axis=1)
    np.testing.assert_array_equal(space.contains(q), near_m >= 0.004 - 1e-9)


@pytest.mark.parametrize("name", ["so101", "wx250s"])
def test_free_space_motion_keeps_distance_between_samples(name):
    random, checker = np.random.default_rng(3), checker_of(name, things_around(6))
    space, free = checker.clear_space(0.005, load=0.0), 0
    for _ in range(24):
        start, goal = random.uniform(-1.2, 1.2, (2, checker.dof))
        near_m = checker.distances(np.linspace(start, goal, 400)).min()
        found = space.is_free(np.array([start, goal]))
        free += found
        assert near_m >= 0.004 - 1e-9 if found else near_m < 0.0051
    assert 2 <= free <= 22


def droop(q):
    """Turn the second and the third joint by their possible sag."""
    bent = q.copy()
    bent[:, 1] += 0.1 * np.sin(q[:, 1] + q[:, 2])
    bent[:, 2] -= 0.08 * np.cos(q[:, 2])
    return bent


def test_free_space_test_keeps_distance_of_bending_arm():
    things, random = things_around(6), np.random.default_rng(4)
    checker, stiff = (CollisionChecker(body("so101"), None, things) for _ in range(2))
    checker.bends = droop
    q = random.uniform(-1.5, 1.5, (300, checker.dof))
    space, rigid, free = checker.clear_space(0.005), stiff.clear_space(0.005), 0
    kept = checker.distances(q).min(axis=1) >= 0.005
    np.testing.assert_array_equal(space.contains(q), kept)
    assert (rigid.contains(q) != kept).any()
    pairs = 80 if compiled.is_compiled() else 16
    for start, goal in q[: 2 * pairs].reshape(pairs, 2, -1):
        near_m = checker.distances(np.linspace(start, goal, 400)).min()
        found = space.is_free(np.array([start, goal]))
        free += found
        assert near_m >= 0.0039 if found else near_m < 0.0052
    assert 2 <= free <= pairs - 4


def test_free_space_test_finds_plate_of_1_um_thickness():
    chain = model_of("so101").chain
    start, goal = np.zeros(chain.dof), np.zeros(chain.dof)
    start[0], goal[0] = -1.0, 1.0
    tip_m = chain.forward(np.zeros(chain.dof))[:3, 3]
    for thick_m in (1e-2, 1e-4, 1e-6):
        low_m = tip_m + np.array([-0.01, 0.03, -0.01])
        plate = KeepOutBox("the plate", low_m, low_m + np.array([0.01, thick_m, 0.01]))
        checker = CollisionChecker(body("so101"), None, [plate])
        space = checker.clear_space(0.002, np.array([start, goal]))
        assert not space.is_free(np.array([start, goal]))
        assert any(space.is_free(np.array([end, 0.3 * end])) for end in (start, goal))


def test_free_space_test_accepts_path_ends_close_to_contact():
    checker = CollisionChecker(body("so101"), None, BOXES)
    q = np.random.default_rng(7).uniform(-1.2, 1.2, (400, checker.dof))
    near_m = checker.distances(q).min(axis=1)
    near = q[np.flatnonzero((near_m > 0.001) & (near_m < 0.02))[0]][None]
    assert not checker.clear_space(0.02).contains(near)[0]
    assert checker.clear_space(0.02, near).contains(near)[0]
    touching = q[np.flatnonzero(near_m < -0.001)[0]][None]
    assert not checker.clear_space(0.02, touching).contains(touching)[0]


@pytest.mark.skipif(not compiled.is_compiled(), reason="no C compiler")
@pytest.mark.parametrize("kernel", ["first_contact", "free_postures"])
def test_compiled_free_space_test_equals_python_code(monkeypatch, kernel):
    pairs = []

    def bind(name, *arguments):
        copies = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]

        def both(*others):
            found = compiled.bind(name, *arguments)(*others)
            python = [each.copy() for each in others]
            assert compiled.uncompiled[name](*copies, *python) == found
            for one, other in zip((*arguments, *others), (*copies, *python), strict=True):
                np.testing.assert_array_equal(one, other)
            pairs.append(name)
            return found

        return both

    monkeypatch.setattr(clear_space, "bind", bind)
    checker = checker_of("so101", things_around(8))
    q = np.random.default_rng(9).uniform(-1.0, 1.0, (4, checker.dof))
    space = checker.clear_space(0.002, q)
    space.is_free(q) if kernel == "first_contact" else space.contains(q)
    assert pairs == [kernel]


def test_free_path_kernel_refuses_arrays_of_wrong_shape(monkeypatch):
    given = []
    monkeypatch.setattr(clear_space, "bind", lambda name, *arguments: given.extend(arguments))
    checker = CollisionChecker(body("so101"), 0.0, BOXES)
    checker.clear_space(0.002)
    given = [*given[: len(given) // 2], np.zeros((2, checker.dof))]
    assert free_path_kernel.path_fits(*given)
    for at, argument in enumerate(given):
        if isinstance(argument, np.ndarray):
            for axis in range(argument.ndim):
                if (at, axis) in {(4, 0), (18, 0)}:  # fewer pairs, or postures, are fine
                    continue
                cut = np.ascontiguousarray(np.delete(argument, 0, axis))
                tried = [*given[:at], cut, *given[at + 1 :]]
                assert not free_path_kernel.path_fits(*tried), (at, axis)
                with pytest.raises(ValueError, match="match"):
                    free_path_kernel.first_contact(*tried)
