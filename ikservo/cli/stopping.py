"""After Ctrl-C or SIGTERM: the arm holds; a second one lowers it to its rest and lets go."""

from __future__ import annotations

import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager

from ikservo.arm import Arm
from ikservo.arm.streaming.halt import RELAX_HINT, StopKind
from ikservo.cli.output import note
from ikservo.clock import Clock, RealClock
from ikservo.errors import StoppedError

__all__ = ["stoppable"]

# How long to listen for a second Ctrl-C; a person needs a moment, a script knows what it wants.
_PERSON_S, _SCRIPT_S = 2.0, 1.0

_REPEATABLE = (StopKind.CTRL_C, StopKind.TERMINATED)


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
        reason = machine.stop_reason
        if (
            reason is not None
            and reason.kind in _REPEATABLE
            and _said_again(machine, clock or RealClock())
        ):
            _lower(machine)
            raise StoppedError("Stopped; the arm was lowered and torque is off.") from None
        if isinstance(error, StoppedError) or reason is None:
            raise
        raise StoppedError(reason.text, RELAX_HINT) from None


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
