"""Compiles the kernels once per machine, says so, and keeps the result for the next process."""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import sys
import time
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path
from typing import TypeVar

import numba
from numba.core import event
from platformdirs import user_cache_path

__all__ = ["STALE_S", "entry", "forget_stale", "inlined", "inner"]

F = TypeVar("F", bound=Callable[..., object])

STALE_S = 30 * 86_400.0
"""How long kernels are kept that another version of ikservo has made."""

_NOTICE = "Compiling the solver, once on this machine; this takes some seconds ...\n"


# Products and sums may share one rounding: that is faster, and never less exact.
_FAST = {"contract"}


def inner(function: F) -> F:
    """Compile a function that only other kernels call; it becomes part of them."""
    return numba.njit(nogil=True, error_model="numpy", fastmath=_FAST)(function)


def inlined(function: F) -> F:
    """Compile a function that is copied to where other kernels call it, as it is small or alone.

    A call costs as much as a small function does: the arrays that it is handed are counted.
    """
    return numba.njit(nogil=True, error_model="numpy", fastmath=_FAST, forceinline=True)(function)


def entry(function: F) -> F:
    """Compile a function that Python calls, and keep it in the user's cache directory."""
    _announce_compilation()
    with _own_cache():
        try:
            return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)(function)
        except RuntimeError:  # no directory can be written to: compiled anew in every process
            return inner(function)


@contextlib.contextmanager
def _own_cache() -> Generator[None]:
    """Point numba to our directory while our functions are declared, and to nobody else's.

    Numba only looks at the file of the entry for changes; the fingerprint of all the kernels'
    sources, and of the layouts that they read, in the path keeps it from running an old kernel
    inside a new one. Where it is new, what older versions left behind is removed.
    """
    before = numba.config.CACHE_DIR
    home = Path(before) / "ikservo" if before else user_cache_path("ikservo")
    folder = home / f"kernels-{_fingerprint()}"
    with contextlib.suppress(OSError):  # it may not be ours to look into
        if not folder.exists():
            forget_stale(home, time.time() - STALE_S)
    numba.config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def forget_stale(home: Path, before_s: float) -> None:
    """Remove the folders of kernels in ``home`` that were made before a time [s, Unix]."""
    for folder in home.glob("kernels-*"):
        with contextlib.suppress(OSError):  # another process removes it, or it is not ours
            if folder.stat().st_mtime < before_s:
                shutil.rmtree(folder)


@cache
def _fingerprint() -> str:
    package = Path(__file__).parent
    layouts = sorted((package.parents[1] / "kinematics").glob("pack*.py"))
    digest = hashlib.sha256(numba.__version__.encode())
    for source in [*sorted(package.glob("*.py")), *layouts]:
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
