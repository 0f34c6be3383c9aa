"""Random IK problems: narrowed limits, reachable targets, dense searches to compare."""

import numpy as np

from ikservo.ik import Target, solve
from ikservo.ik.batch import solve_batch
from ikservo.model import load_model

TOOL_AXES = {"so100": (0, -1, 0), "so101": (0, 0, 1), "koch": (0, 0, 1)}
MIN_RANGE_RAD = 0.3


def tool_axis(name):
    """Return the axis that points out of the gripper."""
    return TOOL_AXES.get(name, (1, 0, 0))


def narrowed(chain, random):
    """Return the chain inside random limits, each range as wide as a calibration would leave."""
    a, b = random.uniform(chain.lower_rad, chain.upper_rad, (2, chain.dof))
    low, high = np.minimum(a, b), np.maximum(a, b)
    min_range = np.minimum(MIN_RANGE_RAD, chain.upper_rad - chain.lower_rad)
    high = np.maximum(high, np.minimum(low + min_range, chain.upper_rad))
    return chain.with_limits(np.minimum(low, high - min_range), high)


def missed_within_narrowed_limits(name, kind, limits, targets, seed=0):
    """Return the number of missed targets among limits * targets reachable ones; check limits."""
    model, random, missed = load_model(name), np.random.default_rng(seed), 0
    home = model.chain_pose("home")
    for _ in range(limits):
        chain = narrowed(model.chain, random)
        q = random.uniform(chain.lower_rad, chain.upper_rad, (targets, chain.dof))
        results = solve_batch(chain, chain.forward(q), home, kind=kind, tool_axis=tool_axis(name))
        assert (results.q >= chain.lower_rad).all()
        assert (results.q <= chain.upper_rad).all()
        missed += int((~results.reached).sum())
    return missed


def out_of_reach(name, random, *, narrow):
    """Return an arm, optionally with random limits, and a point (3,) [m] that it cannot reach."""
    chain = load_model(name).chain
    if narrow:
        chain = narrowed(chain, random)
    reach_m = np.abs(chain.forward(chain.mid_range())[:3, 3]).max() + 0.3
    while True:
        target_m = random.uniform(-reach_m, reach_m, 3)
        if not solve(chain, Target(target_m), method="bounded").reached:
            return chain, target_m


def points_out_of_reach(chain, count, random):
    """Return points (count, 3) [m] slightly out of an arm's reach."""
    points_m = np.zeros((0, 3))
    while len(points_m) < count:
        inside = random.uniform(chain.lower_rad, chain.upper_rad, (count, chain.dof))
        tried_m = chain.forward(inside)[:, :3, 3] + random.uniform(-0.3, 0.3, (count, 3))
        points_m = np.vstack([points_m, tried_m[~solve_batch(chain, tried_m).reached]])
    return points_m[:count]


def closest_of_many(chain, target_m, samples=20_000, iterations=6, seed=0):
    """Return the minimum distance to a point by dense sampling of joints, without gradients."""
    random = np.random.default_rng(seed)
    q = random.uniform(chain.lower_rad, chain.upper_rad, (samples, chain.dof))
    width = chain.upper_rad - chain.lower_rad
    for _ in range(iterations):
        gaps = np.linalg.norm(chain.forward(q)[:, :3, 3] - target_m, axis=1)
        best = q[np.argsort(gaps)[:50]]
        width = width / 4.0
        near = np.repeat(best, samples // 100, axis=0)
        q = np.vstack([best, chain.clip(near + random.uniform(-width, width, near.shape))])
    return float(np.linalg.norm(chain.forward(q)[:, :3, 3] - target_m, axis=1).min())
