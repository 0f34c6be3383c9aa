"""Laws of the firmware's profiles."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servosim.control import ProfileGenerator, ramp, timed, trapezoid

distances = st.floats(-10.0, 10.0)
velocities = st.floats(-5.0, 5.0)
limits = st.floats(0.05, 8.0)
slopes = st.floats(0.1, 50.0)


def travel(pieces: list, velocity: float) -> tuple[float, float]:
    """Return distance and final velocity; fail if the velocity jumps."""
    distance = 0.0
    for piece in pieces:
        if piece.duration_s > 0.0:
            assert piece.velocity_rad_s == pytest.approx(velocity, abs=1e-6)
            gained = piece.acceleration_rad_s2 * piece.duration_s
            distance += (piece.velocity_rad_s + gained / 2.0) * piece.duration_s
            velocity = piece.velocity_rad_s + gained
    return distance, velocity


@given(distances, velocities, limits, slopes)
def test_trapezoid_from_any_velocity_ends_at_rest_at_goal(
    distance: float, velocity: float, limit: float, slope: float
) -> None:
    pieces = trapezoid(distance, velocity, limit, slope)
    assert travel(pieces, velocity) == pytest.approx((distance, 0.0), abs=1e-6)


@given(distances, velocities, limits, slopes)
def test_trapezoid_never_exceeds_its_limits(
    distance: float, velocity: float, limit: float, slope: float
) -> None:
    top = max(limit, abs(velocity)) + 1e-9
    for piece in trapezoid(distance, velocity, limit, slope):
        assert abs(piece.velocity_rad_s) <= top
        assert abs(piece.acceleration_rad_s2) <= slope


@given(distances, slopes)
def test_trapezoid_without_speed_limit_is_triangle(distance: float, slope: float) -> None:
    pieces = trapezoid(distance, 0.0, 0.0, slope)
    assert sum(piece.duration_s for piece in pieces) == pytest.approx(
        2.0 * math.sqrt(abs(distance) / slope), abs=1e-6
    )


@given(distances, velocities, st.floats(0.01, 20.0), st.floats(0.001, 20.0))
def test_timed_profile_ends_at_rest_at_goal(
    distance: float, velocity: float, total: float, ramp_s: float
) -> None:
    pieces = timed(distance, velocity, total, ramp_s)
    assert travel(pieces, velocity) == pytest.approx((distance, 0.0), abs=1e-6)


@given(distances, st.floats(0.01, 20.0), st.floats(0.0, 20.0))
def test_timed_profile_takes_requested_duration(
    distance: float, total: float, ramp_s: float
) -> None:
    pieces = timed(distance, 0.0, total, ramp_s)
    assert sum(piece.duration_s for piece in pieces) == pytest.approx(total)


@given(velocities, velocities, slopes)
def test_velocity_ramp_ends_at_goal_velocity(start: float, goal: float, slope: float) -> None:
    _, velocity = travel(ramp(start, goal, slope), start)
    assert velocity == pytest.approx(goal, abs=1e-9)


@given(distances, limits, slopes, st.integers(1, 200))
def test_profile_generator_equals_closed_form_at_any_step(
    distance: float, limit: float, slope: float, steps: int
) -> None:
    reference = ProfileGenerator(0.0)
    reference.follow(trapezoid(distance, 0.0, limit, slope), distance)
    time_s = 0.37
    for _ in range(steps):
        reference.advance(time_s / steps)
    expected = closed_form(abs(distance), limit, slope, time_s)
    assert abs(reference.position_rad) == pytest.approx(expected, abs=1e-7)


def test_profile_generator_stops_exactly_at_goal() -> None:
    reference = ProfileGenerator(0.1)
    reference.follow(trapezoid(0.7, 0.0, 1.3, 3.1), 0.8)
    for _ in range(3000):
        reference.advance(0.001)
    assert (reference.position_rad, reference.velocity_rad_s) == (0.8, 0.0)


def test_profile_generator_without_limits_jumps_to_goal() -> None:
    reference = ProfileGenerator(0.0)
    reference.follow(trapezoid(0.7, 0.0, 0.0, 0.0), 0.7)
    assert reference.position_rad == 0.7


def test_profile_without_acceleration_moves_at_speed_limit() -> None:
    reference = ProfileGenerator(0.0)
    reference.follow(trapezoid(-0.7, 0.0, 2.0, 0.0), -0.7)
    reference.advance(0.1)
    assert reference.position_rad == pytest.approx(-0.2)


def closed_form(distance: float, limit: float, slope: float, time_s: float) -> float:
    """Return the textbook trapezoid from rest to rest."""
    top = min(limit, math.sqrt(distance * slope))
    ramp_s = top / slope
    total_s = distance / top + ramp_s if top else 0.0
    if time_s >= total_s:
        return distance
    if time_s < ramp_s:
        return slope * time_s**2 / 2.0
    if time_s < total_s - ramp_s:
        return top * (time_s - ramp_s / 2.0)
    return distance - slope * (total_s - time_s) ** 2 / 2.0
