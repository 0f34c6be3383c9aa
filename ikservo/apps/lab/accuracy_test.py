"""Test of accuracy and repeatability according to ISO 9283, with the arm's joint sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ikservo.apps.lab.iso9283 import (
    largest_drift,
    multidirectional_variation,
    path_accuracy,
    path_crossings,
    path_repeatability,
    pose_accuracy,
    pose_repeatability,
)
from ikservo.apps.lab.iso_cube import IsoCube, place_cube
from ikservo.arm import MotionProgress, OpenArm
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.planning.motions import MoveArc, MoveLine

PARTS = ("poses", "directions", "paths", "drift")
"""The parts of the test, in order."""

SPEEDS_PERCENT = (100, 50, 10)
STANDARD_CYCLES, STANDARD_PATH_CYCLES, STANDARD_DRIFT_S = 30, 10, 3600.0
"""Cycles and time for a complete test; the drift test of the standard itself takes eight hours."""

_DIRECTION_POSES = ("P1", "P2", "P4")
_APPROACH_OF_EDGE = 0.1
_PATH_POINTS = 50
# Fraction at each end of a path that is not evaluated, because an arm that lags may not cross it.
_ENDS = 0.08
_DRIFT_CYCLES = 10

OnStep = Callable[[str, float, float], None]
"""Callback after each cycle: name of the part, finished cycles, total cycles."""


@dataclass(frozen=True, slots=True)
class TestSettings:
    """Settings for the extent of the measurements.

    Attributes:
        cycles: Cycles of poses and directions.
        path_cycles: Cycles of each path at each speed.
        drift_s: The time for which drift is measured, by the port's clock.
        parts: The parts to measure, out of ``PARTS``.

    Raises:
        BadValueError: A number is too small.
        UnknownNameError: There is no such part.
    """

    cycles: int = STANDARD_CYCLES
    path_cycles: int = STANDARD_PATH_CYCLES
    drift_s: float = 300.0
    parts: tuple[str, ...] = PARTS

    def __post_init__(self) -> None:
        for what, count in (("cycles", self.cycles), ("cycles of a path", self.path_cycles)):
            if not 2 <= count <= 1000:
                raise BadValueError(f"The number of {what}", count, "a number from 2 to 1000")
        if not 0.0 < self.drift_s < math.inf:
            raise BadValueError(
                "The duration of the drift test", f"{self.drift_s:g} s", "more than 0 s"
            )
        for part in self.parts:
            if part not in PARTS:
                raise UnknownNameError("part of the test", part, PARTS)

    @property
    def is_standard(self) -> bool:
        """Whether the test has every part and at least the ``STANDARD_`` cycles and time."""
        return (
            self.cycles >= STANDARD_CYCLES
            and self.path_cycles >= STANDARD_PATH_CYCLES
            and self.drift_s >= STANDARD_DRIFT_S
            and set(self.parts) == set(PARTS)
        )


@dataclass(slots=True, eq=False)
class PoseResult:
    """The poses attained in the cycles of one commanded pose.

    Attributes:
        name: The name of the pose, P1 to P5.
        target_m: The commanded point (3,), metres, base frame.
        attained_m: The measured tip (3,) of each cycle.
    """

    name: str
    target_m: Vector
    attained_m: list[Vector] = field(default_factory=list[Vector])

    @property
    def ap_m(self) -> float:
        """Return the positioning accuracy AP_P."""
        return pose_accuracy(self.attained_m, self.target_m)

    @property
    def rp_m(self) -> float | None:
        """Return the positioning repeatability RP_l; None for a single cycle."""
        return pose_repeatability(self.attained_m) if len(self.attained_m) > 1 else None


@dataclass(slots=True, eq=False)
class DirectionResult:
    """The poses attained from different directions.

    Attributes:
        name: The pose.
        target_m: The commanded point (3,).
        attained_m: The measured tip (3,) of each cycle, for each direction.
    """

    name: str
    target_m: Vector
    attained_m: list[list[Vector]]

    @property
    def vap_m(self) -> float | None:
        """Return the variation vAP_P; None until all directions are measured."""
        if not all(self.attained_m):
            return None
        return multidirectional_variation([np.array(points) for points in self.attained_m])


@dataclass(slots=True, eq=False)
class PathResult:
    """The paths measured in the cycles of one commanded path at one speed.

    Attributes:
        shape: ``line`` or ``circle``.
        speed_percent: The percentage of the highest speed.
        tool_speed_m_s: The commanded speed of the tip.
        points_m: Points (m, 3) of the commanded path.
        attained_m: For each cycle, its crossings (m, 3) of the planes at these points.
    """

    shape: str
    speed_percent: int
    tool_speed_m_s: float
    points_m: Matrix
    attained_m: list[Matrix] = field(default_factory=list[Matrix])

    @property
    def at_m(self) -> float:
        """Return the path accuracy AT_P."""
        return path_accuracy(np.array(self.attained_m), self.points_m)

    @property
    def rt_m(self) -> float | None:
        """Return the path repeatability RT_P; None for a single cycle."""
        return path_repeatability(np.array(self.attained_m)) if len(self.attained_m) > 1 else None

    @property
    def deviations_m(self) -> Vector:
        """The distance (m,) between the mean path and the commanded path at each point."""
        mean = np.mean(self.attained_m, axis=0)
        return np.linalg.norm(mean - self.points_m, axis=1)


@dataclass(slots=True, eq=False)
class DriftResult:
    """Pose accuracy over time, by groups of cycles.

    Attributes:
        name: The pose.
        times_s: The end time of each group, counted from the beginning of the first group.
        groups: The groups.
    """

    name: str
    times_s: list[float] = field(default_factory=list[float])
    groups: list[PoseResult] = field(default_factory=list[PoseResult])

    @property
    def dap_m(self) -> float | None:
        """Return the drift of accuracy dAP_P; None for a single group."""
        accuracies = [group.ap_m for group in self.groups]
        return largest_drift(accuracies) if len(accuracies) > 1 else None

    @property
    def drp_m(self) -> float | None:
        """Return the drift of repeatability dRP_P; None for a single group."""
        found = [group.rp_m for group in self.groups]
        known = [value for value in found if value is not None]
        return largest_drift(known) if len(known) > 1 else None


class AccuracyTest:
    """Run of the test on an arm; the measurements are kept even if it is stopped.

    Args:
        arm: The open arm; it moves at the speed class ``fast``.
        settings: The extent of the measurements.
        on_step: Called after each cycle.

    Attributes:
        cube: The cube of the test.
        top_speed_m_s: Tip speed that counts as 100 %: the highest speed that the joints allow on
            both paths; 0 until known.
        poses: Pose accuracy and repeatability.
        directions: Multi-directional pose accuracy variation.
        paths: Path accuracy and repeatability.
        drift: Drift; None until measured.

    Raises:
        RefusedError: There is no free space for the test.
    """

    def __init__(self, arm: OpenArm, settings: TestSettings, on_step: OnStep | None = None) -> None:
        self._arm, self._settings = arm, settings
        self.on_step: OnStep = on_step or (lambda what, done, total: None)
        self.cube: IsoCube = place_cube(arm)
        self.top_speed_m_s = 0.0
        self.poses: list[PoseResult] = []
        self.directions: list[DirectionResult] = []
        self.paths: list[PathResult] = []
        self.drift: DriftResult | None = None

    def run(self) -> None:
        """Measure each part.

        Raises:
            StoppedError, KeyboardInterrupt: The test was stopped; measurements are kept.
            IkservoError: The arm cannot continue; see ``Arm``. Measurements are kept.
        """
        steps = {
            "poses": self._measure_poses,
            "directions": self._measure_directions,
            "paths": self._measure_paths,
            "drift": self._measure_drift,
        }
        with self._arm.background.requested():
            self._arm.pose("home")
            self._move_to(self.cube.center_m)
            for part in PARTS:
                if part in self._settings.parts:
                    steps[part]()

    def _measure_poses(self) -> None:
        """Move to P5 … P1 in each cycle; the first cycle is a rehearsal without results."""
        results = {name: PoseResult(name, at) for name, at in self.cube.poses_m.items()}
        for cycle in range(self._settings.cycles + 1):
            for name in reversed(results):
                attained = self._move_to(results[name].target_m)
                if cycle:
                    results[name].attained_m.append(attained)
            if cycle == 1:
                self.poses = list(results.values())
            self.on_step("pose accuracy and repeatability", cycle, self._settings.cycles)

    def _measure_directions(self) -> None:
        """Approach poses along the axes of the base frame, from inside the cube."""
        total = len(_DIRECTION_POSES) * self._settings.cycles
        for number, name in enumerate(_DIRECTION_POSES):
            target = self.cube.poses_m[name]
            # Starts (3,) of the approaches, relative to the pose, on the side of the centre.
            inwards = self.cube.center_m - target
            offsets = np.diag(np.copysign(_APPROACH_OF_EDGE * self.cube.edge_m, inwards))
            offsets = offsets[: 2 if self.cube.is_planar else 3]
            result = DirectionResult(name, target, [[] for _ in offsets])
            self.directions.append(result)
            for cycle in range(self._settings.cycles):
                for attained, offset in zip(result.attained_m, offsets, strict=True):
                    self._move_to(target + offset)
                    attained.append(self._arm.move_line(target, speed="fast").measured_tip_m)
                done = number * self._settings.cycles + cycle + 1
                self.on_step("multi-directional variation", done, total)

    def _measure_paths(self) -> None:
        total = len(SPEEDS_PERCENT) * 2 * self._settings.path_cycles
        tops: list[float] = []
        for shape in ("line", "circle"):
            self._move_to(self._path_start(shape))
            plan = self._arm.plan(self._path(shape, 1.0))
            tops.append(plan.tool_speed.top_m_s if plan.tool_speed else 0.0)
        self.top_speed_m_s = max(math.floor(1000.0 * min(tops)), 1.0) / 1000.0
        for percent in SPEEDS_PERCENT:
            speed_m_s = 0.01 * percent * self.top_speed_m_s
            for shape in ("line", "circle"):
                points, tangents = self._path_points(shape)
                result = PathResult(shape, percent, speed_m_s, points)
                for _ in range(self._settings.path_cycles):
                    measured = self._follow(shape, speed_m_s)
                    result.attained_m.append(path_crossings(measured, points, tangents))
                    if len(result.attained_m) == 1:
                        self.paths.append(result)
                    done = sum(len(path.attained_m) for path in self.paths)
                    self.on_step("path accuracy and repeatability", done, total)

    def _path(self, shape: str, tool_speed_m_s: float) -> MoveLine | MoveArc:
        cube = self.cube
        if shape == "line":
            return MoveLine(cube.poses_m["P4"], tool_speed_m_s=tool_speed_m_s, speed="fast")
        return MoveArc(center_m=cube.center_m, normal=cube.normal,
                       tool_speed_m_s=tool_speed_m_s, speed="fast")  # fmt: skip

    def _path_start(self, shape: str) -> Vector:
        return self.cube.poses_m["P2"] if shape == "line" else self.cube.circle_start_m

    def _path_points(self, shape: str) -> tuple[Matrix, Matrix]:
        """Compute points and unit tangents (m, 3) of a path."""
        fractions = np.linspace(_ENDS, 1.0 - _ENDS, _PATH_POINTS)[:, None]
        if shape == "line":
            begin, end = self.cube.poses_m["P2"], self.cube.poses_m["P4"]
            along = (end - begin) / np.linalg.norm(end - begin)
            return begin + fractions * (end - begin), np.tile(along, (_PATH_POINTS, 1))
        out = self.cube.circle_start_m - self.cube.center_m
        across, angle = np.cross(self.cube.normal, out), 2.0 * math.pi * fractions
        points = self.cube.center_m + np.cos(angle) * out + np.sin(angle) * across
        tangents = (np.cos(angle) * across - np.sin(angle) * out) / self.cube.radius_m
        return points, tangents

    def _follow(self, shape: str, speed_m_s: float) -> Matrix:
        """Follow a path once; return the measured tip (k, 3) in its control cycles."""
        self._move_to(self._path_start(shape))
        seen: list[Vector] = []

        def look(progress: MotionProgress) -> None:
            seen.append(progress.tip_m)

        self._arm.execute(self._path(shape, speed_m_s), look)
        return np.array(seen)

    def _measure_drift(self) -> None:
        """Move between P2 and P1 without a pause, and measure P1 in groups of ten cycles."""
        begin_s, poses = self._arm.clock.now_s(), self.cube.poses_m
        self.drift = drift = DriftResult("P1")
        elapsed_s = 0.0
        while elapsed_s < self._settings.drift_s:
            group = PoseResult("P1", poses["P1"])
            for _ in range(_DRIFT_CYCLES):
                self._move_to(poses["P2"])
                group.attained_m.append(self._move_to(poses["P1"]))
            elapsed_s = self._arm.clock.now_s() - begin_s
            drift.groups.append(group)
            drift.times_s.append(elapsed_s)
            done = min(elapsed_s, self._settings.drift_s)
            self.on_step("drift", round(done), round(self._settings.drift_s))

    def _move_to(self, point_m: Vector) -> Vector:
        return self._arm.move_to(point_m, speed="fast").measured_tip_m
