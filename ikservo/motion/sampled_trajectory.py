"""Sampled positions and velocities of all joints, and their export as CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.files.writing import write_atomic
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.motion import Trajectory

_MAX_SAMPLES = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SampledTrajectory(FrozenArrays):
    """Positions and velocities of all joints at k instants.

    Attributes:
        names: The joints, in the order of the columns (n).
        units: ``rad`` or ``m`` for each joint.
        times_s: The instants (k,), seconds since the start, increasing.
        positions: (k, n), rad or m.
        velocities: (k, n), rad/s or m/s.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    times_s: Vector
    positions: Matrix
    velocities: Matrix

    def __len__(self) -> int:
        """Return the number of instants."""
        return len(self.times_s)

    def __repr__(self) -> str:
        """Show the number of samples and the joints."""
        last_s = float(self.times_s[-1]) if len(self) else 0.0
        return f"Trajectory({len(self)} samples in {last_s:.3f} s of {', '.join(self.names)})"

    def joint(self, name: str) -> Vector:
        """Return the positions of one joint (k,), rad or m.

        Raises:
            UnknownNameError: There is no such joint.
        """
        if name not in self.names:
            raise UnknownNameError("joint", name, self.names)
        return self.positions[:, self.names.index(name)]

    def to_csv(self, path: Path | str | None = None, *, overwrite: bool = False) -> str:
        """Format the trajectory as CSV; if a path is given, also write it to a file.

        The header names the columns with their units: ``t_s``, the positions
        (``elbow_flex_rad``), then the velocities (``elbow_flex_rad_s``).

        Raises:
            InputError: The file exists and ``overwrite`` is false.
            FileWriteError: The file cannot be written.
        """
        columns = [f"{name}_{unit}" for name, unit in zip(self.names, self.units, strict=True)]
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["t_s", *columns, *(f"{column}_s" for column in columns)])
        rows = np.column_stack([self.times_s, self.positions, self.velocities])
        writer.writerows([f"{value:.9g}" for value in row] for row in rows.tolist())
        text = stream.getvalue()
        if path is not None:
            file = Path(path)
            if file.exists() and not overwrite:
                raise InputError(f"{file} exists.", "Choose another file, or add overwrite=True.")
            write_atomic(file, text)
        return text


def sample_trajectory(
    trajectory: Trajectory, dt_s: float, names: tuple[str, ...], units: tuple[str, ...]
) -> SampledTrajectory:
    """Sample a trajectory at multiples of ``dt_s`` from its start, and at its end.

    Raises:
        BadValueError: ``dt_s`` is not above 0, or makes more than a million samples.
    """
    duration_s = trajectory.duration_s
    if not dt_s > 0.0 or duration_s / dt_s > _MAX_SAMPLES:
        expected = f"a time above 0 s that gives at most {_MAX_SAMPLES} samples in {duration_s:g} s"
        raise BadValueError("The time between two samples", f"{dt_s:g} s", expected)
    times_s = np.append(np.arange(0.0, duration_s * (1.0 - 1e-12), dt_s), duration_s)
    states = [trajectory.state(time_s) for time_s in times_s.tolist()]
    return SampledTrajectory(
        names=names,
        units=units,
        times_s=times_s,
        positions=np.array([state.position for state in states]),
        velocities=np.array([state.velocity for state in states]),
    )
