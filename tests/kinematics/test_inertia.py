"""Masses of links: accepted values, their storage, and protection against changes."""

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.kinematics.inertia import LinkMass

# The largest entry is a product of inertia below zero.
TENSOR = np.array([[0.2, -1.0, 0.0], [-1.0, 0.3, 0.0], [0.0, 0.0, 0.0]])


def asymmetric(by):
    tensor = TENSOR.copy()
    tensor[0, 1] += by
    return tensor


def test_link_mass_may_be_zero():
    assert LinkMass("hook", 0.0, np.zeros(3)).mass_kg == 0.0


def test_inertia_tensor_asymmetric_within_1e_9_is_accepted():
    for by in (9e-10, -9e-10):
        np.testing.assert_array_equal(
            LinkMass("hook", 1.0, np.zeros(3), asymmetric(by)).inertia_kg_m2, asymmetric(by)
        )


def test_inertia_tensor_asymmetric_by_over_1e_9_is_refused():
    for by in (1.1e-9, -1.1e-9):
        with pytest.raises(BadValueError, match="symmetric"):
            LinkMass("hook", 1.0, np.zeros(3), asymmetric(by))


def test_link_mass_object_keeps_read_only_copies():
    centre, tensor = np.array([0.1, 0.2, 0.3]), np.eye(3)
    mass = LinkMass("hook", np.float64(2.0), centre, tensor)
    centre[0], tensor[0, 0] = 9.0, 9.0
    assert type(mass.mass_kg) is float
    assert mass.centre_m.tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_array_equal(mass.inertia_kg_m2, np.eye(3))
    for array in (mass.centre_m, mass.inertia_kg_m2):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
