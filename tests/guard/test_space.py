"""The way of the body is looked at before anything moves."""

import itertools
import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, RefusedError
from ikservo.guard import Box, Space
from ikservo.model import load_model
from ikservo.model.shell import body_of
from tests.oracle import ARMS

SO101 = load_model("so101")
BODY = body_of(SO101)
HOME = SO101.chain_pose("home")


def straight(start, goal):
    return [start + share * (goal - start) for share in np.linspace(0, 1, 40)]


@pytest.mark.parametrize("name", ARMS)
def test_the_ways_between_the_named_poses_are_free(name):
    model = load_model(name)
    space = Space(body_of(model))
    poses = [model.chain_pose(pose) for pose in ("rest", "home", "zero", "rest")]
    for start, goal in itertools.pairwise(poses):
        space.check_way(straight(start, goal))


def test_reaching_below_the_table_is_refused_with_the_link_and_the_place():
    below = HOME + np.array([0, 0.8, 0, 0, 0])
    with pytest.raises(RefusedError, match=r"along, \w+ would touch the floor"):
        Space(BODY).check_way(straight(HOME, below))


def test_without_a_floor_the_same_way_is_free_of_it():
    below = HOME + np.array([0, 0.8, 0, 0, 0])
    Space(BODY, floor_m=-1.0).check_way(straight(HOME, below))


def test_what_stands_between_two_free_ends_is_seen():
    middle_m = SO101.chain.forward(HOME)[:3, 3]
    left, right = HOME.copy(), HOME.copy()
    left[0], right[0] = -1.2, 1.2
    cup = Box("the cup", middle_m - 0.02, middle_m + 0.02)
    with pytest.raises(RefusedError, match="would touch the cup"):
        Space(BODY, boxes=[cup]).check_way(straight(left, right))
    Space(BODY).check_way(straight(left, right))


def test_an_arm_that_touches_already_may_leave():
    tip_m = SO101.chain.forward(HOME)[:3, 3]
    lid = Box("the lid", tip_m - 0.005, tip_m + 0.005)
    away = HOME - np.array([0, 0.3, 0, 0, 0])
    Space(BODY, boxes=[lid]).check_way(straight(HOME, away))


def test_an_arm_that_sank_onto_the_table_may_get_up_but_not_lie_deeper():
    sunk = HOME + np.array([0, 0.8, 0, 0, 0])
    Space(BODY).check_way(straight(sunk, HOME))
    with pytest.raises(RefusedError, match="would touch the floor"):
        Space(BODY).check_way(straight(sunk, sunk + np.array([0, 0.1, 0, 0, 0])))


def test_what_has_been_left_must_not_be_touched_again():
    sunk = HOME + np.array([0, 0.8, 0, 0, 0])
    with pytest.raises(RefusedError, match="would touch the floor"):
        Space(BODY).check_way([*straight(sunk, HOME), *straight(HOME, sunk)])


@pytest.mark.parametrize(
    ("low", "high"),
    [((0, 0, 0), (0, 1, 1)), ((0, 0, math.nan), (1, 1, 1)), ((0, 0, 0), (1, 1, math.inf))],
)
def test_a_box_without_an_inside_is_refused(low, high):
    with pytest.raises(BadValueError, match="the cup"):
        Box("the cup", np.array(low), np.array(high))
