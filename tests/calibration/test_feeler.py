"""A stop is where a joint stands, behind its goal, pressing: none of the three alone."""

import math

import pytest

from ikservo.calibration.sweeping.feeler import Feeler, Touch

AHEAD, LOUD = 0.08, 28.0  # rad that the goal leads, and percent of 30


def after(looks, most_percent=30.0):
    """Return what a feeler says after looks (s, rad, goal, percent)."""
    feeler = Feeler(most_percent)
    for look in looks:
        feeler = feeler.felt(*look)
    return feeler.touch


def standing(seconds, goal=AHEAD, load=LOUD):
    return [(0.02 * k, 0.0, goal, load) for k in range(int(seconds / 0.02) + 1)]


def test_a_joint_that_stands_and_presses_behind_its_goal_has_met_something():
    assert after(standing(0.3)) is Touch.STOP


def test_it_must_stand_for_a_quarter_of_a_second():
    assert after(standing(0.2)) is Touch.MOVING


def test_a_joint_that_creeps_on_under_load_is_not_stopped():
    creeping = [(0.02 * k, 0.001 * k, AHEAD + 0.001 * k, LOUD) for k in range(100)]
    assert after(creeping) is Touch.MOVING


def test_a_joint_that_is_where_it_was_told_to_go_stands_against_nothing():
    assert after(standing(1.0, goal=0.01)) is Touch.MOVING


@pytest.mark.parametrize("sign", [1, -1])
def test_the_direction_of_pressing_does_not_matter(sign):
    assert after(standing(0.3, goal=sign * AHEAD, load=sign * LOUD)) is Touch.STOP


def test_a_joint_that_stands_without_pressing_is_no_stop_but_a_fault():
    assert after(standing(1.0, load=2.0)) is Touch.MOVING
    assert after(standing(1.6, load=2.0)) is Touch.SLACK


def test_how_loud_is_loud_depends_on_how_hard_it_may_press():
    assert after(standing(0.3, load=14.0), most_percent=60.0) is Touch.MOVING
    assert after(standing(0.3, load=14.0), most_percent=30.0) is Touch.STOP


def test_a_trembling_of_a_tick_is_standing():
    trembling = [(0.02 * k, math.tau / 4096 * (k % 2), AHEAD, LOUD) for k in range(20)]
    assert after(trembling) is Touch.STOP
