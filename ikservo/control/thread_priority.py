"""Steady timing of a control loop: real-time priority if allowed, short garbage collections.

On a busy machine, an ordinary thread wakes tens of milliseconds late, but a thread with real-time
priority only tenths of a millisecond. Real-time priority is used only if the user has a limit above
zero on Linux (``ulimit -r``, ``rtprio`` in ``limits.conf``, ``LimitRTPRIO=`` of a systemd unit),
because root could always use it, even if nobody has configured it.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager

from ikservo.clock import Clock, RealClock

# Above every ordinary program, below the kernel's own threads for devices (50).
_PRIORITY = 20


def allowed_priority() -> int:
    """Return the real-time priority that control loops get, 1 to 20; 0 if none is allowed."""
    if sys.platform != "linux":
        return 0
    import resource  # noqa: PLC0415  # Windows does not have it

    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return _PRIORITY if soft == resource.RLIM_INFINITY else min(_PRIORITY, soft)


@contextmanager
def steady_timing(clock: Clock) -> Generator[None]:
    """Run a control loop in the block, undisturbed by other programs and garbage collection.

    This thread gets the allowed real-time priority; programs that it starts do not. The garbage
    collector skips existing objects, so that no pause grows with the size of the program. With
    virtual time, nothing changes.
    """
    if not isinstance(clock, RealClock):
        yield
        return
    with _real_time_priority(allowed_priority()), _short_collections():
        yield


@contextmanager
def _short_collections() -> Generator[None]:
    if gc.get_freeze_count():  # done by the program itself, or by another moving arm
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def _real_time_priority(priority: int) -> Generator[None]:
    if sys.platform != "linux" or not priority:
        yield
        return
    # 0 is the calling thread (sched_setscheduler(2)).
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:  # a container may forbid what the limit allows
        yield
        return
    try:
        yield
    finally:
        # Only root may take SCHED_RESET_ON_FORK back.
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)
