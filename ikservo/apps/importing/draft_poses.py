"""Search for a start pose of an arm: collision-free, above the table, away from its limits."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.model import Model
from ikservo.model.collision_capsules import capsules_of

_TRIES, _BATCH = 600, 20  # number of postures to try, and to check at once
_ENOUGH_M = 0.01  # clearance of the body that suffices
_SHARE = 0.5  # fraction of a pair's largest clearance that suffices, if that is less
_SPREAD = 40  # postures that sample the clearance of each pair
_CLEAR_M = 0.001  # clearance between a link and the table in the link's highest posture
_STRAIGHT = 0.4  # fraction of the joints that are tried at zero
_MAX_RAD = 2.2  # largest distance of a joint from zero in a start pose


def propose_home(model: Model) -> dict[str, float]:
    """Propose a start pose, rad or m by joint: the tool in front, with much clearance.

    The search is seeded, so the same arm gets the same pose.
    """
    chain = model.chain
    rng = np.random.default_rng(1)
    low = np.maximum(chain.lower_rad, np.minimum(-_MAX_RAD, chain.upper_rad - 1e-3))
    high = np.minimum(chain.upper_rad, np.maximum(_MAX_RAD, low + 1e-3))
    tried = low + rng.beta(2.0, 2.0, (_TRIES, chain.dof)) * (high - low)
    zero = chain.clip(np.zeros(chain.dof))
    tried = np.where(rng.random(tried.shape) < _STRAIGHT, zero, tried)
    tried = np.concatenate([[zero, chain.mid_range()], tried])
    tips_m = chain.forward(tried)[:, :3, 3]
    reach_m = float(np.linalg.norm(tips_m, axis=1).max()) or 1.0
    margin = (np.minimum(tried - low, high - tried) / (high - low)).min(axis=1)
    ahead = -np.abs(tips_m[:, 0] / reach_m - 0.5) - np.abs(tips_m[:, 1] / reach_m)
    rated = ahead - 0.5 * np.abs(tips_m[:, 2] / reach_m - 0.3) + margin
    rated -= 0.5 * (np.abs(tried - zero) / (high - low)).mean(axis=1)
    best = _first_free(model, tried[np.argsort(-rated)])
    pose = dict(zip(chain.names, best.tolist(), strict=True))
    if model.gripper is not None:
        half = 0.5 * (model.gripper.closed + model.gripper.open)
        pose[model.gripper.joint] = half
    return pose


def _first_free(model: Model, postures: Matrix) -> Vector:
    """Return the first of the postures (n, dof) with enough clearance, or else the best of them.

    Clearance is the distance between the links and from the links to the table. A pair of links
    that is always close needs less of it.
    """
    capsules = capsules_of(model)
    if not capsules:
        return postures[0]
    body = CollisionBody(model.chain, capsules)
    spread = postures[:: max(1, len(postures) // _SPREAD)]
    enough_m = np.minimum(_gaps_m(model, body, spread).max(axis=0) * _SHARE, _ENOUGH_M)
    best, most_m = postures[0], -np.inf
    for first in range(0, len(postures), _BATCH):
        some = postures[first : first + _BATCH]
        left_m = (_gaps_m(model, body, some) - enough_m).min(axis=1)
        if left_m.max() >= 0.0:
            return some[int(np.flatnonzero(left_m >= 0.0)[0])]
        if left_m.max() > most_m:
            most_m, best = float(left_m.max()), some[int(left_m.argmax())]
    return best


def table_height_m(model: Model) -> float:
    """Return the greatest table height at which each link is above the table in some posture."""
    capsules = capsules_of(model)
    height_m = model.floor_m or 0.0
    if not capsules:
        return height_m
    chain = model.chain
    low, high = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    postures = low + np.random.default_rng(2).random((_SPREAD, chain.dof)) * (high - low)
    gap_m = CollisionBody(chain, capsules).floor_distances(postures, height_m).gap_m
    always_m = gap_m.max(axis=0, initial=-np.inf) - _CLEAR_M
    return height_m + min(0.0, float(always_m.min(initial=0.0)))


def _gaps_m(model: Model, body: CollisionBody, postures: Matrix) -> Matrix:
    """Return the distances (n, pairs) between all pairs of links, and from links to the table."""
    return np.concatenate(
        [
            body.floor_distances(postures, model.floor_m or 0.0).gap_m,
            body.link_distances(postures).gap_m,
        ],
        axis=1,
    )
