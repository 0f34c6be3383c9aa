"""The data that every function of an arm uses: model, chain, servos, planner, collision."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ikservo.control.loop import ControlCycle, OnCycle
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import RefusedError
from ikservo.guard import CollisionChecker, sample_line, sample_path
from ikservo.hardware.port import Port
from ikservo.hardware.port_names import serial_number_of
from ikservo.ik import Solver
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Matrix, Vector, read_only
from ikservo.model import Model
from ikservo.motion import RuckigMotion, Trajectory
from ikservo.planning.calibrated_arm import ZeroSource
from ikservo.planning.planner import Planner
from ikservo.planning.reports import MotionProgress, OnProgress
from ikservo.planning.surroundings import Surroundings

# A part of the arm that is nearer to something than this counts as lying on it.
_CONTACT_M = 0.005
_JAW_TOUCH_M = 0.004  # omx_f's jaws need 2.9 mm where its arm has sunk out of its rest pose


@dataclass(frozen=True, slots=True, eq=False)
class ArmContext:
    """The parts of an arm that functions need, together with a ``MotionRunner``.

    Attributes:
        model: The arm's model.
        chain: The joints from base to tip, with this arm's limits.
        servos: The servos of the arm.
        port: The serial port of the servos.
        planner: Plans motions without reading a servo.
        surroundings: The surroundings of the arm.
        zeros: The source of the joint zeros.
        index: The columns of the joints in a vector of all joints (n,).
        serial_number: The serial number of the USB adapter; empty if there is none.
    """

    model: Model
    chain: Chain
    servos: ServoGroup
    port: Port
    planner: Planner
    surroundings: Surroundings
    zeros: ZeroSource
    index: JointIndex
    serial_number: str

    @classmethod
    def build(
        cls,
        model: Model,
        chain: Chain,
        servos: ServoGroup,
        port: Port,
        collision: CollisionChecker | None = None,
        zeros: ZeroSource = ZeroSource.SIMULATED,
    ) -> ArmContext:
        """Build the context of an arm on an open port."""
        with_gripper = collision is not None and collision.dof > chain.dof
        gripper = model.gripper.joint if model.gripper and with_gripper else None
        index = JointIndex.from_names(servos.names, chain.names, gripper)
        return cls(
            model=model,
            chain=chain,
            servos=servos,
            port=port,
            planner=Planner(model, chain, index),
            surroundings=Surroundings(collision),
            zeros=zeros,
            index=index,
            serial_number=serial_number_of(port.name),
        )

    def at_present(self) -> ArmContext:
        """Return the context with a snapshot of the arm's present surroundings.

        Raises:
            RefusedError: Another arm in reach is moving, or its position is unknown.
        """
        self.surroundings.look()
        around = self.surroundings
        return replace(self, surroundings=Surroundings(around.checker, contacts=around.contacts))

    @property
    def collision(self) -> CollisionChecker | None:
        """The checker for paths of the body; None if paths are not checked."""
        return self.surroundings.checker

    @property
    def checked_collision(self) -> CollisionChecker | None:
        """The checker for paths of the body; None if paths are not checked or positions unknown."""
        return self.collision if self.zeros.are_known else None

    def now_s(self) -> float:
        """Return the time of the port's clock."""
        return self.servos.clock.now_s()

    def require_zeros(self) -> None:
        """Refuse a motion that needs calibrated joint positions.

        Raises:
            CalibrationError: The arm is not calibrated.
        """
        self.zeros.require_known(self.model.name)

    def limits(self) -> tuple[Vector, Vector]:
        """Return the lowest and highest positions (n,), at whole ticks; read-only arrays."""
        low, high = zip(
            *(driven.position_range for driven in self.servos.driven_joints), strict=True
        )
        return read_only(low), read_only(high)

    def progress(self, cycle: ControlCycle) -> MotionProgress:
        """Return the progress of a motion in one control cycle."""
        return MotionProgress(
            cycle.time_s,
            cycle.duration_s,
            self.planner.tip(cycle.measured),
            cycle.measured.copy(),
            cycle.reference.copy(),
            self.servos.names,
        )

    def progress_reporter(self, on_progress: OnProgress | None) -> OnCycle | None:
        """Return a control-loop callback that reports to ``on_progress``; None if that is None."""
        return on_progress and (lambda cycle: on_progress(self.progress(cycle)))

    def warm_up(self) -> None:
        """Load the code for solving and checking, which would delay a control loop later."""
        q = self.chain.clip(np.zeros(self.chain.dof))
        Solver(self.chain, "position").track(self.chain.forward(q), q)
        if self.collision is not None:
            joints = np.zeros(self.collision.dof)
            with suppress(RefusedError):
                self.collision.check_path([joints, joints])

    def clearance_m(self, joints: Vector) -> float:
        """Compute the smallest distance [m] between parts of the arm, or to the table or a box.

        The distance is infinite if paths are not checked or positions are unknown.
        """
        checker = self.checked_collision
        if checker is None:
            return math.inf
        return float(checker.distances([self.index.body_joints(joints)]).min())

    def is_in_contact(
        self, joints: Vector, load: float = 1.0, distance_m: float = _CONTACT_M
    ) -> bool:
        """Check whether the body touches, or nearly touches, itself, the table or a box.

        An arm that would touch if it sagged under ``load`` times gravity also counts, and so does a
        pair within ``distance_m``.
        """
        if self.checked_collision is None:
            return False
        body = self.index.body_joints(joints)[None]
        return float(self.checked_collision.distances_with_sag(body, load).min()) < distance_m

    def nearest_free_joints(self, joints: Vector) -> Vector | None:
        """Find joints (n,) near ``joints`` (n,) at which the body touches nothing.

        The gripper, which may hold something, keeps its position.

        Returns:
            The joints; None if no step frees the arm, or if paths are not checked.
        """
        checker = self.checked_collision
        if checker is None:
            return None
        lower, upper = (
            self.index.body_joints(self.index.with_chain(joints, self.index.chain_joints(limit)))
            for limit in self.limits()
        )
        from ikservo.guard.nearest_free_posture import nearest_free_posture  # noqa: PLC0415

        q = nearest_free_posture(checker, self.index.body_joints(joints), lower, upper)
        return None if q is None else self.index.with_chain(joints, q[: self.chain.dof])

    def check_streamed_path(self, trajectory: Trajectory, speed: str) -> float:
        """Check the path of a trajectory as it will be streamed.

        Returns:
            The minimum clearance of the body [m] on the path; see ``clearance_m``.

        Raises:
            RefusedError: The arm would touch something.
        """
        if self.checked_collision is None:
            return math.inf
        path = self.index.body_joints(self.planner.sample_trajectory(trajectory, speed))
        return self.checked_collision.check_path(
            path, self.planner.dynamic_load_factor(speed), began_m=self.contacts_began_m()
        )

    def check_piece(self, running: Trajectory, from_s: float, until_s: float, speed: str) -> None:
        """Check a section of the path of a running trajectory in the present surroundings.

        Raises:
            CollisionError: The arm would touch something.
        """
        if self.checked_collision is not None:
            path = self.planner.sample_trajectory(running, speed, from_s, until_s)
            load_factor = self.planner.dynamic_load_factor(speed)
            self.checked_collision.check_path(self.index.body_joints(path), load_factor)

    def check_trajectory(self, move: RuckigMotion, rest: Vector) -> None:
        """Check an online trajectory that began at ``rest`` (n,), including braking and reversing.

        Raises:
            RefusedError: The arm would touch something.
        """
        if self.checked_collision is not None:
            path = sample_path(move.at, move.duration_s, move.top_speed)
            self.checked_collision.check_path(
                self.index.body_joints(path),
                rest=self.index.body_joints(rest),
                began_m=self.contacts_began_m(),
            )

    def check_straight_path(self, start: Vector, goal: Vector) -> None:
        """Check the straight path between two joint vectors (n,).

        Raises:
            RefusedError: The arm would touch something.
        """
        if self.checked_collision is not None:
            self.checked_collision.check_path(
                self.index.body_joints(self.interpolate_joints(start, goal)),
                began_m=self.contacts_began_m(),
            )

    def check_gripper_path(self, start: Vector, goal: Vector) -> None:
        """Check only the straight path of the jaws between two joint vectors (n,).

        The capsules are thicker than the jaws, and a limp arm may lie on its table and on itself.
        Jaws have little force and stop at obstacles; therefore, small overlaps are allowed, and
        present contacts of other links do not prevent a motion of the jaws.

        Raises:
            RefusedError: The arm would touch something.
        """
        checker = self.checked_collision
        if checker is None:
            return
        samples = list(self.index.body_joints(self.interpolate_joints(start, goal)))
        distance_m = checker.distances(samples)
        touch_m = [0.0 if thing in checker.things else -_JAW_TOUCH_M for _, thing in checker.pairs]
        if (distance_m < np.minimum(touch_m, distance_m[0])).any():
            checker.check_path(samples)

    def interpolate_joints(self, start: Vector, goal: Vector) -> Matrix:
        """Compute the straight path (k, n) between joints (n,), dense enough for checks."""
        return sample_line(start, goal, self.units_per_rad())

    def units_per_rad(self) -> Vector:
        """Return the motion of each joint (n,) per radian of its servo's horn, rad or m."""
        joints = [self.model.joint(name) for name in self.servos.names]
        return np.array([joint.travel_per_turn / math.tau for joint in joints])

    def note_contacts(self, joints: Vector) -> None:
        """Record the contacts of the resting body at joints (n,), before a motion."""
        if self.checked_collision is not None:
            self.surroundings.note_contacts(self.index.body_joints(joints))

    def contacts_began_m(self) -> Vector | None:
        """Return the depths at which contacts began; None for a limp arm, which may sink."""
        return None if self.servos.torque.is_off else self.surroundings.contacts_began_m()
