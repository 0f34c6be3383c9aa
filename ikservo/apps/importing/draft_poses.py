"""Search of a start pose for an arm: free, above the table, away from its limits."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.collision_body import CollisionBody
from ikservo.model import Model
from ikservo.model.collision_model import capsules_of

_TRIES, _BATCH = 600, 20
_ENOUGH_M, _SHARE, _SPREAD = 0.01, 0.5, 40
_CLEAR_M = 0.001
_STRAIGHT = 0.4  # fraction of the joints that are tried at zero
_MAX_RAD = 2.2  # a joint further from zero would be a surprising start


def propose_home(model: Model) -> dict[str, float]:
    """Return a start pose, rad or m by joint: the tool in front, with as much room as possible.

    The result is the same for the same arm.
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
    """Return the first of postures (n, dof) with room around the body, or the one with the most.

    Room is the distance from itself and the table, as far as each pair of links can have it.
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
    """Return the greatest height of the table at which no link touches it in every posture."""
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
    """Return the distances (n, pairs) of all pairs of links, and of links from the table."""
    return np.concatenate(
        [
            body.floor_distances(postures, model.floor_m or 0.0).gap_m,
            body.link_distances(postures).gap_m,
        ],
        axis=1,
    )
