"""The part of numba that ikservo calls; the wheel carries no types."""

from collections.abc import Callable
from typing import TypeVar

from numba.core import config as config

__version__: str

_F = TypeVar("_F", bound=Callable[..., object])

def njit(
    *,
    cache: bool = ...,
    nogil: bool = ...,
    error_model: str = ...,
    fastmath: bool | set[str] = ...,
    forceinline: bool = ...,
) -> Callable[[_F], _F]: ...
