"""Lag of the arm behind the pointer, in virtual time: steeper jerk, same speeds."""

import math
import statistics
from itertools import pairwise

import numpy as np
import pytest

from ikservo.apps.page.messages import page_messages
from ikservo.apps.page.running import arm_thread as arm_thread_module
from tests.apps.page.view_session import ViewSession

TWO_TICKS_RAD = 2 * math.tau / 4096
STEEP = arm_thread_module.HAND_JERK_FACTOR


def followed(monkeypatch, jerk_factor):
    """Return the durations of small pointer moves [ms], and the references by time."""
    monkeypatch.setattr(arm_thread_module, "HAND_JERK_FACTOR", jerk_factor)
    took_ms, seen, moved_s = [], [], None
    with ViewSession() as session:
        session.send_message(page_messages.SetSpeed, name="normal")
        session.send_message(page_messages.SetLive, on=True)
        camera = session.controller._composer.camera(session.controller._clients[session.client])
        q = session.arm.joint_index.chain_joints(session.arm_thread.snapshot.measured)
        x, y = camera.project(session.arm.chain.forward(q)[:3, 3])[0]

        def drive(number):
            nonlocal moved_s
            now_s, goal = session.clock.now_s(), session.interaction.goal
            if number == 40:
                session.point("down", x, y)
                session.point("move", x + 3, y)
            elif number >= 100 and number % 50 == 0:
                count, moved_s = number // 50, now_s
                session.point("move", x + 3 + 0.45 * (count % 4), y + 0.45 * (count % 3))
            elif moved_s is not None and goal is not None:
                reference = session.arm_thread.snapshot.reference
                seen.append((now_s, reference))
                if np.abs(reference - goal).max() <= TWO_TICKS_RAD:
                    took_ms.append(1000 * (now_s - moved_s))
                    moved_s = None

        session.run(cycles=700, on_cycle=drive)
    return took_ms, seen


def largest_acceleration_deg_s2(seen):
    """Return the largest acceleration of any joint between neighbouring references, deg/s²."""
    speeds = [((t0 + t1) / 2, (q1 - q0) / (t1 - t0)) for (t0, q0), (t1, q1) in pairwise(seen)]
    neighbours = [(one, two) for one, two in pairwise(speeds) if two[0] - one[0] < 0.03]
    return max(np.degrees(np.abs(v1 - v0).max() / (t1 - t0)) for (t0, v0), (t1, v1) in neighbours)


@pytest.mark.full
def test_higher_jerk_limit_reduces_pointer_lag_at_same_speed(monkeypatch):
    plain, _ = followed(monkeypatch, 1.0)
    steep, seen = followed(monkeypatch, STEEP)
    assert statistics.median(steep) <= 60.0
    assert statistics.median(steep) < 0.75 * statistics.median(plain)
    assert largest_acceleration_deg_s2(seen) <= 180.1
    for (before_s, before), (now_s, now) in pairwise(seen):
        assert np.degrees(np.abs(now - before)).max() <= 60.5 * (now_s - before_s)


@pytest.mark.full
def test_acceleration_ramps_take_12_5_ms_in_each_speed_class():
    with ViewSession() as session:
        planner = session.arm.context.planner
        for speed in ("slow", "normal", "fast"):
            limit = planner.motion_limits(speed)[0]
            ramp_s = limit.acceleration_rad_s2 / (
                limit.jerk_rad_s3 * arm_thread_module.HAND_JERK_FACTOR
            )
            assert ramp_s == pytest.approx(0.0125)  # of the whole acceleration, about one cycle
