"""Setpoints that a program pushes at its own rate; the control loop shapes them to the limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.background.mailbox import Mailbox
from ikservo.arm.background.motion import Motion
from ikservo.arm.given import joint_positions, number
from ikservo.arm.reports import Progress
from ikservo.arm.skills.following import follow
from ikservo.arm.skills.tracking import Wish
from ikservo.arm.skills.workings import Workings
from ikservo.errors import BadValueError, RefusedError, UnknownNameError
from ikservo.ik import Target
from ikservo.kinematics import finite_array
from ikservo.kinematics.numbers import numbers

__all__ = ["SetpointStream"]

_SLOWEST_HZ, _FASTEST_HZ = 5.0, 1000.0  # slower than the first is silence

T = TypeVar("T")


class _Start(Protocol):
    def __call__(self, work: Callable[[], None]) -> Motion[None]: ...


class SetpointStream:
    """Takes setpoints while its block runs; see ``Arm.stream``.

    Attributes:
        unreached: How many setpoints were out of reach; the arm went as near as it could.
        refused: How many the guard refused; the arm stayed with the one before.
        reason: Why the last of those was refused.
    """

    def __init__(self, arm: Workings, start: _Start, speed: str, rate_hz: float | None) -> None:
        self._arm, self._start, self._speed = arm, start, speed
        self._mailbox = Mailbox(arm.servos.clock, _period_s(rate_hz), lambda: self._ended)
        self._motion: Motion[None] | None = None
        self._progress: Progress | None = None
        self._told = False
        self.unreached = self.refused = 0
        self.reason = ""

    def __enter__(self) -> SetpointStream:
        """Begin to listen; the arm moves with the first setpoint.

        Raises:
            RefusedError: It was used before, or another stream is open.
        """
        if self._motion is not None:
            raise RefusedError("This stream was used before.", "Open another: arm.stream().")
        self._motion = self._start(self._run)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Brake and hold; raise what went wrong, unless the block raised an error itself."""
        self._mailbox.close()
        motion = self._running()
        if error is None and not self._told:
            motion.wait()
        else:
            motion.cancel()
            motion.join()

    def send(self, setpoint: Mapping[str, float] | ArrayLike | Target) -> None:
        """Go to a setpoint from now on; the newest one counts.

        It returns at once; with ``rate_hz``, once the next setpoint is due.

        Args:
            setpoint: Positions by joint, or of all joints (n,) in the order of ``names``, rad or m;
                a pose T_base_tip (4, 4); or a ``Target``, for a point
                ``Target((0.25, 0.0, 0.15))``. Positions outside the limits mean the limit.

        Raises:
            BadValueError: It is none of these, or a number is not finite.
            UnknownNameError: No such joint.
            StoppedError: The arm was stopped; it holds.
            IkservoError: Whatever ended the stream; the arm holds.
        """
        wanted = self._checked(setpoint)
        self._check_running()
        self._mailbox.put(wanted)
        self._check_running()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the joints, in the order of arrays (n,)."""
        return self._arm.servos.names

    @property
    def progress(self) -> Progress | None:
        """Return the last control cycle: measured joints, setpoints, tip; None before the first."""
        return self._progress

    @property
    def sent(self) -> int:
        """Return how many setpoints were sent."""
        return self._mailbox.put_count

    def __repr__(self) -> str:
        """Return how many setpoints were sent and refused."""
        state = "closed" if self._ended else "open"
        return f"SetpointStream({state}, {self.sent} sent, {self.refused} refused)"

    @property
    def _ended(self) -> bool:
        return self._motion is not None and self._motion.done

    def _run(self) -> None:
        """Follow setpoints; hold while none come."""
        self._arm.rehearse()
        while self._mailbox.await_first():
            report = follow(self._arm, self._mailbox.setpoints(), self._speed, self._note)
            self.unreached += report.unreached
            self.refused += report.refused
            self.reason = report.reason or self.reason

    def _note(self, progress: Progress) -> None:
        self._progress = progress

    def _running(self) -> Motion[None]:
        if self._motion is None:
            raise RefusedError("The stream is not open.", "Open it: with arm.stream() as stream:")
        return self._motion

    def _check_running(self) -> None:
        motion = self._running()
        if motion.done:
            self._told = True  # once is enough for a program that handles it
            motion.wait()
            raise RefusedError("The stream is closed.", "Open another: arm.stream().")

    def _checked(self, setpoint: object) -> Wish:
        if isinstance(setpoint, Target):
            return setpoint
        if isinstance(setpoint, Mapping):
            return self._by_name(setpoint)  # pyright: ignore[reportUnknownArgumentType]
        array = numbers(setpoint, "The setpoint", self._expected)  # pyright: ignore[reportArgumentType]
        if array.shape == (4, 4):
            return finite_array(array, (4, 4), "The setpoint").copy()
        if array.shape != (len(self.names),):
            raise BadValueError("The setpoint", f"of shape {array.shape}", self._expected)
        return self._by_name(dict(zip(self.names, array.tolist(), strict=True)))

    def _by_name(self, positions: object) -> dict[str, float]:
        given = joint_positions(positions)
        for name, position in given.items():
            if name not in self.names:
                raise UnknownNameError("joint", name, self.names)
            if not np.isfinite(position):
                raise BadValueError(f"The goal of {name}", position, "a finite number")
        return given

    @property
    def _expected(self) -> str:
        n = len(self.names)
        return f"positions by joint or ({n},), a pose (4, 4), or a Target"


def _period_s(rate_hz: float | None) -> float | None:
    if rate_hz is None:
        return None
    rate_hz = number("The rate", rate_hz)
    if not _SLOWEST_HZ <= rate_hz <= _FASTEST_HZ:
        expected = f"{_SLOWEST_HZ:g} to {_FASTEST_HZ:g} Hz, or None"
        raise BadValueError("The rate", f"{rate_hz:g} Hz", expected)
    return 1.0 / rate_hz
