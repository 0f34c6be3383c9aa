"""What every calibration on a terminal begins and ends with."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager

import typer

from ikservo.cli.terminal import print_status
from ikservo.errors import StoppedError
from ikservo.maintenance.arm_sketch import ascii_sketch
from ikservo.maintenance.calibration_session import TorqueOffArm

__all__ = ["print_servos", "reporting_unchanged_state"]


@contextmanager
def reporting_unchanged_state() -> Generator[None]:
    """On Ctrl-C during a calibration by hand, report that nothing was saved.

    Raises:
        StoppedError: Instead of Ctrl-C or the end of the input.
    """
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise StoppedError("Stopped: nothing was saved; torque is off.") from None


def print_servos(limp_arm: TorqueOffArm, pose: str) -> None:
    """Print the servos found and the reference pose."""
    servos = list(limp_arm.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    print_status(
        f"{limp_arm.model.title} on {limp_arm.bus.port.name}: {listed}, firmware {firmware}."
    )
    for line in ascii_sketch(limp_arm.model, limp_arm.model.joints[-1].name, pose)[:-1]:
        print_status(f"    {line}")
