"""Straight lines that an arm can follow, tracked point by point."""

import numpy as np

from ikservo.ik import Solver
from ikservo.kinematics import distance_to_limits
from ikservo.model import load_model

POINTS, STEP_M, MIN_LEVER, NEAR_LIMIT_RAD = 100, 1e-3, 0.05, 0.05


def largest_step_on_lines(name, kind, lines, seed):
    """Return the largest joint step between neighbouring points 1 mm apart.

    Lines end where they leave the workspace or pass a posture that is singular without the joints
    at a limit, at which no small step would do.
    """
    chain, random, largest = load_model(name).chain, np.random.default_rng(seed), 0.0
    solver, followed = Solver(chain, kind), 0
    for _ in range(100 * lines):
        q = random.uniform(chain.lower_rad, chain.upper_rad)
        direction = random.normal(size=3) * (1.0 if chain.dof > 3 else np.array([1, 1, 0]))
        steps, whole = track_line(solver, chain, q, STEP_M * direction / np.linalg.norm(direction))
        largest, followed = max([largest, *steps]), followed + whole
        if followed == lines:
            break
    assert followed == lines
    return largest


def track_line(solver, chain, q, step_m):
    """Follow one line; return the steps, and whether it could be followed to its end."""
    T, steps = chain.forward(q), []
    for _ in range(POINTS):
        T[:3, 3] += step_m
        after, reached = solver.track(T, q)
        if not reached or min_lever(solver, chain, q, after) < MIN_LEVER:
            return steps, False
        steps.append(float(np.abs(after - q).max()))
        q = after
    return steps, True


def min_lever(solver, chain, q, after):
    """Return the tool's smallest motion per radian [m], without joints at their limits."""
    margin = np.minimum(distance_to_limits(chain, q), distance_to_limits(chain, after))
    rows = 6 if solver.kind == "pose" else 3 if chain.dof > 3 else 2
    J = chain.jacobian(q)[:rows, margin > NEAR_LIMIT_RAD]
    return np.linalg.svd(J, compute_uv=False)[rows - 1] if J.shape[1] >= rows else 0.0
