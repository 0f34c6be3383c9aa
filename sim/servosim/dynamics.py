"""The body that the servos move: free joints, or an arm under gravity with its tip."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from servosim.contact import Contacts
from servosim.errors import ArmFileError, SimulatorError
from servosim.mass_tree import LocalDynamics, MassTree, MimicDrive
from servosim.specimen import Specimen
from servosim.urdf import Matrix, MovingJoint, read_joints, read_link_frame, read_shapes

NEAR_M = 1e-5  # tolerance of the tip; a servo's tick moves the tip ten times as far
ITERATIONS = 200
DAMPING_M = 0.01  # damping of least squares: keeps steps short near singularities
LONGEST_STEP = 0.2  # rad, or m: slopes are not valid further away
BALANCE_STEPS = 6  # number of steps; each leaves a tenth of the error
# Range in which an expansion of the dynamics is used. The error of gravity grows with its square.
NEAR_RAD, NEAR_SLIDE_M = 0.03, 0.003


class Tip:
    """The origin of a link, which the joints between it and the base move.

    Args:
        joints: The arm's moving joints, as in its URDF.
        driven: The index of the position that moves each joint.
        tree: The frames of the joints.
        parent: Index of the moving joint behind which the link is fixed, -1 at the base.
        T_joint_link: The link's frame (4, 4) in the frame of that joint.
        limits: Lower and upper limit of each position [rad or m].
        link_positions: Returns the positions of links that yield to gravity, from positions at the
            sensors.
    """

    def __init__(
        self,
        joints: Sequence[MovingJoint],
        driven: Sequence[MimicDrive],
        tree: MassTree,
        parent: int,
        T_joint_link: Matrix,
        limits: Sequence[tuple[float, float]],
        link_positions: Callable[[Sequence[float]], Sequence[float]],
    ) -> None:
        self.link_positions = link_positions
        self._joints, self._driven, self._tree = joints, driven, tree
        self._parent, self._frame, self._offset_m = parent, T_joint_link, T_joint_link[:3, 3]
        self._lower, self._upper = np.array(limits).T
        self._chain: list[int] = []
        while parent >= 0:
            self._chain.append(parent)
            parent = joints[parent].parent
        self.moved_by = frozenset(driven[i].driver for i in self._chain) - {-1}

    def position_m(self, positions: Sequence[float]) -> Matrix:
        """Return the position of the tip (3,), base frame."""
        return self._origin_m(self._tree.frames(self.link_positions(positions)))

    def pose(self, positions: Sequence[float]) -> Matrix:
        """Return the link's frame (4, 4) in the base frame."""
        frames = self._tree.frames(self.link_positions(positions))
        T = np.eye(4)
        T[:3] = (np.eye(4) if self._parent < 0 else frames[self._parent])[:3]
        return T @ self._frame

    def posture_at(self, point_m: Sequence[float], start: Sequence[float]) -> list[float]:
        """Return positions inside the limits with the tip at a point, near to those at the start.

        If limits block the search from the start, it begins again in the middle of the
        joints' ranges.

        Args:
            point_m: The point, base frame.
            start: The positions to search from.

        Raises:
            SimulatorError: No posture was found, because the point is out of reach.
        """
        goal_m, shortest_m = np.array(point_m), math.inf
        for q in (np.array(start, dtype=float), self._middle()):
            found, short_m = self._search(goal_m, self._inside(q))
            if short_m < NEAR_M:
                return found.tolist()
            shortest_m = min(shortest_m, short_m)
        place = ", ".join(f"{x:.3f}" for x in point_m)
        short = f"it stops {1000 * shortest_m:.1f} mm short"
        raise SimulatorError(f"the tip cannot be moved to ({place}) m; {short}")

    def _search(self, goal_m: Matrix, q: Matrix) -> tuple[Matrix, float]:
        """Search for positions by damped least squares; return them and the error of the tip.

        Wampler 1986; a joint at a limit is left out of steps that would push it further.
        """
        for _ in range(ITERATIONS):
            frames = self._tree.frames(self.link_positions(q.tolist()))
            gap_m = goal_m - self._origin_m(frames)
            if float(np.linalg.norm(gap_m)) < NEAR_M:
                break
            q = self._inside(q + self._step(q, self._slopes(frames), gap_m))
        return q, float(np.linalg.norm(goal_m - self.position_m(q.tolist())))

    def _middle(self) -> Matrix:
        """Compute the middle of each range; zero if a joint has no limits."""
        bounded = np.isfinite(self._lower) & np.isfinite(self._upper)
        middle = np.zeros(len(bounded))
        middle[bounded] = (self._lower[bounded] + self._upper[bounded]) / 2.0
        return middle

    def _origin_m(self, frames: Matrix) -> Matrix:
        if self._parent < 0:
            return self._offset_m
        T = frames[self._parent]
        return T[:3, :3] @ self._offset_m + T[:3, 3]

    def _slopes(self, frames: Matrix) -> Matrix:
        """Compute the derivative of the tip with respect to each position (3, n)."""
        tip_m, J = self._origin_m(frames), np.zeros((3, len(self._lower)))
        for i in self._chain:
            driver, multiplier, _ = self._driven[i]
            axis, origin_m = frames[i, :3, 2], frames[i, :3, 3]
            moved = axis if self._joints[i].sliding else np.cross(axis, tip_m - origin_m)
            if driver >= 0:
                J[:, driver] += multiplier * moved
        return J

    def _step(self, q: Matrix, J: Matrix, gap_m: Matrix) -> Matrix:
        step = _least_squares(J, gap_m)
        outward = ((q <= self._lower) & (step < 0.0)) | ((q >= self._upper) & (step > 0.0))
        if outward.any():
            step = _least_squares(np.where(outward, 0.0, J), gap_m)
        return step / max(1.0, float(np.abs(step).max()) / LONGEST_STEP)

    def _inside(self, q: Matrix) -> Matrix:
        return np.clip(q, self._lower, self._upper)


