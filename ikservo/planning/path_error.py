"""Path error of a Cartesian motion: measured tip compared with the commanded path."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ikservo.control.loop import ControlCycle
from ikservo.kinematics.arrays import IntMatrix, Matrix, Vector
from ikservo.motion import Trajectory
from ikservo.planning.planner import Planner

# Time between two samples of the commanded path: 0.06 mm of a circle of 5 cm at 0.25 m/s.
_STEP_S = 0.01
_LAG_S = 1.0  # the joints lag behind their goals by less than this time
_LEAD_S = 0.1  # a reading is older than its goal by less than this
_CHUNK = 2000  # number of points that are compared at a time, to bound memory


@dataclass(frozen=True, slots=True)
class PathDeviation:
    """The distance from the measured tip to the commanded path, over a motion's control cycles.

    Attributes:
        rms_m: The root mean square distance.
        max_m: The largest distance.
    """

    rms_m: float
    max_m: float


@dataclass(slots=True, eq=False)
class PathRecorder:
    """Recorder of the joint positions during a motion that ends with a Cartesian path.

    Args:
        trajectory: The motion of all joints.
        cartesian_s: Time at the end of the motion in which the tip follows the path; 0 for none.
    """

    trajectory: Trajectory
    cartesian_s: float
    _times_s: list[float] = field(default_factory=list[float], init=False)
    _joints: list[Vector] = field(default_factory=list[Vector], init=False)

    def record(self, cycle: ControlCycle) -> None:
        """Record the measurements of a control cycle, unless a joint did not reply."""
        if self.cartesian_s > 0.0 and cycle.time_s >= self._begin_s and not cycle.lost:
            self._times_s.append(cycle.time_s)
            self._joints.append(cycle.measured.copy())

    def error(self, planner: Planner) -> PathDeviation | None:
        """Return the path error; None if nothing was recorded."""
        if not self._times_s:
            return None
        count = 2 + math.ceil(self.cartesian_s / _STEP_S)
        times_s = np.linspace(self._begin_s, self.trajectory.duration_s, count)
        commanded = np.array([self.trajectory.state(at_s).position for at_s in times_s.tolist()])
        deviations_m = path_deviations_m(
            (np.array(self._times_s), planner.tips(np.array(self._joints))),
            (times_s, planner.tips(commanded)),
        )
        return PathDeviation(float(np.sqrt((deviations_m**2).mean())), float(deviations_m.max()))

    @property
    def _begin_s(self) -> float:
        return self.trajectory.duration_s - self.cartesian_s


def path_deviations_m(measured: tuple[Vector, Matrix], commanded: tuple[Vector, Matrix]) -> Vector:
    """Compute the distances (k,) [m] of measured points from a commanded path.

    The distance is to the nearest point of the part of the path that was commanded from one second
    before the measurement: as in ISO 9283, a lag along the path is not a path error; on a path that
    crosses itself, the other branch does not count. ``measured`` contains times (k,) [s] and points
    (k, 3) [m]; the commanded points are equally spaced in time.
    """
    times_s, points_m = measured
    steps_s, path_m = commanded
    step_s = float(steps_s[1] - steps_s[0])
    before, after = (math.ceil(span_s / step_s) for span_s in (_LAG_S, _LEAD_S))
    at = np.searchsorted(steps_s, times_s)
    windows = np.clip(at[:, None] + np.arange(-before, after), 0, len(path_m) - 2)
    parts = range(0, len(points_m), _CHUNK)
    found = [
        _distances_m(points_m[part : part + _CHUNK], path_m, windows[part : part + _CHUNK])
        for part in parts
    ]
    return np.concatenate(found)


def _distances_m(points_m: Matrix, path_m: Matrix, windows: IntMatrix) -> Vector:
    """Compute the distance (k,) from each point to the path segments in its window (k, w)."""
    begin, along = path_m[windows], np.diff(path_m, axis=0)[windows]
    apart = points_m[:, None, :] - begin
    length2 = np.maximum((along**2).sum(axis=2), 1e-300)
    fraction = np.clip((apart * along).sum(axis=2) / length2, 0.0, 1.0)
    distances: Vector = np.linalg.norm(apart - fraction[..., None] * along, axis=2)
    return distances.min(axis=1)
