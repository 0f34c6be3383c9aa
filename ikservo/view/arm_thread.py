"""The thread that owns the arm: it follows commands and holds when they stop coming."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm, StopKind, StopReason
from ikservo.arm.online_control import follow_goals
from ikservo.clock import Clock
from ikservo.control.loop import ControlCycle
from ikservo.errors import BusError, IkservoError, PortLostError, RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.view.calibration import CalibrationDriver
from ikservo.view.snapshot import ArmCommand, ArmSnapshot, StopNotice

__all__ = ["ArmThread", "CycleObserver", "LiveSession"]


class CycleObserver(Protocol):
    """Who is told what the arm does, and knows what the person wants now."""

    @property
    def command(self) -> ArmCommand:
        """Return what the arm was told last."""
        ...

    def on_cycle(self, beat: ControlCycle) -> None:
        """Hear of a beat."""
        ...

    def log_message(self, words: str) -> None:
        """Hear what the person should know."""
        ...


class LiveSession:
    """Leads the arm after the person's wishes (``ikservo.arm.online_control.Leader``).

    Args:
        watcher: Who has the wishes and hears of every beat.
        clock: Dates them.
        dead_man_s: How long a wish lasts without a sign of life.

    Attributes:
        number: Which flight it is.
        silent: Whether it ended because nobody gave a sign of life.
    """

    def __init__(self, watcher: CycleObserver, clock: Clock, dead_man_s: float) -> None:
        self._watcher, self._clock, self._dead_man_s = watcher, clock, dead_man_s
        self.number, self.speed = watcher.command.session_id, watcher.command.speed
        self._here: Vector | None = None
        self._gone = self.silent = False

    def next_goal(self, beat: ControlCycle) -> Vector | None:
        """Return where the joints shall be (n,); None once the flight is over."""
        self._watcher.on_cycle(beat)
        wish = self._watcher.command
        if self._here is None:
            self._here = beat.goals.copy()
        self.silent = self._clock.now_s() - wish.heartbeat_s > self._dead_man_s
        if self.silent or self.is_over or wish.speed != self.speed or self._is_goal_withdrawn(wish):
            return None
        return self._here if wish.goal is None else wish.goal

    def _is_goal_withdrawn(self, wish: ArmCommand) -> bool:
        """Return whether the goal was taken back: the arm brakes, and stays where that ends."""
        self._gone = self._gone or wish.goal is not None
        return self._gone and wish.goal is None

    @property
    def is_over(self) -> bool:
        """Return whether Live was switched off, maybe on again, since it began."""
        wish = self._watcher.command
        return not wish.live or wish.session_id != self.number

    def on_rejected(self, error: RefusedError) -> None:
        """Tell why the guard would not have a goal."""
        self._watcher.log_message(f"{error.message} {error.command_hint}")


_POLL_PERIOD_S = 0.033  # between two looks at an arm that follows nobody
_STATE_PERIOD_S = 1.0
_MAX_MESSAGES = 40
_CLOSED = StopReason(StopKind.CLOSED, "The view was closed; torque stays on.")
_SILENCE_TEXT = (
    "The page does not answer; stopped, torque stays on. Switch Live on again to continue."
)
_CHECK_FIRST_TEXT = "Check the arm, then continue."
_RESTART_TEXT = "Torque stays on. End `ikservo view` with Ctrl-C and start it again."


class ArmThread:
    """Owns an arm; everybody else tells it wishes and reads what it saw, and neither waits.

    Args:
        open_arm: Opens the arm, at first and after its line was lost.
        clock: Dates wishes; safe to read from any thread.
        dead_man_s: How long a wish lasts without a sign of life.
        ritual: Opens and drives a calibration; None where there can be none.

    Attributes:
        arm: The arm; of use to others only for what does not change while it is open. It is
            another one after a calibration, and after its line was lost.
        readout: Written by the pilot alone.
    """

    def __init__(
        self,
        open_arm: Callable[[], Arm],
        clock: Clock,
        dead_man_s: float = DEAD_MAN_TIMEOUT_S,
        ritual: CalibrationDriver | None = None,
    ) -> None:
        self._open, self._clock, self._dead_man_s = open_arm, clock, dead_man_s
        self.calibration = ritual
        self.arm = open_arm()
        self._command = ArmCommand()
        self.readout = _read_snapshot(self.arm)
        self._states_s = clock.now_s()
        self._stop_reason: StopReason | None = None
        self._acknowledged = self._ending = self._lost = False
        self._thread = threading.Thread(target=self._run_thread, name="ikservo pilot", daemon=True)

    def __enter__(self) -> ArmThread:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let the arm hold, end the thread and give the port back."""
        self._ending = True
        self.request_stop(_CLOSED)
        self._thread.join()
        self.arm.close("hold")

    @property
    def command(self) -> ArmCommand:
        """Return the command that was posted last."""
        return self._command

    def post(self, command: ArmCommand) -> None:
        """Replace the command that the arm follows; the newest counts.

        This is the boundary between two threads: the server's posts, the pilot's reads ``command``
        at its own pace, once a control cycle. A command is never changed but replaced as a
        whole, so neither thread waits, and neither sees half of one. Only one thread may post:
        a command is made of the one before.
        """
        self._command = command

    def request_stop(self, reason: StopReason) -> None:
        """Brake and hold; it stays until acknowledged. Safe from any thread."""
        self._stop_reason, self._acknowledged = reason, False
        self.arm.request_stop(reason)

    def acknowledge(self) -> None:
        """A person has looked: the arm may be moved again, and nothing moves yet."""
        self._acknowledged = True

    def step(self) -> None:
        """Do one thing: follow until that ends, or look once."""
        try:
            self._run_step()
        except IkservoError as error:
            self._lost = self._lost or isinstance(error, PortLostError)
            self._end_session(StopNotice(error.message, error.command_hint))

    def on_cycle(self, beat: ControlCycle) -> None:
        """Keep what a beat told; ask the servos how they are, once a second (``CycleObserver``)."""
        self.readout = replace(self.readout, measured=beat.measured.copy(), goals=beat.goals.copy())
        if self._clock.now_s() - self._states_s > _STATE_PERIOD_S:
            self._states_s = self._clock.now_s()
            with contextlib.suppress(BusError):  # the beats themselves tell of a line that is lost
                self.readout = replace(self.readout, states=self.arm.where().joints)

    def log_message(self, words: str) -> None:
        """Remember what the person should know, once (``CycleObserver``)."""
        if words and self.readout.notes[-1:] != (words,):
            self.readout = replace(
                self.readout, notes=(*self.readout.notes, words)[-_MAX_MESSAGES:]
            )

    def _run_thread(self) -> None:
        try:
            while not self._ending:
                self.step()
        except Exception as error:  # a fault of ours: nobody leads the arm any more, so say it
            self._end_session(StopNotice(f"The view has failed: {error!r}.", _RESTART_TEXT))
            raise

    def _run_step(self) -> None:
        if self._acknowledged:
            self._restart()
        elif self._stop_reason is not None and not self.readout.trouble:
            self._end_session(StopNotice(self._stop_reason.text, _CHECK_FIRST_TEXT))
        if self.readout.trouble:
            self._poll_state(quietly=True)
        elif self.calibration and self.calibration.wanted:
            self._run_calibration(self.calibration)
        elif self.command.live and self.command.session_id > self.readout.ended_session:
            self._run_session()
        else:
            self._poll_state()

    def _run_session(self) -> None:
        """Follow wishes until they end, change their speed, or stop coming."""
        flight = LiveSession(self, self._clock, self._dead_man_s)
        follow_goals(self.arm.workings, flight, flight.speed)
        if flight.silent:
            self.log_message(_SILENCE_TEXT)
        if flight.silent or flight.is_over:  # Live may have been thrown anew while the arm braked
            self.readout = replace(self.readout, goals=None, ended_session=flight.number)

    def _poll_state(self, *, quietly: bool = False) -> None:
        """See where the arm is while it follows nobody."""
        try:
            seen = _read_snapshot(self.arm)
            self.readout = replace(
                self.readout, measured=seen.measured, states=seen.states, goals=None
            )
        except IkservoError:
            if not quietly:
                raise
        self._clock.sleep_until(self._clock.now_s() + _POLL_PERIOD_S)

    def _restart(self) -> None:
        """Go on after a stop; a line that was lost is opened again.

        Raises:
            IkservoError: It is still lost.
        """
        self._acknowledged, self._stop_reason = False, None
        if self._lost:
            self.arm.close("hold")
            self._reopen_arm()
        self.arm.acknowledge()
        self.readout = replace(self.readout, trouble=None)

    def _end_session(self, trouble: StopNotice) -> None:
        """End the flight: somebody has to look, and Live has to be thrown again."""
        self.log_message(trouble.message)
        self.readout = replace(
            self.readout, trouble=trouble, goals=None, ended_session=self.command.session_id
        )

    def _run_calibration(self, ritual: CalibrationDriver) -> None:
        """Give the line to a calibration until it is over, then open the arm as it now is."""
        self.arm.close("hold")
        self._lost = True
        try:
            for talk in ritual.run():
                self.readout = replace(self.readout, talk=talk)
                if self._ending:
                    return
        finally:
            self.readout = replace(self.readout, talk=None)
            self._reopen_arm()

    def _reopen_arm(self) -> None:
        """Open the arm as it is now: it may have been calibrated meanwhile."""
        self.arm = self._open()
        self._lost = False
        seen = _read_snapshot(self.arm)
        self.readout = replace(self.readout, measured=seen.measured, states=seen.states)


def _read_snapshot(arm: Arm) -> ArmSnapshot:
    states = arm.where().joints
    return ArmSnapshot(np.array([state.position_rad for state in states]), states=states)
