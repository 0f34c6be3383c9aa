"""After Ctrl-C or SIGTERM: the arm holds; a second one lowers it to its rest and lets go."""

from __future__ import annotations

import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager

from ikservo.arm import Arm
from ikservo.arm.streaming.halt import STOPPED
from ikservo.arm.streaming.signals import CTRL_C, TERMINATED
from ikservo.cli.output import note
from ikservo.clock import Clock, RealClock
from ikservo.errors import StoppedError

__all__ = ["stoppable"]

# How long to listen for a second Ctrl-C; a person needs a moment, a script knows what it wants.
_PERSON_S, _SCRIPT_S = 2.0, 1.0


@contextmanager
def stoppable(machine: Arm, clock: Clock | None = None) -> Generator[None]:
    """Let a second Ctrl-C or SIGTERM, soon after one that stopped the arm, lower it and let go.

    A stop for another reason ends the command at once; the arm holds.

    Args:
        machine: The arm that the command moves.
        clock: Measures the wait for the second signal. The computer's if None, on simulated arms
            too: it is a user who is waited for.
    """
    clock = clock or RealClock()
    try:
        yield
    except (StoppedError, KeyboardInterrupt, SystemExit) as error:
        if machine.stopped_for in (CTRL_C, TERMINATED) and _said_again(
            machine, clock or RealClock()
        ):
            _lower(machine)
            raise StoppedError("Stopped; the arm was lowered and torque is off.") from None
        if isinstance(error, StoppedError) or not machine.stopped_for:
            raise
        raise StoppedError(machine.stopped_for, STOPPED[1]) from None


def _said_again(machine: Arm, clock: Clock) -> bool:
    if machine.stops_asked > 1:
        return True
    person = sys.stdin.isatty()
    if person:
        note("Torque stays on. Ctrl-C again lowers the arm and switches torque off.")
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        clock.sleep_until(clock.now_s() + (_PERSON_S if person else _SCRIPT_S))
    except KeyboardInterrupt:
        return True
    finally:
        signal.signal(signal.SIGTERM, before)
    return False


def _lower(machine: Arm) -> None:
    note("Lowering the arm to its rest pose, then torque off. Ctrl-C stops it.")
    machine.acknowledge()
    machine.relax()
