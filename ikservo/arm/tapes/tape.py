"""Recordings: measured joints in time, one JSON line a sample behind a header line.

::

    {"schema": "ikservo/recording/1", "arm": "so101", "joints": ["shoulder_pan", …],
     "units": ["rad", …], "period_s": 0.02}
    {"t_s": 0.0, "q": [0.0123, …]}
    {"t_s": 0.02, "q": [0.0123, …]}

Lines are whole as soon as they are written, so that a recording which was cut off keeps what it
had; a line that is not whole, or says anything else, is refused with its number.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from ikservo.arm.trajectory import Trajectory
from ikservo.errors import InputError
from ikservo.files.writing import FileWriteError
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["SCHEMA", "Heading", "Recorder", "Recording"]

SCHEMA = "ikservo/recording/1"
_PLACES = 6  # of a radian or a metre: a hundredth of a tick


@dataclass(frozen=True, slots=True)
class Heading:
    """What the columns of a recording are.

    Attributes:
        arm: The arm's name.
        joints: A name a column.
        units: ``rad`` or ``m``, likewise.
        period_s: How far samples are apart, as it was meant.
    """

    arm: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    period_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A whole recording.

    Attributes:
        heading: What its columns are.
        times_s: When each sample was taken (k,), growing.
        joints: Where the joints were (k, n), rad or m.
    """

    heading: Heading
    times_s: Vector
    joints: Matrix

    def trajectory(self) -> Trajectory:
        """Return the samples as a trajectory; velocities are differences of the positions."""
        several = len(self.times_s) > 1
        velocities = (
            np.gradient(self.joints, self.times_s, axis=0) if several else 0.0 * self.joints
        )
        heading = self.heading
        return Trajectory(heading.joints, heading.units, self.times_s, self.joints, velocities)

    def to_csv(self, path: Path | str | None = None, *, overwrite: bool = False) -> str:
        """Return the recording as CSV, and write it to a file where a path is given.

        Raises:
            InputError: The file exists and ``overwrite`` is false.
            FileWriteError: It cannot be written.
        """
        return self.trajectory().to_csv(path, overwrite=overwrite)

    def __repr__(self) -> str:
        """Return how many samples of which arm these are."""
        last_s = float(self.times_s[-1]) if len(self.times_s) else 0.0
        return f"Recording({len(self.times_s)} samples in {last_s:.3f} s of {self.heading.arm})"


class Recorder:
    """Writes a recording line by line.

    Args:
        path: A new file.
        heading: What its columns are.
        overwrite: Whether a file that is there may be lost.

    Raises:
        InputError: The file exists and ``overwrite`` is false.
        FileWriteError: It cannot be written.
    """

    def __init__(self, path: Path | str, heading: Heading, *, overwrite: bool = False) -> None:
        self.path, self.samples = Path(path), 0
        self._file = self._opened(overwrite=overwrite)
        self._say({"schema": SCHEMA, "arm": heading.arm, "joints": heading.joints,
                   "units": heading.units, "period_s": heading.period_s})  # fmt: skip

    def see(self, time_s: float, joints: Vector) -> None:
        """Write one sample: seconds since the first, and the joints (n,), rad or m.

        Raises:
            FileWriteError: The disk will not take it.
        """
        q = [round(float(x), _PLACES) for x in joints]
        self._say({"t_s": round(time_s, _PLACES), "q": q})
        self.samples += 1

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _opened(self, *, overwrite: bool) -> IO[str]:
        try:
            return self.path.open("w" if overwrite else "x", encoding="utf-8", newline="\n")
        except FileExistsError:
            raise InputError(f"File {self.path} exists; use --overwrite.") from None
        except (OSError, ValueError) as error:
            raise FileWriteError(self.path, _why(error)) from error

    def _say(self, row: dict[str, object]) -> None:
        try:
            self._file.write(json.dumps(row, allow_nan=False) + "\n")
            self._file.flush()
        except OSError as error:
            raise FileWriteError(self.path, _why(error)) from error


def _why(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else "") or str(error)
