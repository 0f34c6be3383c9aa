"""A long stream leaks neither memory nor file descriptors."""

import gc
import os
from pathlib import Path

import pytest

import ikservo
from ikservo.control.loop import ControlLoop
from ikservo.motion import TrajectoryPoint
from tests.arm.seeds import log
from tests.arm.simulated import servo_group

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0


class ToAndFro:
    """A trajectory that swings the first joint slowly, forever."""

    duration_s = float("inf")

    def __init__(self, start):
        self._start = start

    def state(self, time_s):
        position = self._start.copy()
        share = (time_s / 8.0) % 1.0
        position[0] += 0.6 * (share if share < 0.5 else 1.0 - share)
        return TrajectoryPoint.at_rest(position)


class CountedError(Exception):
    """Ends a stream after enough cycles."""


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_BYTES


def descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.full
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_control_cycles_do_not_accumulate_objects(name):
    counts = []
    streamed(name, 900, lambda k: counts.append(len(gc.get_objects())) if k % 300 == 0 else None)
    assert counts[-1] - counts[0] < 300  # not one a cycle


@pytest.mark.campaign
@pytest.mark.timeout(0)
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_many_control_cycles_do_not_leak_memory_or_descriptors(name, capsys):
    cycles = int(os.environ.get("IKSERVO_SOAK_CYCLES", "20000"))
    warm, seen = cycles // 10, []

    def check(k):
        if k in (warm, cycles):
            gc.collect()
            seen.append((resident_bytes(), descriptors()))

    streamed(name, cycles, check)
    (rss_before, fds_before), (rss_after, fds_after) = seen
    log(
        capsys, f"{name}: {cycles} cycles, {rss_after - rss_before:+} bytes, {fds_after} files open"
    )
    assert rss_after - rss_before < 1_000_000
    assert fds_after == fds_before


def streamed(name, cycles, check):
    """Swing an arm for a number of cycles; ``check`` is called with the number of each."""
    count = iter(range(1, cycles + 1))

    def on_cycle(_):
        k = next(count)
        check(k)
        if k == cycles:
            raise CountedError

    with ikservo.open_arm(name, port="sim") as arm:
        arm.enable()
        with pytest.raises(CountedError):
            ControlLoop(servo_group(arm)).run(ToAndFro(servo_group(arm).goals()), on_cycle)
