"""The Jacobian transpose (lecture L11): the error as a force that pulls the tip.

A force F at the tip and the torques τ of joints that give way to it do the same virtual work,
``Fᵀ J dq = τᵀ dq``, hence ``τ = Jᵀ F``. Let the error pull: ``Δ = α Jᵀ E`` is steepest descent on
``|E|²``. It is cheap, never ends further from the target than it began, and slow, because it goes
as if all joints had the same lever.
"""

from __future__ import annotations

import numpy as np

from ikservo.ik.options import Options
from ikservo.ik.result import Result
from ikservo.ik.small_steps import downhill, iterate, small
from ikservo.ik.target import Target
from ikservo.ik.task import Local, Task, pressed
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["pull", "step_length", "transpose"]

_MAX_ITERATIONS = 2000


def transpose(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Follow the pull of the error from ``q0``, downhill all the way (lecture L11)."""
    task = Task(chain, target)

    def step(here: Local) -> Local:
        tau = pull(here, chain)
        return downhill(task, here, small(step_length(here.J, here.E, tau) * tau))

    return iterate("transpose", step, task, q0, options, _MAX_ITERATIONS)


def pull(here: Local, chain: Chain) -> Vector:
    """Return ``τ = Jᵀ E`` (dof,); a joint that is pulled against its limit stays there."""
    tau = here.J.T @ here.E
    return np.where(pressed(chain, here.q, tau), 0.0, tau)


def step_length(J: Matrix, E: Vector, tau: Vector) -> float:
    """Return the α that makes the linearised error ``|E - α J τ|`` smallest.

    ``α = (E · J τ) / |J τ|²``; zero where τ does not move the tip.
    """
    lift = J @ tau
    size = float(lift @ lift)
    return float(E @ lift) / size if size > 0.0 else 0.0