def _least_squares(J: Matrix, gap_m: Matrix) -> Matrix:
    """Compute the step (n,) for a gap (3,); the damping shrinks with the gap."""
    damping_m = min(DAMPING_M, float(np.linalg.norm(gap_m)))
    return J.T @ np.linalg.solve(J @ J.T + damping_m**2 * np.eye(3), gap_m)


class Dynamics(Protocol):
    """Joints with limits, their external torque, and their inertia.

    Positions are in the joints' own units: rad and N m, on sliding joints m and N.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """The joints, in the order of every list below."""
        ...

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper limit of each joint."""
        ...

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Return the torque (force) on each joint, velocity forces included; positive forward."""
        ...

    def mass_matrix(self, positions: Sequence[float]) -> list[list[float]]:
        """Return the mass matrix, without the motors [kg m², on sliding joints kg]."""
        ...


class FreeBody:
    """Joints without a load: servos on a bench."""

    def __init__(
        self, names: Sequence[str], limits: Sequence[tuple[float, float]] | None = None
    ) -> None:
        self.names = tuple(names)
        self.limits = tuple(limits or [(-math.inf, math.inf)] * len(self.names))
        self._nothing = [0.0] * len(self.names)
        self._massless = [self._nothing] * len(self.names)

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Return no load."""
        return self._nothing

    def mass_matrix(self, positions: Sequence[float]) -> list[list[float]]:
        """Return a zero mass matrix."""
        return self._massless


