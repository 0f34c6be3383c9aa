"""What the owner of a bus does for other terminals: stop, tell where the arm is, relax it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import asdict
from threading import RLock
from typing import TYPE_CHECKING

from ikservo.arm.owner import Errand, Request
from ikservo.arm.owner.halting import Halted
from ikservo.arm.streaming.halt import StopKind, StopReason
from ikservo.errors import IkservoError

if TYPE_CHECKING:
    from collections.abc import Generator

    from ikservo.arm.running import Running

__all__ = ["BRAKE_WITHIN_S", "Answers"]

_STOPPED = StopReason(StopKind.CLIENT, "Stopped from another terminal; torque stays on.")
_RELAXED = StopReason(StopKind.RELEASED, "Torque switched off from another terminal.")
BRAKE_WITHIN_S = 3.0


class Answers:
    """Does other terminals' errands on an arm; called in threads of its own.

    The arm's own program has the turn while it moves the arm. To stop needs no turn; to be asked
    where it is meanwhile is answered with the last beat.

    Args:
        arm: The arm.
        turn: Held by whoever moves the arm.
    """

    def __init__(self, arm: Running, turn: RLock) -> None:
        self._arm, self._turn = arm, turn

    def __call__(self, request: Request) -> Mapping[str, object]:
        """Return the answer's fields.

        Raises:
            IkservoError: The arm could not do it.
        """
        match request.do:
            case Errand.STOP:
                return self._stop()
            case Errand.WHERE:
                return self._where()
            case Errand.RELAX:
                return self._relax()

    def _stop(self) -> Mapping[str, object]:
        arm, servos = self._arm, self._arm.workings.servos
        moving = not self._turn.acquire(blocking=False)
        if moving:
            arm.request_stop(_STOPPED)
            with self._turn_within(BRAKE_WITHIN_S):
                halted = Halted(servos.names, (), ())  # whatever ended the motion, it holds
        else:
            try:
                halted = servos.hold_measured(_STOPPED)
            finally:
                self._turn.release()
        return {"arm": arm.model.name, "port": arm.port_name, "moving": moving, **asdict(halted)}

    def _where(self) -> Mapping[str, object]:
        if self._turn.acquire(blocking=False):
            try:
                here, moving = self._arm.where(), False
            finally:
                self._turn.release()
        else:
            here, moving = self._arm.glimpse(), True
        joints = [asdict(joint) for joint in here.joints]
        return {"moving": moving, "tip_m": here.tip_m.tolist(), "joints": joints}

    def _relax(self) -> Mapping[str, object]:
        self._stop()
        with self._turn_within(BRAKE_WITHIN_S):
            self._arm.acknowledge()
            report = self._arm.relax()
            self._arm.workings.servos.latch_stop(_RELAXED)
        return {**asdict(report), "measured_tip_m": report.measured_tip_m.tolist()}

    @contextmanager
    def _turn_within(self, timeout_s: float) -> Generator[None]:
        if not self._turn.acquire(timeout=timeout_s):
            raise IkservoError(
                "The program that moves the arm did not stop when told to.",
                "End it, or switch off the arm's power.",
            )
        try:
            yield
        finally:
            self._turn.release()
