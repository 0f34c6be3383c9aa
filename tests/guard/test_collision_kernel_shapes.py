"""Array shapes that the kernels accept, to the last index, and gravity by the same code."""

import math

import numpy as np
import pytest

from ikservo.guard import CollisionChecker
from ikservo.guard.sag import GravitySag, Weight
from ikservo.kernels import capsule_distances as collision_kernel
from ikservo.kernels.capsule_distances import distances_fit, torques_fit
from ikservo.kinematics.dynamics import Dynamics
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.packed import LINK, MIMIC_COLUMN, PARENT
from tests.guard.test_collision_kernel import BOXES, every_kind_of_joint

BODY = every_kind_of_joint()
ROWS, DOF = len(BODY.pack().names), BODY.chain.dof


@pytest.fixture
def arrays(monkeypatch):
    """Return the arguments of ``min_distances``, by name."""
    given = []
    with monkeypatch.context() as patch:
        patch.setattr(collision_kernel, "min_distances", lambda *arguments: given.extend(arguments))
        CollisionChecker(BODY, 0.02, BOXES).distances(np.zeros((2, DOF)))
    names = [
        "links",
        "capsules",
        "pairs",
        "floor_m",
        "shapes",
        "postures",
        "places",
        "ends",
        "distances",
    ]
    return dict(zip(names, given, strict=True))


@pytest.fixture
def weights():
    """Return the arguments of ``gravity_torques_kernel``, by name."""
    return {
        "links": BODY.pack().links,
        "masses": np.zeros((ROWS, 4)),
        "postures": np.zeros((2, DOF)),
        "places": np.empty((ROWS, 12)),
        "torques": np.zeros((2, DOF)),
    }


def changed(array, place, value):
    """Return a copy with one entry replaced."""
    copy = array.copy()
    copy[place] = value
    return copy


def test_collision_kernel_accepts_valid_arrays(arrays, weights):
    assert distances_fit(**arrays) is True
    assert torques_fit(**weights) is True


@pytest.mark.parametrize(
    ("column", "taken", "refused"),
    [
        (PARENT, (-1.0, 0.0, 3.0), (-2.0, 4.0, 5.0)),
        (MIMIC_COLUMN, (0.0, DOF - 1.0), (-0.5, float(DOF))),
    ],
)
def test_collision_kernel_refuses_link_index_out_of_range(arrays, weights, column, taken, refused):
    links = changed(arrays["links"], (4, PARENT), 0.0)
    for value, fits in [(each, True) for each in taken] + [(each, False) for each in refused]:
        tried = changed(links, (4, column), value)
        assert distances_fit(**arrays | {"links": tried}) is fits
        assert torques_fit(**weights | {"links": tried}) is fits


def test_first_link_of_kernel_has_no_parent_and_ignores_mimic(arrays):
    links = arrays["links"]
    assert links[0, PARENT] == -1.0
    assert distances_fit(**arrays | {"links": changed(links, (0, MIMIC_COLUMN), 99.0)}) is True
    assert distances_fit(**arrays | {"links": changed(links, (0, PARENT), 0.0)}) is False


def test_collision_kernel_refuses_capsule_on_missing_link(arrays):
    capsules = arrays["capsules"]
    for link, fits in ((0.0, True), (ROWS - 1.0, True), (-0.5, False), (float(ROWS), False)):
        tried = changed(capsules, (1, LINK), link)
        assert distances_fit(**arrays | {"capsules": tried}) is fits
    assert distances_fit(**arrays | {"capsules": capsules[:, :-1]}) is False


@pytest.mark.parametrize("end", [0, 1])
def test_collision_kernel_refuses_pair_of_missing_capsules(arrays, end):
    count = float(len(arrays["capsules"]))
    for capsule, fits in ((0.0, True), (count - 1.0, True), (-0.5, False), (count, False)):
        tried = changed(arrays["pairs"], (0, end), capsule)
        assert distances_fit(**arrays | {"pairs": tried}) is fits


def test_collision_kernel_refuses_pair_column_out_of_range(arrays):
    between = arrays["distances"].shape[1] - ROWS * (1 + len(BOXES))
    for column, fits in ((0, True), (between - 1, True), (-0.5, False), (between, False)):
        tried = changed(arrays["pairs"], (0, 2), column)
        assert distances_fit(**arrays | {"pairs": tried}) is fits


def test_collision_pair_array_may_be_empty_but_not_narrow(arrays):
    assert distances_fit(**arrays | {"pairs": arrays["pairs"][:1, :2]}) is False
    none = arrays | {"pairs": np.empty((0, 5))}
    assert distances_fit(**none) is True
    for missing, fits in ((0, True), (1, False)):
        columns = ROWS * (1 + len(BOXES)) - missing
        assert distances_fit(**none | {"distances": np.empty((2, columns))}) is fits


def test_collision_floor_may_be_minus_but_not_plus_infinity(arrays):
    for floor_m, fits in ((-math.inf, True), (0.0, True), (math.inf, False)):
        assert distances_fit(**arrays | {"floor_m": floor_m}) is fits


@pytest.mark.parametrize("name", ["masses", "places", "torques"])
@pytest.mark.parametrize("axis", [0, 1])
def test_gravity_kernel_refuses_work_arrays_of_wrong_size(weights, name, axis):
    array = weights[name]
    for size in (array.shape[axis] - 1, array.shape[axis] + 1):
        shape = [*array.shape]
        shape[axis] = size
        assert torques_fit(**weights | {name: np.zeros(shape)}) is False


def test_collision_kernel_refuses_links_array_of_wrong_width(arrays, weights):
    links = arrays["links"][:, :-1]
    assert distances_fit(**arrays | {"links": links}) is False
    assert torques_fit(**weights | {"links": links}) is False


def test_kernel_gravity_torques_equal_those_of_dynamics():
    random, free = np.random.default_rng(4), np.full(DOF, np.inf)
    q = random.uniform(-1.5, 1.5, (6, DOF))
    for links in (["hand"], ["column", "rail", "arm", "finger", "hand"]):
        masses = [LinkMass(link, mass, random.uniform(-0.1, 0.1, 3)) for mass, link in
                  enumerate(links, start=1)]  # fmt: skip
        pulled = GravitySag(BODY, Weight(masses, np.ones(DOF), -free, free))(q)
        held = Dynamics.from_masses(BODY.chain, masses).gravity_torques(q)
        np.testing.assert_allclose(pulled, -held, atol=1e-10)
