"""The postures that an arm can have when it is switched on, as names and as joint positions."""

import itertools
import random
from functools import cache

import numpy as np

from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker
from ikservo.model import load_model
from ikservo.model.collision_model import collision_body
from servosim import read_arm_file
from servosim.assembly import make_arm_world
from tests.oracle import arm_file

SINKING_S = 3.0  # a limp arm lies still after this
HANDS = 3  # how many random postures a hand leaves the arm in
OUTSIDE = 0.05  # rad, or a fraction of a slide's range, beyond a limit: still before the hard stop
TRIES = 100  # of the other joints where one is at its limit
OFTEN = ("rest, sunk", "pose home")  # what most arms are met in


@cache
def postures_of(name):
    """Return the names of all postures of an arm."""
    poses = [f"pose {pose}" for pose in arm_file(name)["poses"]]
    hands = [f"hand {k}" for k in range(HANDS)]
    return ("rest, sunk", *poses, *hands, "on a stop", "outside a limit")


@cache
def joints_in(name, posture):
    """Return the position (rad, or m) of every joint of a limp arm, by joint."""
    kind, _, which = posture.partition(" ")
    model = load_model(name)
    if kind == "pose":
        return dict(model.pose(which))
    if kind == "rest,":
        return sunk(name, model.pose("rest"))
    if kind == "hand":
        return sunk(name, _anywhere(model, random.Random(f"{name} {posture}")))
    return _at_a_limit(model, beyond=kind == "outside")


def sunk(name, joints):
    """Return where a limp arm comes to lie from a posture, table and own body in its way."""
    model = load_model(name)
    world = make_arm_world(read_arm_file(model.path), physics=True)
    for joint, position in joints.items():
        world.place(joint, position)
    world.advance_to(SINKING_S)
    return {joint.name: joint.position for joint in world.joints}


def _anywhere(model, chance):
    """Return joints where a hand might bring them: inside the limits, nothing touches."""
    while True:
        joints = _picked(model, chance)
        if _free(model, joints):
            return joints


def _at_a_limit(model, beyond):
    """Return a posture with the second joint at its upper limit, or beyond it.

    The other joints are in the pose home, or elsewhere where that would be inside the table or
    the arm itself. Where none of these postures is free the joint is at its lower limit, and where
    the body never lets it go that far, it is a joint after it.
    """
    chance, past = random.Random(model.name), OUTSIDE if beyond else 0.0
    for limited in model.joints[1:]:
        for end in (limited.limits.upper.value + past, limited.limits.lower.value - past):
            fixed = {limited.name: end}
            tried = (_picked(model, chance) | fixed for _ in range(TRIES))
            for joints in itertools.chain([dict(model.pose("home")) | fixed], tried):
                if _free(model, joints):
                    return joints
    raise LookupError(f"No posture of {model.name} with a joint at its limit is free.")


def _picked(model, chance):
    return {j.name: _between(j, chance.uniform(0.05, 0.95)) for j in model.joints}


def _free(model, joints):
    space = CollisionChecker(collision_body(model), model.floor_m)
    try:
        space.check_pose(np.array([joints[name] for name in model.chain.names]))
    except RefusedError:
        return False
    return True


def _between(joint, share):
    lower, upper = joint.limits.lower.value, joint.limits.upper.value
    lower, upper = max(lower, -3.0), min(upper, 3.0)
    return lower + share * (upper - lower)
