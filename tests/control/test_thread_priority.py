"""A real-time control loop gets the allowed priority and restores the old one."""

import gc
import os
import sys
from contextlib import contextmanager

import pytest

import ikservo
from ikservo.clock import RealClock
from ikservo.control import thread_priority
from ikservo.control.thread_priority import allowed_priority, steady_timing
from tests.arm.random_faults import seeded
from tests.arm.short_motions import run_short_move

if sys.platform != "linux":
    pytest.skip("Linux has real-time priorities", allow_module_level=True)
import resource


def policy():
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK


@pytest.fixture
def limit(monkeypatch):
    """Return a function that sets the limit of real-time priorities, like an administrator."""

    def set_limit(soft):
        monkeypatch.setattr(resource, "getrlimit", lambda _: (soft, soft))

    return set_limit


@pytest.fixture
def permitted():
    """Skip if the system would refuse the priority because the limit belongs to this process."""
    before = os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        pytest.skip("this user may not use real-time priorities")
    os.sched_setscheduler(0, os.SCHED_OTHER, before)


@pytest.mark.parametrize(("soft", "allowed"), [(0, 0), (7, 7), (99, 20)])
def test_control_loop_gets_the_allowed_real_time_priority(limit, permitted, soft, allowed):
    limit(soft)
    assert allowed_priority() == allowed
    with steady_timing(RealClock()):
        inside = policy(), os.sched_getparam(0).sched_priority
    assert inside == ((os.SCHED_FIFO, allowed) if allowed else (os.SCHED_OTHER, 0))
    assert policy() == os.SCHED_OTHER


def test_real_time_priority_is_not_inherited_by_subprocess(limit, permitted):
    limit(7)
    ask = "import os; raise SystemExit(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK)"
    with steady_timing(RealClock()):
        assert os.spawnl(os.P_WAIT, sys.executable, "python", "-S", "-c", ask) == os.SCHED_OTHER


def test_control_loop_runs_without_real_time_permission(limit, monkeypatch):
    def refuse(*_):
        raise PermissionError

    limit(7)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with steady_timing(RealClock()):
        assert policy() == os.SCHED_OTHER


def test_garbage_collector_is_unfrozen_after_control_loop():
    gc.unfreeze()  # the suite's own objects
    try:
        with steady_timing(RealClock()):
            assert gc.get_freeze_count() > 0
        assert gc.get_freeze_count() == 0
    finally:
        gc.freeze()
    with steady_timing(RealClock()):
        pass
    assert gc.get_freeze_count() > 0  # what a program has frozen itself stays so


def test_control_loop_uses_steady_timing_mode_in_every_cycle(limit, monkeypatch):
    limit(7)
    clocks, inside = [], []

    @contextmanager
    def note(clock):
        with steady_timing(clock):
            clocks.append(clock)
            yield
            clocks.append(None)

    monkeypatch.setattr(thread_priority, "steady_timing", note)
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        arm.enable()
        run_short_move(arm, seeded(1), lambda _: inside.append((clocks[:], policy())))
        assert set(map(str, inside)) == {str(([arm.clock], os.SCHED_OTHER))}  # virtual time
        assert clocks == [arm.clock, None]
