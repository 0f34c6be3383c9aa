"""Numba decorators and the hygiene of numba's cache."""

from __future__ import annotations

import contextlib
import hashlib
import os
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

__all__ = ["CACHE_MAX_AGE_S", "jit", "jit_entry", "jit_inline", "remove_stale_caches"]

F = TypeVar("F", bound=Callable[..., object])

CACHE_MAX_AGE_S = 30 * 86_400.0
"""How long kernels are kept that another version of ikservo has made."""

_COMPILING_NOTICE = (
    "Compiling the solver, once on this machine; this takes about half a minute ...\n"
)
# LLVM's higher levels take twice as long and gain nothing here.
_LEVEL = 1


# Products and sums may share one rounding: that is faster, and never less exact.
_FAST = {"contract"}


def jit(function: F) -> F:
    """Compile a function that only other kernels call; it becomes part of them."""
    return numba.njit(nogil=True, error_model="numpy", fastmath=_FAST)(function)


def jit_inline(function: F) -> F:
    """Compile a function that is copied to where other kernels call it, as it is small or alone.

    A call costs as much as a small function does: the arrays that it is handed are counted.
    """
    return numba.njit(nogil=True, error_model="numpy", fastmath=_FAST, forceinline=True)(function)


def jit_entry(function: F) -> F:
    """Compile a function that Python calls, and keep it in the user's cache directory."""
    _watch_compilation()
    with _private_cache() as ours:
        if not ours:  # numba would put it beside the source, where nobody sees that it is old
            return jit(function)
        return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)(function)


@contextlib.contextmanager
def _private_cache() -> Generator[bool]:
    """Point numba to our directory while our functions are declared, and to nobody else's.

    Yields whether it can be written to; if not, kernels are compiled anew in every process.

    Numba only looks at the file of the entry for changes; the fingerprint of all the kernels'
    sources, and of the layouts that they read, in the path keeps it from running an old kernel
    inside a new one. Where it is new, what older versions left behind is removed.
    """
    before = numba.config.CACHE_DIR
    home = Path(before) / "ikservo" if before else user_cache_path("ikservo")
    folder = home / f"kernels-{_fingerprint()}"
    with contextlib.suppress(OSError):  # it may not be ours to look into
        if not folder.exists():
            remove_stale_caches(home, time.time() - CACHE_MAX_AGE_S)
    numba.config.CACHE_DIR = str(folder)
    try:
        yield _is_writable(folder)
    finally:
        numba.config.CACHE_DIR = before


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def remove_stale_caches(home: Path, before_s: float) -> None:
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


def _is_own_kernel(function: object) -> bool:
    return str(getattr(function, "__module__", "")).startswith("ikservo.")


def _compile_at(level: int) -> None:
    setattr(numba.config, "OPT", level)  # noqa: B010  # as above


class _CompilationListener(event.Listener):
    """Writes one line when the first kernel has to be compiled, and sees that it is soon done."""

    def __init__(self) -> None:
        self._said, self._levels = False, list[int]()

    def on_start(self, event: event.Event) -> None:
        """Note the level that others compile at, and set ours."""
        self._levels.append(getattr(numba.config, "OPT"))  # noqa: B009  # of no known type
        if not _is_own_kernel(getattr(event.data.get("dispatcher"), "py_func", None)):
            return
        _compile_at(type(self._levels[-1])(_LEVEL))
        if not self._said:
            self._said = True
            sys.stderr.write(_COMPILING_NOTICE)
            sys.stderr.flush()

    def on_end(self, event: event.Event) -> None:
        """Leave the level as it was."""
        _compile_at(self._levels.pop())


@cache
def _watch_compilation() -> None:
    event.register("numba:compile", _CompilationListener())
