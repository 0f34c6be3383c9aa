"""Habits of the interpreter that would make the arm stutter, put off while a view is open."""

from __future__ import annotations

import gc
import sys
from collections.abc import Generator
from contextlib import contextmanager

__all__ = ["steady"]

# Whoever streams goals must not wait long for whoever draws, nor the page for either.
_SWITCH_S = 0.0005


@contextmanager
def steady() -> Generator[None]:
    """Let threads take turns often, and keep what is loaded out of the garbage collector's rounds.

    A full round over all that numba and pydantic have loaded takes a tenth of a second, in which
    no thread runs; frozen, what has been loaded is not looked at again.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
