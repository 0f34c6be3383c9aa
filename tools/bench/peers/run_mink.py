"""mink: quadratic programs over MuJoCo's kinematics, repeated until the frame arrives."""

# The package is not installed where types are checked, but in an environment of its own.
# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false

from __future__ import annotations

import mink
import mujoco
import numpy as np
from protocol import Array, CannotError, Problem, Solve, Tried, restarting, serve

_ITERATIONS = 30


def prepare(problem: Problem) -> Solve:
    """Keep the tip as a body of its own; a direction is an orientation without its third axis."""
    if problem.kind == "direction" and tuple(problem.tool_axis) != (0, 0, 1):
        raise CannotError("only directions of z")
    spec = mujoco.MjSpec.from_file(problem.urdf)
    spec.compiler.fusestatic = False
    model = spec.compile()
    places = [model.jnt_qposadr[model.joint(name).id] for name in problem.joints]
    turn = {"position": [0.0] * 3, "direction": [1.0, 1.0, 0.0], "pose": [1.0] * 3}[problem.kind]
    task = mink.FrameTask(problem.tip, "body", position_cost=1.0, orientation_cost=turn)
    limits = [mink.ConfigurationLimit(model)]
    configuration, rest = mink.Configuration(model), np.zeros(model.nq)

    def once(T: Array, q0: Array) -> Tried:
        rest[places] = q0
        configuration.update(rest)
        task.set_target(mink.SE3.from_matrix(T))
        for _ in range(_ITERATIONS):
            off = task.compute_error(configuration)
            met = np.linalg.norm(off[:3]) < problem.position_m
            if met and np.linalg.norm(off[3:] * turn) < problem.angle_rad:
                return configuration.q[places].copy(), True
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
        return configuration.q[places].copy(), False

    return restarting(once, problem)


if __name__ == "__main__":
    serve("mink", prepare)