class RigidArm:
    """An arm read from its URDF, its base on a level table.

    The full dynamics of any tree of revolute and prismatic joints, mimic joints included: mass
    matrix, Coriolis and centrifugal forces, gravity. They are computed exactly at a posture and
    expanded about it until the arm has left it by `NEAR_RAD`.

    Args:
        urdf_path: The arm.
        joint_names: The joints that servos move; others rest at zero, or at the nearest limit.
        specimen: Masses that differ from the URDF's, and a payload.
        tip: The link that holds the payload; empty if there is none.
        base: The pose of the base, see `base_pose`.

    Raises:
        ArmFileError: The file is not a usable URDF, or lacks one of the joints or the tip.
        SimulatorError: There is a payload but no tip to hold it.
    """

    def __init__(
        self,
        urdf_path: str | Path,
        joint_names: Sequence[str],
        specimen: Specimen | None = None,
        tip: str = "",
        base: str = "",
    ) -> None:
        self.names = tuple(joint_names)
        joints = read_joints(Path(urdf_path), base)
        if specimen is not None and specimen.changes_masses:
            frame = read_link_frame(Path(urdf_path), tip, base) if tip else None
            joints = specimen.scaled_joints(joints, frame)
        by_name = {joint.name: joint for joint in joints}
        for name in self.names:
            if name not in by_name:
                known = ", ".join(by_name)
                raise ArmFileError(Path(urdf_path), "", f"no moving joint {name!r}; has: {known}")
        self.limits = tuple((by_name[name].lower, by_name[name].upper) for name in self.names)
        self._joints, self._path, self._base = joints, Path(urdf_path), base
        self._drivers = [self._make_mimic_drive(joint) for joint in joints]
        self._tree = MassTree(joints, self._drivers, len(self.names))
        self._reach = [NEAR_SLIDE_M if by_name[n].sliding else NEAR_RAD for n in self.names]
        yields = Specimen().compliances if specimen is None else specimen.compliances
        self._compliance = np.array([yields.get(name, 0.0) for name in self.names])
        self._centre: tuple[float, ...] = ()
        self._local: LocalDynamics | None = None

    def load_nm(self, positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
        """Return the torque (force) of gravity and of the velocities on each joint."""
        links = self.link_positions(positions)
        return self._near(links).load_at(np.array(links), np.array(velocities)).tolist()

    def link_positions(self, positions: Sequence[float]) -> Sequence[float]:
        """Compute the positions of links that yield to gravity, from positions at the sensors.

        The load is evaluated at the link positions: ``link = position + compliance load(link)``.
        """
        if not self._compliance.any():
            return positions
        sensed = links = np.array(positions)
        for _ in range(BALANCE_STEPS):
            load = self._near(links.tolist()).load_at(links, np.zeros(len(links)))
            links = sensed + self._compliance * load
        return links.tolist()

    def mass_matrix(self, positions: Sequence[float]) -> list[list[float]]:
        """Return the mass matrix, without the motors."""
        links = self.link_positions(positions)
        return self._near(links).mass_at(np.array(links)).tolist()

    def _near(self, positions: Sequence[float]) -> LocalDynamics:
        """Return the dynamics about a posture near this one."""
        if self._local is not None:
            for here, there, reach in zip(positions, self._centre, self._reach, strict=True):
                if not -reach <= here - there <= reach:
                    break
            else:
                return self._local
        self._centre = tuple(positions)
        self._local = self._tree.expand(positions)
        return self._local

    def contacts(self, floor_m: float | None, postures: Sequence[Sequence[float]]) -> Contacts:
        """Return the contacts of the arm for joints without torque; see `Contacts`.

        Args:
            floor_m: Height of the table in the base frame; None if there is no table.
            postures: Positions that are free of contact.
        """
        shapes = read_shapes(self._path, self._base)
        return Contacts(self._joints, self._drivers, shapes, self._tree, floor_m, postures)

    def tip(self, link: str) -> Tip:
        """Return the tip, which is the origin of a link.

        Raises:
            ArmFileError: There is no such link.
        """
        parent, T = read_link_frame(self._path, link, self._base)
        return Tip(
            self._joints,
            self._drivers,
            self._tree,
            parent,
            T,
            self.limits,
            self.link_positions,
        )

    def _make_mimic_drive(self, joint: MovingJoint) -> MimicDrive:
        if joint.name in self.names:
            return MimicDrive(self.names.index(joint.name), 1.0, 0.0)
        if joint.mimic in self.names:
            return MimicDrive(self.names.index(joint.mimic), joint.multiplier, joint.offset)
        return MimicDrive(-1, 0.0, min(joint.upper, max(joint.lower, 0.0)))
