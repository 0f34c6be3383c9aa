"""Bodies and contacts from MuJoCo (extra `physics`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from servosim.errors import ArmFileError
from servosim.joint import Hand
from servosim.motor import OUTPUT_INERTIA_KG_M2
from servosim.parameters import MotorParameters
from servosim.surroundings import COLOURS, CUBE_HALF_M, Cube
from servosim.urdf import MovingJoint, read_joints

Array = NDArray[np.float64]

PLAY_SOLREF = (0.002, 1.0)  # a flank stops the rotor in two steps, without a rebound
CUBE_KG = 0.03  # beech
CUBE_FRICTION = (1.0, 0.01, 0.0005)  # wood on printed jaws: sliding, about the normal, rolling
# MuJoCo's contacts yield more if the bodies are lighter: by default, geared fingers pass through a
# cube. With their own stiffness, which outweighs the cube's, they yield by 0.8 mm at 14 N.
FINGER_SOLIMP, FINGER_SOLMIX = (0.97, 0.995), 1e3
FORCE_RATIO = 20.0  # with less, a gripped cube creeps out of the jaws
NO_SLIP_ITERATIONS = 20  # without them, a gripped cube creeps by 0.3 mm/s, not 0.05
AT_REST_M_S = 0.002
FRICTION_HOLDS = 0.9999  # MuJoCo's default 0.95 lets limp joints creep by degrees per second


class MujocoBody:
    """An arm on a floor in MuJoCo: all joints are coupled, links collide.

    It integrates the joints itself: a world passes the torques of the motors and sets the motors to
    the joints' state (`Motor.carried`, `Motor.set_state`). Each joint has a second body, the rotors
    of its servos in the joint's own unit, and the backlash is a limit of their distance; dry and
    viscous friction of both, rotor inertia and the joint stops are MuJoCo's.

    Args:
        urdf_path: The arm; masses, limits and collision shapes are used, visual shapes are not.
        joint_names: The joints that servos move.
        motors: The motors on each joint, for their friction and inertia.
        floor_m: Height of the floor in the base frame; None if there is no floor.
        stop_margins: The distance of the stops of each joint from its limits [rad or m].
        cubes: Cubes on the floor, which the arm can push and grip.

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
        cubes: Sequence[Cube] = (),
    ) -> None:
        self.names = tuple(joint_names)
        self._model = _compile_model(Path(urdf_path), self.names, floor_m, cubes)
        self._data, self._scratch = mujoco.MjData(self._model), mujoco.MjData(self._model)
        try:
            ids = [self._model.joint(name).id for name in self.names]
        except KeyError as error:
            raise ArmFileError(Path(urdf_path), "", str(error)) from error
        self._qpos = np.array([self._model.jnt_qposadr[k] for k in ids], dtype=int)
        self._dof = np.array([self._model.jnt_dofadr[k] for k in ids], dtype=int)
        self.limits = tuple((float(lo), float(hi)) for lo, hi in self._model.jnt_range[ids])
        margins = np.array(stop_margins or [0.0] * len(ids))
        self._model.jnt_range[ids] += np.stack([-margins, margins], axis=1)
        solimp = self._model.dof_solimp
        solimp[self._dof, :2] = FRICTION_HOLDS
        rotors = [self._model.joint(_rotor(name)).id for name in self.names]
        self._rotor_qpos = np.array([self._model.jnt_qposadr[k] for k in rotors], dtype=int)
        self._rotor_dof = np.array([self._model.jnt_dofadr[k] for k in rotors], dtype=int)
        self._cubes = [self._model.body(cube.name).id for cube in cubes]
        speeds = [self._model.body_dofadr[k] + i for k in self._cubes for i in range(3)]
        self._cube_speeds = np.array(speeds, dtype=int)
        self._plays = np.array([self._model.tendon(_rotor(n)).id for n in self.names], dtype=int)
        solimp[self._rotor_dof, :2] = FRICTION_HOLDS

        def total(of: Callable[[MotorParameters], float]) -> Array:
            return np.array([sum(of(motor) for motor in on) for on in motors])

        self._armature_kg_m2 = total(lambda m: m.armature_kg_m2)
        self._damping_nm_s = total(lambda m: m.viscous_nm_s - m.output_viscous_nm_s)
        self._output_damping_nm_s = total(lambda m: m.output_viscous_nm_s)
        self._friction_nm = total(lambda m: m.friction_nm + m.stribeck_nm - m.output_friction_nm)
        self._output_friction_nm = total(lambda m: m.output_friction_nm)
        self._half_play_rad = np.array([on[0].backlash_rad / 2.0 for on in motors])
        self._load_friction = np.array([on[0].load_friction + on[0].load_stribeck for on in motors])
        self._square_per_nm = np.array([on[0].load_square_per_nm / len(on) for on in motors])
        self._slopes: Sequence[float] = ()
        self.set_transmission_slopes([1.0] * len(ids))

    def place(self, positions: Sequence[float]) -> None:
        """Set the arm's positions, at rest."""
        self._data.qpos[self._qpos] = self._data.qpos[self._rotor_qpos] = positions
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def set_transmission_slopes(self, slopes: Sequence[float]) -> None:
        """Apply the motors' inertia and friction to the joints through their transmissions.

        Args:
            slopes: Joint motion per radian of each horn [rad or m].
        """
        if slopes == self._slopes:
            return
        self._slopes, ratio = slopes, np.abs(np.array(slopes))
        self._model.dof_armature[self._dof] = OUTPUT_INERTIA_KG_M2 / ratio**2
        self._model.dof_armature[self._rotor_dof] = self._armature_kg_m2 / ratio**2
        self._model.dof_damping[self._rotor_dof] = self._damping_nm_s / ratio**2
        self._damping = self._output_damping_nm_s / ratio**2
        self._model.dof_frictionloss[self._dof] = self._output_friction_nm / ratio
        self._dry, self._square = self._friction_nm / ratio, self._square_per_nm * ratio
        half = self._half_play_rad * ratio
        self._model.tendon_range[self._plays] = np.stack([-half, half], axis=1)
        mujoco.mj_setConst(self._model, self._scratch)  # rescales constraints by the inertias

    def step(
        self, dt_s: float, torques: Sequence[float], hands: Mapping[int, Hand]
    ) -> list[tuple[float, float, float, float]]:
        """Advance time under the motors' torques (forces on prismatic joints) and hands, by joint.

        Returns:
            Position, velocity, lash and the rotors' velocity of each joint.
        """
        data, model = self._data, self._model
        # The gears carry the motor's torque against gravity and the forces of the other links.
        gear = np.abs(np.asarray(torques) + data.qfrc_bias[self._dof])
        model.dof_frictionloss[self._rotor_dof] = self._dry + gear * (
            self._load_friction + self._square * gear
        )
        model.opt.timestep = dt_s
        data.qfrc_applied[self._rotor_dof] = torques
        data.qfrc_applied[self._dof] = 0.0
        model.dof_damping[self._dof] = self._damping
        for k, hand in hands.items():
            dof = self._dof[k]
            velocity = float(data.qvel[dof])
            force = hand.force_at(velocity)
            if force == hand.resting - hand.damping * velocity:
                force = hand.resting
                model.dof_damping[dof] += hand.damping
            data.qfrc_applied[dof] = force
        mujoco.mj_step(model, data)
        q, v = data.qpos[self._qpos], data.qvel[self._dof]
        lash = q - data.qpos[self._rotor_qpos]
        states = (q, v, lash, data.qvel[self._rotor_dof])
        return list(zip(*(of.tolist() for of in states), strict=True))

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves except, perhaps, the arm."""
        return not bool((np.abs(self._data.qvel[self._cube_speeds]) > AT_REST_M_S).any())

    def cube_poses(self) -> list[Array]:
        """Return the poses of the cubes (4, 4), base frame, with the origins at their centres."""
        poses: list[Array] = []
        for k in self._cubes:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = self._data.xmat[k].reshape(3, 3), self._data.xpos[k]
            poses.append(T)
        return poses

    @property
    def contacts(self) -> int:
        """The present number of contacts."""
        return int(self._data.ncon)


def _rotor(name: str) -> str:
    return f"{name} rotor"


def _compile_model(
    path: Path, names: Sequence[str], floor_m: float | None, cubes: Sequence[Cube]
) -> mujoco.MjModel:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = True
        spec.compiler.balanceinertia = True
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if floor_m is not None:
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(type=plane, size=(1.0, 1.0, 0.1), pos=(0.0, 0.0, floor_m))
        _exclude_contacts(spec, spec.worldbody)
        for name in names:
            _add_rotor(spec, name)
        for gear in spec.equalities:
            gear.active = False  # of `<mimic>`
        for joint in read_joints(path):
            if joint.mimic != joint.name:
                _add_gear(spec, joint)
        for cube in cubes:
            _add_cube(spec, cube, floor_m or 0.0)
        return spec.compile()
    except (ValueError, OSError) as error:
        raise ArmFileError(path, "", f"MuJoCo cannot use it ({error})") from error


def _add_cube(spec: mujoco.MjSpec, cube: Cube, floor_m: float) -> None:
    """Add a cube on the floor, and solve contacts exactly enough for gripping by friction."""
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, FORCE_RATIO
    spec.option.noslip_iterations = NO_SLIP_ITERATIONS
    body = spec.worldbody.add_body(name=cube.name, pos=(cube.x_m, cube.y_m, floor_m + cube.half_m))
    body.add_freejoint(name=cube.name)
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(cube.half_m,) * 3,
        mass=CUBE_KG * (cube.half_m / CUBE_HALF_M) ** 3,
        friction=CUBE_FRICTION,
        condim=4,
        rgba=(*COLOURS[cube.colour], 1.0),
    )


def _exclude_contacts(spec: mujoco.MjSpec, parent: mujoco.MjsBody) -> None:
    """Exclude contacts between links and the fixed links that carry them."""
    for link in parent.bodies:
        spec.add_exclude(bodyname1=parent.name, bodyname2=link.name)
        if not link.joints:
            _exclude_contacts(spec, link)


def _add_gear(spec: mujoco.MjSpec, joint: MovingJoint) -> None:
    """Make a joint follow its leader under load (`<mimic>`), and stop only where its leader does.

    Old versions of MuJoCo ignore the element. The gear of others yields in proportion to the
    mobility of both joints, without their ratio: a cube would open the fingers of a light crank.
    """
    rod = spec.add_tendon(name=f"{joint.name} gear")
    rod.wrap_joint(joint.name, 1.0)
    rod.wrap_joint(joint.mimic, -joint.multiplier)
    gear = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_TENDON, objtype=mujoco.mjtObj.mjOBJ_TENDON, name1=rod.name
    )
    gear.data[0], gear.solref, gear.solimp[:2] = joint.offset, PLAY_SOLREF, FRICTION_HOLDS
    for body in spec.bodies:
        names = [each.name for each in body.joints]
        if joint.name in names:
            body.joints[names.index(joint.name)].limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if joint.name in names or joint.mimic in names:
            for shape in body.geoms:
                shape.solimp[:2], shape.solmix = FINGER_SOLIMP, FINGER_SOLMIX


def _add_rotor(spec: mujoco.MjSpec, name: str) -> None:
    """Add the rotors of a joint: a body that turns by itself, and the backlash as a limit."""
    rotor = spec.worldbody.add_body(name=_rotor(name), mass=1e-6, inertia=(1e-9, 1e-9, 1e-9))
    rotor.explicitinertial = True
    rotor.add_joint(name=_rotor(name), type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0.0, 0.0, 1.0))
    play = spec.add_tendon(name=_rotor(name), limited=True, range=(-1.0, 1.0))
    play.solref_limit, play.solimp_limit[:2] = PLAY_SOLREF, FRICTION_HOLDS
    play.wrap_joint(name, 1.0)
    play.wrap_joint(_rotor(name), -1.0)
