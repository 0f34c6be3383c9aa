"""Array types and checks: vectors, matrices, finite numbers."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import cache
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.errors import BadValueError, shown

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
IntVector = NDArray[np.int64]
IntMatrix = NDArray[np.int64]

_FLOAT64 = np.dtype(np.float64)
# Arrays up to this size are checked faster as a Python list than by NumPy.
LARGEST = 1e12
"""Largest number that a program or a file may give, because products of larger numbers overflow."""
_FEW = 16


def finite_vector(values: ArrayLike, size: int, what: str) -> Vector:
    """Return ``values`` as (size,) floats; see ``finite_array``."""
    return finite_array(values, (size,), what)


def finite_vectors(values: ArrayLike, size: int, what: str) -> Vector:
    """Return one vector (size,) or many (n, size) as floats; see ``finite_array``."""
    array = as_floats(values, what, f"numbers of shape ({size},) or (n, {size})")
    if array.ndim not in (1, 2) or array.shape[-1] != size:
        raise BadValueError(what, f"of shape {array.shape}", f"shape ({size},) or (n, {size})")
    return _require_finite(array, what)


def finite_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """Return ``values`` as an array of floats of that shape.

    Raises:
        BadValueError: The values are not numbers, not finite, or have the wrong shape.
    """
    return _require_finite(array_of_shape(values, shape, what), what)


def array_of_shape(values: ArrayLike, shape: tuple[int, ...], what: str) -> Vector:
    """Return ``values`` as an array of floats of that shape, finite or not.

    Raises:
        BadValueError: The values are not numbers, or have the wrong shape.
    """
    if type(values) is np.ndarray and values.dtype is _FLOAT64 and values.shape == shape:
        return values
    array = as_floats(values, what, f"numbers of shape {shape}")
    if array.shape != shape:
        raise BadValueError(what, f"of shape {array.shape}", f"shape {shape}")
    return array


def bounded_vector(values: ArrayLike, size: int, most: float, what: str, expected: str) -> Vector:
    """Return ``values`` as (size,) floats whose magnitudes are at most ``most``.

    Raises:
        BadValueError: ``finite_array`` refuses the values, or a number is larger than allowed.
    """
    array, is_short = array_of_shape(values, (size,), what), size <= _FEW
    if is_short and math.hypot(*array.tolist()) <= most:  # this comparison is false for NaN, too
        return array
    if float(np.abs(_require_finite(array, what)).max()) > most:
        raise BadValueError(what, array.tolist(), expected)
    return array


def as_floats(values: ArrayLike, what: str, expected: str) -> Vector:
    """Return ``values`` as an array of floats of any shape; raise an error if that is impossible.

    Strings, booleans and complex numbers are not accepted.
    """
    if type(values) is np.ndarray and values.dtype is _FLOAT64:
        return values
    try:
        array = np.asarray(values)
        if array.dtype.kind in "bcSU":
            raise TypeError
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise BadValueError(what, shown(values), expected) from None


def read_only(values: ArrayLike) -> Vector:
    """Return a copy (any shape) that cannot be written to."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


class FrozenArrays:
    """Base of frozen dataclasses whose arrays are read-only; see ``freeze_arrays``."""

    __slots__ = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)


def freeze_arrays(value: object) -> None:
    """Make the arrays of a frozen dataclass read-only; its ``__post_init__`` calls this.

    A writable array is copied, because other code could still change the original.
    """
    for name in _field_names(type(value)):
        array: object = getattr(value, name)
        if isinstance(array, np.ndarray) and array.flags.writeable:
            frozen = cast("NDArray[np.generic]", array).copy()
            frozen.flags.writeable = False
            object.__setattr__(value, name, frozen)


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _require_finite(array: Vector, what: str) -> Vector:
    is_short = array.ndim == 1 and len(array) <= _FEW
    if is_short and math.hypot(*array.tolist()) <= LARGEST:  # this comparison is false for NaN, too
        return array
    if not np.isfinite(array).all():
        raise BadValueError(what, str(array.tolist()), "finite numbers")
    if array.size and float(np.abs(array).max()) > LARGEST:
        raise BadValueError(what, str(array.tolist()), f"numbers within ±{LARGEST:g}")
    return array
