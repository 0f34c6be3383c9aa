"""Postures of an arm at power-on, as names and as joint positions."""

import itertools
import random
from functools import cache

import numpy as np

from ikservo.guard import CollisionChecker
from ikservo.model import load_model
from ikservo.model.collision_capsules import collision_body
from servosim import read_arm_file
from servosim.assembly import make_arm_world
from tests.oracle import arm_file

SINKING_S = 3.0  # time until a limp arm is at rest
HANDS = 3  # random postures, as left by hand
OUTSIDE = 0.05  # rad, or a fraction of a slide's range, beyond a limit: still before the hard stop
MAX_TRIES = 100  # tries for the other joints if one is at its limit
FREQUENT = ("rest, sunk", "pose home")  # the most frequent postures


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
        return sunk_posture(name, model.pose("rest"))
    if kind == "hand":
        return sunk_posture(name, _random_free_joints(model, random.Random(f"{name} {posture}")))
    return _at_a_limit(model, beyond=kind == "outside")


def sunk_posture(name, joints):
    """Return the joints at which a limp arm comes to rest, on the table or on itself."""
    model = load_model(name)
    world = make_arm_world(read_arm_file(model.path), physics=True)
    for joint, position in joints.items():
        world.place(joint, position)
    world.advance_to(SINKING_S)
    return {joint.name: joint.position for joint in world.joints}


def _random_free_joints(model, chance):
    """Return random joints inside the limits, without collision."""
    while True:
        joints = _random_joints(model, chance)
        if _is_free(model, joints):
            return joints


def _at_a_limit(model, beyond):
    """Return a posture with the second joint at its upper limit, or past it.

    The other joints are in the pose home, or random if that collides. If none of these postures is
    free, the joint is at its lower limit, and if that collides too, the next joint is used.
    """
    chance, past = random.Random(model.name), OUTSIDE if beyond else 0.0
    for limited in model.joints[1:]:
        for end in (limited.limits.upper.value + past, limited.limits.lower.value - past):
            fixed = {limited.name: end}
            tried = (_random_joints(model, chance) | fixed for _ in range(MAX_TRIES))
            for joints in itertools.chain([dict(model.pose("home")) | fixed], tried):
                if _is_free(model, joints):
                    return joints
    raise LookupError(f"No posture of {model.name} with a joint at its limit is free.")


def _random_joints(model, chance):
    return {j.name: _between(j, chance.uniform(0.05, 0.95)) for j in model.joints}


def _is_free(model, joints):
    space = CollisionChecker(collision_body(model), model.floor_m)
    return bool(space.collision_free(np.array([[joints[name] for name in model.chain.names]]))[0])


def _between(joint, fraction):
    lower, upper = joint.limits.lower.value, joint.limits.upper.value
    lower, upper = max(lower, -3.0), min(upper, 3.0)
    return lower + fraction * (upper - lower)
