"""The thread that owns the arm: it follows wishes, holds when they stop coming, and looks on."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm
from ikservo.arm.skills.leading import lead
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.halt import StopKind, StopReason
from ikservo.clock import Clock
from ikservo.errors import BusError, IkservoError, PortLostError
from ikservo.view.session.flight import Flight
from ikservo.view.session.readout import Readout, Trouble, Wish
from ikservo.view.session.ritual import Ritual

__all__ = ["Pilot"]

_LOOK_S = 0.033  # between two looks at an arm that follows nobody
_STATES_S = 1.0
_MOST_NOTES = 40
_CLOSED = StopReason(StopKind.CLOSED, "The view was closed; torque stays on.")
_SILENCE = "The page does not answer; stopped, torque stays on. Switch Live on again to continue."
_LOOK_FIRST = "Check the arm, then continue."
_START_AGAIN = "Torque stays on. End `ikservo view` with Ctrl-C and start it again."


class Pilot:
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
        ritual: Ritual | None = None,
    ) -> None:
        self._open, self._clock, self._dead_man_s = open_arm, clock, dead_man_s
        self.ritual = ritual
        self.arm = open_arm()
        self._command = Wish()
        self.readout = _seen(self.arm)
        self._states_s = clock.now_s()
        self._stop_reason: StopReason | None = None
        self._acknowledged = self._ending = self._lost = False
        self._thread = threading.Thread(target=self._run, name="ikservo pilot", daemon=True)

    def __enter__(self) -> Pilot:
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
    def wish(self) -> Wish:
        """Return the command that was posted last."""
        return self._command

    def post(self, command: Wish) -> None:
        """Replace the command that the arm follows; the newest counts.

        This is the boundary between two threads: the server's posts, the pilot's reads ``wish``
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
            self._step()
        except IkservoError as error:
            self._lost = self._lost or isinstance(error, PortLostError)
            self._ground(Trouble(error.message, error.command_hint))

    def see(self, beat: Beat) -> None:
        """Keep what a beat told; ask the servos how they are, once a second (``Watcher``)."""
        self.readout = replace(self.readout, measured=beat.measured.copy(), goals=beat.goals.copy())
        if self._clock.now_s() - self._states_s > _STATES_S:
            self._states_s = self._clock.now_s()
            with contextlib.suppress(BusError):  # the beats themselves tell of a line that is lost
                self.readout = replace(self.readout, states=self.arm.where().joints)

    def note(self, words: str) -> None:
        """Remember what the person should know, once (``Watcher``)."""
        if words and self.readout.notes[-1:] != (words,):
            self.readout = replace(self.readout, notes=(*self.readout.notes, words)[-_MOST_NOTES:])

    def _run(self) -> None:
        try:
            while not self._ending:
                self.step()
        except Exception as error:  # a fault of ours: nobody leads the arm any more, so say it
            self._ground(Trouble(f"The view has failed: {error!r}.", _START_AGAIN))
            raise

    def _step(self) -> None:
        if self._acknowledged:
            self._begin_anew()
        elif self._stop_reason is not None and not self.readout.trouble:
            self._ground(Trouble(self._stop_reason.text, _LOOK_FIRST))
        if self.readout.trouble:
            self._look(quietly=True)
        elif self.ritual and self.ritual.wanted:
            self._calibrate(self.ritual)
        elif self.wish.live and self.wish.flight > self.readout.ended:
            self._fly()
        else:
            self._look()

    def _fly(self) -> None:
        """Follow wishes until they end, change their speed, or stop coming."""
        flight = Flight(self, self._clock, self._dead_man_s)
        lead(self.arm.workings, flight, flight.speed)
        if flight.silent:
            self.note(_SILENCE)
        if flight.silent or flight.over:  # Live may have been thrown anew while the arm braked
            self.readout = replace(self.readout, goals=None, ended=flight.number)

    def _look(self, *, quietly: bool = False) -> None:
        """See where the arm is while it follows nobody."""
        try:
            seen = _seen(self.arm)
            self.readout = replace(
                self.readout, measured=seen.measured, states=seen.states, goals=None
            )
        except IkservoError:
            if not quietly:
                raise
        self._clock.sleep_until(self._clock.now_s() + _LOOK_S)

    def _begin_anew(self) -> None:
        """Go on after a stop; a line that was lost is opened again.

        Raises:
            IkservoError: It is still lost.
        """
        self._acknowledged, self._stop_reason = False, None
        if self._lost:
            self.arm.close("hold")
            self._reopen()
        self.arm.acknowledge()
        self.readout = replace(self.readout, trouble=None)

    def _ground(self, trouble: Trouble) -> None:
        """End the flight: somebody has to look, and Live has to be thrown again."""
        self.note(trouble.message)
        self.readout = replace(self.readout, trouble=trouble, goals=None, ended=self.wish.flight)

    def _calibrate(self, ritual: Ritual) -> None:
        """Give the line to a calibration until it is over, then open the arm as it now is."""
        self.arm.close("hold")
        self._lost = True
        try:
            for talk in ritual.hold():
                self.readout = replace(self.readout, talk=talk)
                if self._ending:
                    return
        finally:
            self.readout = replace(self.readout, talk=None)
            self._reopen()

    def _reopen(self) -> None:
        """Open the arm as it is now: it may have been calibrated meanwhile."""
        self.arm = self._open()
        self._lost = False
        seen = _seen(self.arm)
        self.readout = replace(self.readout, measured=seen.measured, states=seen.states)


def _seen(arm: Arm) -> Readout:
    states = arm.where().joints
    return Readout(np.array([state.position_rad for state in states]), states=states)
