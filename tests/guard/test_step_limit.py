"""The allowed step of a goal depends on time: slow goals save nothing, fast ones are limited."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.guard.joint_gate import RateLimiter


@pytest.mark.parametrize(
    ("elapsed_s", "most"), [(0.0, 1), (0.0001, 1), (0.01, 11), (0.05, 51), (0.06, 51), (-1.0, 1)]
)
def test_maximum_step_is_speed_times_time_plus_one_tick(elapsed_s, most):
    assert RateLimiter(1000.0).max_step(elapsed_s) == most


def test_rate_limiter_grants_rounding_tick_only_once():
    limiter = RateLimiter(1000.0)
    limiter.consume(11, 0.01)
    assert limiter.max_step(0.01) == 10


def test_rate_limiter_keeps_fraction_of_tick_for_next_step():
    limiter = RateLimiter(1000.0)
    limiter.consume(11, 0.0105)
    assert limiter.max_step(0.0005) == 1


def test_rate_limiter_at_rest_accumulates_only_rounding_tick():
    limiter = RateLimiter(1000.0)
    for _ in range(10):
        limiter.consume(0, 0.05)
    assert limiter.max_step(0.01) == 11

    assert limiter.max_step(0.0008) == 1


@pytest.mark.parametrize(("short_ticks", "most"), [(0.9e-6, 2), (1.1e-6, 1)])
def test_maximum_step_tolerates_floating_point_rounding(short_ticks, most):
    assert RateLimiter(1000.0).max_step((1.0 - short_ticks) / 1000.0) == most


@given(st.lists(st.tuples(st.integers(0, 60), st.floats(0.0, 0.05)), max_size=40))
def test_goal_steps_never_exceed_speed_times_time_plus_one_tick(steps):
    limiter, gone, elapsed_s = RateLimiter(1000.0), 0, 0.0
    for goal, dt_s in steps:
        step = min(goal, limiter.max_step(dt_s))
        limiter.consume(step, dt_s)
        gone, elapsed_s = gone + step, elapsed_s + dt_s
        assert gone <= 1000.0 * elapsed_s + 1.0 + 1e-4
