"""A second Ctrl-C or SIGTERM soon after the first lowers the arm."""

from __future__ import annotations

import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager

from ikservo.arm import OpenArm, StopKind
from ikservo.cli.terminal import print_status
from ikservo.clock import Clock, RealClock
from ikservo.control.stop_requests import RELAX_HINT
from ikservo.errors import StoppedError

_KEY_TIMEOUT_S = 2.0  # time to wait for a second Ctrl-C from a user
_SIGNAL_TIMEOUT_S = 1.0  # time to wait for a second signal from a script
_REPEATABLE = (StopKind.CTRL_C, StopKind.TERMINATED)


@contextmanager
def second_interrupt_lowers(machine: OpenArm, clock: Clock | None = None) -> Generator[None]:
    """On a second Ctrl-C or SIGTERM soon after the first, lower the arm and switch torque off.

    A stop for another reason ends the command at once; the arm holds.

    Without a clock, the computer's clock measures the wait for the second signal, also for
    simulated arms, because the user acts in real time.
    """
    clock = clock or RealClock()
    try:
        yield
    except (StoppedError, KeyboardInterrupt, SystemExit) as error:
        reason = machine.stop_reason
        repeatable = reason is not None and reason.kind in _REPEATABLE
        if repeatable and _is_interrupted_again(machine, clock):
            print_status("Lowering the arm to its rest pose, then torque off. Ctrl-C stops it.")
            machine.acknowledge()
            report = machine.relax()
            outcome = "Stopped; the arm was lowered and torque is off."
            if not report.reached:
                outcome = " ".join(("Stopped; torque is off.", *report.binding))
            raise StoppedError(outcome) from None
        if isinstance(error, StoppedError) or reason is None:
            raise
        raise StoppedError(reason.text, RELAX_HINT) from None


def _is_interrupted_again(machine: OpenArm, clock: Clock) -> bool:
    if machine.stop_requests > 1:
        return True
    interactive = sys.stdin.isatty()
    if interactive:
        print_status("Torque stays on. Ctrl-C again lowers the arm and switches torque off.")
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        clock.sleep_until(clock.now_s() + (_KEY_TIMEOUT_S if interactive else _SIGNAL_TIMEOUT_S))
    except KeyboardInterrupt:
        return True
    finally:
        signal.signal(signal.SIGTERM, before)
    return False
