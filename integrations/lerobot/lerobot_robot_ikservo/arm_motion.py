"""Send goals to an open arm at LeRobot's rate, and log the goals that it refuses."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

import ikservo
from ikservo.arm import DEAD_MAN_TIMEOUT_S, MotionProgress
from ikservo.arm.arm_protocol import GoalStream

__all__ = ["ArmMotion"]

Vector = NDArray[np.float64]

_LOG = logging.getLogger(__name__)
_FRESH_S = DEAD_MAN_TIMEOUT_S / 2  # after a goal, the control loop runs for longer than this
_QUIET_ACTIONS = 25  # time without a refusal after which the next one of its kind is logged
_LOST = (ikservo.PortLostError, ikservo.ServoSilentError)


class ArmMotion:
    """Sends goals to an arm and measures its joints.

    A refused goal, a stop and a servo alarm are logged when they begin; the arm keeps the previous
    goal, or holds. All other errors are raised: without its port, the arm cannot be measured
    either.

    Args:
        arm: An open arm; it stays open.
        speed: The speed class of the arm.
    """

    def __init__(self, arm: ikservo.OpenArm, speed: str) -> None:
        self._arm, self._speed = arm, speed
        self._stream: GoalStream | None = None
        self._open_stream = ExitStack()
        self._refused = 0
        self._sent_s = -np.inf
        self._quiet: dict[str, int] = {}

    def send(self, goal: Vector) -> Vector | None:
        """Send the goal of all joints (n,), rad or m.

        Returns:
            The goal (n,) in force; after a refusal, the previous goal; None if the arm holds.

        Raises:
            PortLostError, ServoSilentError: The arm can no longer be reached.
        """
        if self._arm.stopped_for:
            self._report("stopped", f"{self._arm.stopped_for} {_AFTER_STOP}")
            return None
        try:
            stream = self._streaming()
            stream.send(goal)
        except _LOST:
            raise
        except ikservo.IkservoError as error:
            self._drop_stream()
            self._report("error", str(error))
            return None
        self._sent_s = time.monotonic()
        self._report("error", "")
        return stream.kept if self._note_refusals(stream) else goal

    def measure(self) -> Vector:
        """Return the joints (n,), rad or m, as measured in the last control cycle or now."""
        progress = self._progress()
        return self._arm.where().positions_rad if progress is None else progress.joints_rad.copy()

    def setpoint(self) -> Vector:
        """Return the present setpoint of the joints (n,), or their position while nothing moves."""
        progress = self._progress()
        return self.measure() if progress is None else progress.setpoints_rad.copy()

    def report(self, text: str) -> None:
        """Log the reason why goals are changed, once it begins; an empty text ends it."""
        self._report("goal", text)

    def close(self) -> None:
        """Brake and hold."""
        try:
            self._open_stream.close()
        except ikservo.IkservoError as error:
            self._report("error", str(error))
        self._stream = None

    def _progress(self) -> MotionProgress | None:
        """Return the last control cycle; None if the control loop may have ended since."""
        is_fresh = time.monotonic() - self._sent_s < _FRESH_S
        return self._stream.progress if self._stream is not None and is_fresh else None

    def _streaming(self) -> GoalStream:
        if self._stream is None:
            self._stream = self._open_stream.enter_context(self._arm.stream(speed=self._speed))
            self._refused = 0
        return self._stream

    def _drop_stream(self) -> None:
        self._stream = None
        self.close()

    def _note_refusals(self, stream: GoalStream) -> bool:
        is_new = stream.refused > self._refused
        self._refused = stream.refused
        self._report("refused", stream.reason if is_new else "")
        return is_new

    def _report(self, kind: str, text: str) -> None:
        quiet = self._quiet.get(kind, 0)
        if text and not quiet:
            _LOG.warning("%s", text)
        self._quiet[kind] = _QUIET_ACTIONS if text else max(0, quiet - 1)


_AFTER_STOP = "The arm holds; actions are ignored until this command is restarted."
