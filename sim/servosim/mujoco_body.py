"""Bodies and contacts from MuJoCo (extra `physics`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from servosim.errors import ArmFileError
from servosim.parameters import MotorParameters

FRICTION_HOLDS = 0.9999  # MuJoCo's own 0.95 lets a joint without torque creep by degrees a second


class MujocoBody:
    """An arm on a floor in MuJoCo: all joints are coupled, links collide.

    It integrates the joints itself: a world passes the torques of the motors and sets the motors to
    the joints' state (`Motor.carried`, `Motor.set_state`). Dry and viscous friction, rotor
    inertia and the joint stops are MuJoCo's; play is left out.

    Args:
        urdf_path: The arm; masses, limits and collision shapes are used, visual shapes are not.
        joint_names: The joints that servos move.
        motors: The motors on each joint, for their friction and inertia.
        floor_m: Height of the floor in the base frame; None for no floor.
        stop_margins: How far past its limits the stops of each joint are [rad or m].

    Raises:
        ArmFileError: MuJoCo cannot use the file, or a joint is missing.
    """

    def __init__(
        self,
        urdf_path: str | Path,
        joint_names: Sequence[str],
        motors: Sequence[Sequence[MotorParameters]],
        floor_m: float | None = 0.0,
        stop_margins: Sequence[float] = (),
    ) -> None:
        self.names = tuple(joint_names)
        self._model = _compile_model(Path(urdf_path), floor_m)
        self._data = mujoco.MjData(self._model)
        try:
            ids = [self._model.joint(name).id for name in self.names]
        except KeyError as error:
            raise ArmFileError(Path(urdf_path), "", str(error)) from error
        self._qpos = np.array([self._model.jnt_qposadr[k] for k in ids], dtype=int)
        self._dof = np.array([self._model.jnt_dofadr[k] for k in ids], dtype=int)
        self.limits = tuple((float(lo), float(hi)) for lo, hi in self._model.jnt_range[ids])
        margins = np.array(stop_margins or [0.0] * len(ids))
        self._model.jnt_range[ids] += np.stack([-margins, margins], axis=1)
        solimp = self._model.dof_solimp  # pyright: ignore[reportAttributeAccessIssue, reportUnknownVariableType, reportUnknownMemberType] - tools/typings lacks it
        solimp[self._dof, :2] = FRICTION_HOLDS
        self._armature_kg_m2 = np.array([sum(m.armature_kg_m2 for m in on) for on in motors])
        self._damping_nm_s = np.array([sum(m.viscous_nm_s for m in on) for on in motors])
        self._friction_nm = np.array(
            [sum(m.friction_nm + m.stribeck_nm for m in on) for on in motors]
        )
        self._load_friction = np.array([on[0].load_friction + on[0].load_stribeck for on in motors])
        self._square_per_nm = np.array([on[0].load_square_per_nm / len(on) for on in motors])
        self._slopes: Sequence[float] = ()
        self.set_transmission_slopes([1.0] * len(ids))

    def place(self, positions: Sequence[float]) -> None:
        """Set the arm's positions, at rest."""
        self._data.qpos[self._qpos] = positions
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def set_transmission_slopes(self, slopes: Sequence[float]) -> None:
        """Apply the motors' inertia and friction to the joints through their transmissions.

        Args:
            slopes: Joint motion for one radian of each horn [rad or m].
        """
        if slopes == self._slopes:
            return
        self._slopes, ratio = slopes, np.abs(np.array(slopes))
        self._model.dof_armature[self._dof] = self._armature_kg_m2 / ratio**2
        self._model.dof_damping[self._dof] = self._damping_nm_s / ratio**2
        self._dry, self._square = self._friction_nm / ratio, self._square_per_nm * ratio

    def step(self, dt_s: float, torques: Sequence[float]) -> tuple[list[float], list[float]]:
        """Advance time under the motors' and hands' torques (forces on prismatic joints).

        Returns:
            Positions and velocities of the joints.
        """
        # The gears carry the motor's torque against gravity and what the other links do.
        gear = np.abs(np.asarray(torques) + self._data.qfrc_bias[self._dof])
        self._model.dof_frictionloss[self._dof] = self._dry + gear * (
            self._load_friction + self._square * gear
        )
        self._model.opt.timestep = dt_s
        self._data.qfrc_applied[self._dof] = torques
        mujoco.mj_step(self._model, self._data)
        return self._data.qpos[self._qpos].tolist(), self._data.qvel[self._dof].tolist()

    @property
    def contacts(self) -> int:
        """How many contacts there are at present."""
        return int(self._data.ncon)


def _compile_model(path: Path, floor_m: float | None) -> mujoco.MjModel:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = True
        spec.compiler.balanceinertia = True
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if floor_m is not None:
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(type=plane, size=(1.0, 1.0, 0.1), pos=(0.0, 0.0, floor_m))
        _exclude_contacts(spec, spec.worldbody)
        return spec.compile()
    except (ValueError, OSError) as error:
        raise ArmFileError(path, "", f"MuJoCo cannot use it ({error})") from error


def _exclude_contacts(spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> None:
    """Exclude contacts between links and the fixed links that carry them, which MuJoCo has."""
    for link in parent.bodies:
        spec.add_exclude(bodyname1=parent.name, bodyname2=link.name)
        if not link.joints:
            _exclude_contacts(spec, link)
