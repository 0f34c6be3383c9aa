"""Bodies and contacts from MuJoCo (extra `physics`) instead of independent joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from servosim.errors import ArmFileError
from servosim.parameters import MotorParameters

FRICTION_HOLDS = 0.9999  # MuJoCo's own 0.95 lets a limp joint creep by degrees a second


class MujocoBody:
    """An arm on a floor in MuJoCo: all joints pull at each other, links collide.

    It moves the joints itself: a world hands it the torques of the motors and carries the motors
    to where the joints went (`Motor.carried`, `Motor.carry`). Dry and viscous friction, rotor
    inertia and the joint stops are MuJoCo's; play is left out.

    Args:
        urdf_path: The arm; masses, limits and collision shapes are used, visual shapes are not.
        joint_names: The joints that servos move.
        motors: The motors on each joint, for their friction and inertia.
        floor_m: Height of the floor in the base frame; None for no floor.
        stop_margin: How far past each limit the joint's stop is [rad or m].

    Raises:
        ArmFileError: MuJoCo cannot use the file, or a joint is missing.
    """

    def __init__(
        self,
        urdf_path: str | Path,
        joint_names: Sequence[str],
        motors: Sequence[Sequence[MotorParameters]],
        floor_m: float | None = 0.0,
        stop_margin: float = 0.0,
    ) -> None:
        self.names = tuple(joint_names)
        self._model = _compile(Path(urdf_path), floor_m)
        self._data = mujoco.MjData(self._model)
        try:
            ids = [self._model.joint(name).id for name in self.names]
        except KeyError as error:
            raise ArmFileError(Path(urdf_path), "", str(error)) from error
        self._qpos = np.array([self._model.jnt_qposadr[k] for k in ids], dtype=int)
        self._dof = np.array([self._model.jnt_dofadr[k] for k in ids], dtype=int)
        self.limits = tuple((float(lo), float(hi)) for lo, hi in self._model.jnt_range[ids])
        self._model.jnt_range[ids] += (-stop_margin, stop_margin)
        for dof, on_joint in zip(self._dof, motors, strict=True):
            self._model.dof_armature[dof] = sum(m.armature_kg_m2 for m in on_joint)
            self._model.dof_damping[dof] = sum(m.viscous_damping_nm_s for m in on_joint)
            self._model.dof_frictionloss[dof] = sum(m.coulomb_friction_nm for m in on_joint)
            solimp = self._model.dof_solimp  # pyright: ignore[reportAttributeAccessIssue, reportUnknownVariableType, reportUnknownMemberType] - tools/typings lacks it
            solimp[dof, :2] = FRICTION_HOLDS

    def place(self, positions: Sequence[float]) -> None:
        """Put the arm somewhere, at rest."""
        self._data.qpos[self._qpos] = positions
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def step(self, dt_s: float, torques: Sequence[float]) -> tuple[list[float], list[float]]:
        """Let time pass under the motors' and hands' torques (forces on sliding joints).

        Returns:
            Positions and velocities of the joints.
        """
        self._model.opt.timestep = dt_s
        self._data.qfrc_applied[self._dof] = torques
        mujoco.mj_step(self._model, self._data)
        return self._data.qpos[self._qpos].tolist(), self._data.qvel[self._dof].tolist()

    @property
    def contacts(self) -> int:
        """How many contacts there are at present."""
        return int(self._data.ncon)


def _compile(path: Path, floor_m: float | None) -> mujoco.MjModel:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = True
        spec.compiler.balanceinertia = True
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if floor_m is not None:
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(type=plane, size=(1.0, 1.0, 0.1), pos=(0.0, 0.0, floor_m))
        return spec.compile()
    except (ValueError, OSError) as error:
        raise ArmFileError(path, "", f"MuJoCo cannot use it ({error})") from error
