"""The compiled kernels: whether they exist and are current, and how Python calls them.

Kernels are plain Python. If a C compiler was available at installation, an extension module has the
same functions as machine code. Otherwise, and if a source has changed since, they run as Python,
with the same results but about a thousand times slower.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import warnings
from collections.abc import Callable
from functools import cache, partial, wraps
from pathlib import Path
from typing import ParamSpec, Protocol, TypeVar, cast

import numpy as np

from ikservo.kinematics.arrays import Matrix

P = ParamSpec("P")
R = TypeVar("R")

uncompiled: dict[str, Callable[..., object]] = {}
"""Entries as Python functions, by name, even if compiled functions exist."""

_ARRAYS = {
    "Vector": ("float64", 1),
    "Matrix": ("float64", 2),
    "IntVector": ("int64", 1),
    "IntMatrix": ("int64", 2),
}
_SWITCH = "IKSERVO_COMPILED"  # 0: run the kernels as Python
_PACKAGE = Path(__file__).parents[1]


class _Extension(Protocol):
    """The extension module, see tools/kernel/extension.c."""

    SOURCES: str
    DIGESTS: str

    def bind(self, name: str, /, *arguments: object) -> Callable[..., object]:
        """Return a kernel with its first arguments bound."""
        ...


def entry(check: Callable[P, bool]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Mark a kernel that Python calls; it raises ValueError if its check returns False.

    Args:
        check: A kernel with the same parameters that returns whether the arrays have the shapes,
            and the indices in them the ranges, that the marked kernel relies on. The types of
            arrays are also checked; a wrong type raises TypeError.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        name, extension = function.__name__, _extension()
        kinds = [_ARRAYS.get(str(kind)) for kind in function.__annotations__.values()]

        @wraps(function)
        def run(*arguments: P.args, **named: P.kwargs) -> R:
            for kind, argument in zip(kinds, arguments, strict=False):
                array = cast("Matrix", argument)
                if kind and not (
                    isinstance(argument, np.ndarray) and (array.dtype.name, array.ndim) == kind
                ):
                    what = f"{kind[0]} with {kind[1]} dimension(s)"
                    raise TypeError(f"{name}: not an array of {what}")
            if not check(*arguments, **named):
                raise ValueError(f"{name}: the shapes of the arrays do not match")
            with np.errstate(all="ignore"):  # as in C
                return function(*arguments, **named)

        uncompiled[name] = run
        return run if extension is None else cast("Callable[P, R]", extension.bind(name))

    return decorate


def vectorised(function: Callable[P, R]) -> Callable[P, R]:
    """Mark a kernel whose loops are so long that C should compute several iterations at once."""
    return function


def bind(name: str, *arguments: object) -> Callable[..., object]:
    """Return the entry of that name with its first arguments bound, which are checked only once."""
    extension = _extension()
    if extension is None:
        return partial(uncompiled[name], *arguments)
    return extension.bind(name, *arguments)


def is_compiled() -> bool:
    """Check whether the kernels run as machine code."""
    return _extension() is not None


@cache
def _extension() -> _Extension | None:
    """Return the extension module; None if there is none, or if it is older than its sources."""
    if os.environ.get(_SWITCH) == "0":
        return None
    try:
        found = cast("_Extension", importlib.import_module("ikservo.kernels._compiled"))
    except ImportError:
        return None
    if not any(map(_has_changed, found.SOURCES.split(), found.DIGESTS.split())):
        return found
    text = (
        "The kernels have changed since they were compiled, so they run as Python. Try: make build"
    )
    warnings.warn(text, RuntimeWarning, stacklevel=2)
    return None


def _has_changed(source: str, digest: str) -> bool:
    """Check whether a source has changed; the source of a deleted app counts as unchanged."""
    path = _PACKAGE.parent / source
    return path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() != digest
