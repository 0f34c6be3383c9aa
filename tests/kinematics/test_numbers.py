"""Only finite numbers of the right shape are accepted."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import (
    as_floats,
    bounded_vector,
    finite_array,
    finite_vector,
    finite_vectors,
    read_only,
)


@pytest.mark.parametrize("values", [[1, 2], (1.0, 2.0), np.array([1, 2], dtype=np.int8)])
def test_number_check_converts_integers_and_fractions(values):
    found = finite_vector(values, 2, "q")
    assert (found.dtype, found.tolist()) == (np.float64, [1.0, 2.0])


@pytest.mark.parametrize(
    "values",
    [[True, False], [1j, 2j], [b"1", b"2"], ["1", "2"], [[1], [1, 2]], [10**400, 0]],
)
def test_number_check_refuses_bools_strings_and_complex(values):
    with pytest.raises(BadValueError) as caught:
        finite_vector(values, 2, "q")
    assert "q" in caught.value.message
    assert "numbers of shape (2,)" in str(caught.value) + caught.value.hint


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_number_check_refuses_nan_and_infinity(bad):
    for ask in (
        lambda: finite_vector([1.0, bad], 2, "q"),
        lambda: finite_vectors([[0.0, 0.0], [1.0, bad]], 2, "q"),
        lambda: finite_array([[bad]], (1, 1), "q"),
    ):
        with pytest.raises(BadValueError, match="q"):
            ask()


def test_vector_check_accepts_one_vector_or_many():
    assert finite_vectors([1.0, 2.0], 2, "q").shape == (2,)
    assert finite_vectors([[1.0, 2.0]] * 3, 2, "q").shape == (3, 2)
    assert finite_vectors(np.zeros((0, 2)), 2, "q").shape == (0, 2)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (3, 1), (1, 1, 2)])
def test_vector_check_refuses_wrong_shape(shape):
    with pytest.raises(BadValueError) as caught:
        finite_vectors(np.zeros(shape), 2, "q")
    assert str(shape) in caught.value.message


def test_float_conversion_accepts_any_shape_and_infinity():
    assert as_floats([[1, math.inf]], "limits", "numbers").tolist() == [[1.0, math.inf]]


def test_read_only_array_is_independent_copy():
    original = np.array([1, 2])
    copy = read_only(original)
    original[0] = 9
    assert (copy.dtype, copy.tolist()) == (np.float64, [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 3.0


@pytest.mark.parametrize("size", [1, 2, 16, 17, 40])
def test_bounded_vector_accepts_values_up_to_bound(size):
    for values in (np.full(size, 3.0), np.full(size, -3.0), np.zeros(size)):
        assert bounded_vector(values, size, 3.0, "q", "small numbers") is values


@pytest.mark.parametrize("size", [1, 2, 16, 17, 40])
@pytest.mark.parametrize("bad", [3.001, -3.001])
def test_bounded_vector_refuses_value_beyond_bound(size, bad):
    values = np.zeros(size)
    values[-1] = bad
    with pytest.raises(BadValueError, match="q") as caught:
        bounded_vector(values, size, 3.0, "q", "small numbers")
    assert "small numbers" in str(caught.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("size", [2, 17])
def test_bounded_vector_refuses_nan_and_infinity(size, bad):
    for values in (np.full(size, bad), np.append(np.ones(size - 1), bad)):
        with pytest.raises(BadValueError, match="finite"):
            bounded_vector(values, size, 3.0, "q", "small numbers")


def test_bounded_vector_accepts_empty_vector():
    assert bounded_vector(np.zeros(0), 0, 0.5, "q", "small numbers").shape == (0,)
    assert bounded_vector(np.full(17, 0.5), 17, 0.5, "q", "small numbers").shape == (17,)
