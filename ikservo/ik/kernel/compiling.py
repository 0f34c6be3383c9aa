"""Compiles the kernels once per machine, says so, and keeps the result for the next process."""

from __future__ import annotations

import contextlib
import hashlib
import sys
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path
from typing import TypeVar

import numba
from numba.core import event
from platformdirs import user_cache_path

__all__ = ["entry", "inner"]

F = TypeVar("F", bound=Callable[..., object])

_NOTICE = "Compiling the solver, once on this machine; this takes some seconds ...\n"


def inner(function: F) -> F:
    """Compile a function that only other kernels call; it becomes part of them."""
    return numba.njit(nogil=True, error_model="numpy")(function)


def entry(function: F) -> F:
    """Compile a function that Python calls, and keep it in the user's cache directory."""
    _announce_compilation()
    with _own_cache():
        try:
            return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
        except RuntimeError:  # no directory can be written to: compiled anew in every process
            return numba.njit(nogil=True, error_model="numpy")(function)


@contextlib.contextmanager
def _own_cache() -> Generator[None]:
    """Point numba to our directory while our functions are declared, and to nobody else's.

    Numba only looks at the file of the entry for changes; the fingerprint of all the kernels'
    sources in the path keeps it from running an old kernel inside a new one.
    """
    before = numba.config.CACHE_DIR
    home = Path(before) / "ikservo" if before else user_cache_path("ikservo")
    numba.config.CACHE_DIR = str(home / f"kernels-{_fingerprint()}")
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


@cache
def _fingerprint() -> str:
    package = Path(__file__).parent
    layout = package.parents[1] / "kinematics" / "packing.py"
    digest = hashlib.sha256(numba.__version__.encode())
    for source in [*sorted(package.glob("*.py")), layout]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def _is_ours(function: object) -> bool:
    return str(getattr(function, "__module__", "")).startswith("ikservo.")


class _Announcer(event.Listener):
    """Writes one line when the first kernel has to be compiled."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: event.Event) -> None:
        function = getattr(event.data.get("dispatcher"), "py_func", None)
        if not self._said and _is_ours(function):
            self._said = True
            sys.stderr.write(_NOTICE)
            sys.stderr.flush()

    def on_end(self, event: event.Event) -> None:
        """Say nothing: what follows is the answer."""


@cache
def _announce_compilation() -> None:
    event.register("numba:compile", _Announcer())
