"""LeRobot's kinematics with ikservo's solver: converged, inside the limits, continuous."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo import Arm, Chain, Solver, load_model
from ikservo.ik import Options
from ikservo.kinematics.joints import JointType
from ikservo.planning.calibrated_arm import calibrated_model

__all__ = ["IkservoKinematics", "TipSolver"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_TOLERANCE_M = 1e-4
_PATH_M = 0.1  # a target further from the tip than this starts a new path
_STARTS = Options(restarts=32)
"""Number of starts of a search; 400 find no more than 32, but take a frame longer."""


class TipSolver:
    """Computes joints for poses of the tip, starting from the last joints.

    The position has priority; the orientation is met as well as joints and limits allow.

    Args:
        chain: The chain from base to tip, with the limits to observe.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self._pose, self._position = (
            Solver(chain, kind, options=_STARTS) for kind in ("pose", "position")
        )

    def solve(self, T_base_tip: Matrix, q: Vector, *, turn: bool = True) -> tuple[Vector, float]:
        """Return joints (dof,) from ``q`` (dof,), rad or m, and the error of the position [m].

        A target near the tip is tracked without a jump to another branch; if it cannot be reached,
        the tip moves as close to it as it can. ``turn`` tells whether the orientation counts.
        """
        solver = self._pose if turn else self._position
        found, reached = solver.track(T_base_tip, q)
        error_m = self._error_m(T_base_tip, found)
        if reached or error_m <= _TOLERANCE_M or self._error_m(T_base_tip, q) <= _PATH_M:
            return found, error_m
        return self._search(solver, T_base_tip, q, found)

    def _search(
        self, solver: Solver, T: Matrix, q: Vector, tracked: Vector
    ) -> tuple[Vector, float]:
        """Return the better result: the tracked joints, or a search over all branches."""
        searched, _ = solver(T, q)
        return min(((x, self._error_m(T, x)) for x in (tracked, searched)), key=lambda x: x[1])

    def _error_m(self, T: Matrix, q: Vector) -> float:
        return float(np.linalg.norm(self.chain.forward(q)[:3, 3] - T[:3, 3]))


class IkservoKinematics:
    """A replacement for LeRobot's kinematics in end-effector processors, without placo.

    Joints are in degrees (millimetres if prismatic), positions in metres in the base frame.

    Args:
        arm: An open arm, whose calibrated limits are observed; or a name in the catalogue or an arm
            file, with the limits from the newest calibration or else the arm file.
        joint_names: The order of the joint values; values of joints that do not move the tip, such
            as the gripper, stay unchanged. None: the joints of the chain, base to tip.

    Raises:
        ValueError: A joint of the chain is not in ``joint_names``.
    """

    def __init__(
        self, arm: Arm | str | Path = "so101", joint_names: Sequence[str] | None = None
    ) -> None:
        chain = arm.chain if isinstance(arm, Arm) else calibrated_model(load_model(arm)).model.chain
        self._solver = TipSolver(chain)
        self.joint_names = list(chain.names if joint_names is None else joint_names)
        self._columns = [self.joint_names.index(name) for name in chain.names]
        prismatic = [kind is JointType.PRISMATIC for kind in chain.kinds]
        self._scale = np.where(prismatic, 1e-3, np.pi / 180.0)

    def forward_kinematics(self, joint_pos_deg: ArrayLike) -> Matrix:
        """Return the pose of the tip, T_base_tip (4, 4), at joint values (n,)."""
        return self._solver.chain.forward(self._chain_joints(np.asarray(joint_pos_deg, float)))

    def inverse_kinematics(
        self,
        current_joint_pos: ArrayLike,
        desired_ee_pose: ArrayLike,
        position_weight: float = 1.0,
        orientation_weight: float = 0.01,
    ) -> Vector:
        """Return joint values (n,) that bring the tip to a pose (4, 4).

        The position always has priority. With ``orientation_weight`` 0, only the position counts;
        other weights make no difference. Values of joints outside the chain are returned unchanged.
        """
        del position_weight  # required by LeRobot's signature; the position has priority
        current = np.array(current_joint_pos, float)
        T = np.asarray(desired_ee_pose, float)
        q, _ = self._solver.solve(T, self._chain_joints(current), turn=orientation_weight > 0.0)
        current[self._columns] = q / self._scale
        return current

    def _chain_joints(self, values: Vector) -> Vector:
        return values[self._columns] * self._scale
