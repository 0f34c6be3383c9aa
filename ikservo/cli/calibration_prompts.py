"""The start of every calibration: confirmation, torque off, the joints and their servos."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager

import typer

from ikservo.cli.prompts import confirm
from ikservo.cli.terminal import print_status
from ikservo.errors import IkservoError, StoppedError
from ikservo.files.writing import check_writable
from ikservo.maintenance.arm_sketch import ascii_sketch
from ikservo.maintenance.calibration_session import TorqueOffArm

__all__ = ["confirm_start", "disable_torque", "print_servos", "reporting_unchanged_state"]


def confirm_start(question: str, *, default: bool, asks: bool) -> bool:
    """Ask for yes or no; return the default where nobody may be asked."""
    return confirm(question) if asks else default


def disable_torque(loose: TorqueOffArm, *, asks: bool, yes: bool) -> None:
    """Switch torque off, once the person knows.

    Raises:
        FileWriteError: No calibration could be saved afterwards.
        IkservoError: Servos hold the arm and nobody agreed; nothing was changed.
    """
    for path in (loose.path, loose.journal_path):
        check_writable(path.parent)
    if loose.settled:
        print_status(loose.settled)
    holding = loose.torque_on_servos()
    if holding:
        print_status("Torque will be switched off; support the arm.")
        if not yes and not confirm_start("Switch torque off?", default=False, asks=asks):
            raise IkservoError("Cancelled; nothing changed.", "Without asking: --yes")
    loose.disable_torque()


@contextmanager
def reporting_unchanged_state() -> Generator[None]:
    """Say, where Ctrl-C ends a calibration by hand, that it left nothing behind.

    Raises:
        StoppedError: In place of Ctrl-C or the end of the input.
    """
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise StoppedError("Stopped: nothing was saved; torque is off.") from None


def print_servos(loose: TorqueOffArm, pose: str) -> None:
    """Say who is on the line, and show the pose."""
    servos = list(loose.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    print_status(f"{loose.model.title} on {loose.bus.port.name}: {listed}, firmware {firmware}.")
    for line in ascii_sketch(loose.model, loose.model.joints[-1].name, pose)[:-1]:
        print_status(f"    {line}")
