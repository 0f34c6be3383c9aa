"""How every calibration begins: the person agrees, the arm goes limp, everybody is named."""

from __future__ import annotations

from collections import Counter

import typer

from ikservo.arm.calibrating.by_hand import LooseArm
from ikservo.arm.calibrating.sketch import sketch
from ikservo.cli.output import note
from ikservo.errors import IkservoError
from ikservo.files.writing import check_writable

__all__ = ["consent", "greet", "let_go"]


def consent(question: str, *, default: bool, asks: bool) -> bool:
    """Return a person's yes or no, or the default where nobody is asked."""
    return typer.confirm(question, default=default, err=True) if asks else default


def let_go(loose: LooseArm, *, asks: bool, yes: bool) -> None:
    """Switch torque off, once the person knows.

    Raises:
        FileWriteError: No calibration could be saved afterwards.
        IkservoError: Servos hold the arm and nobody agreed; nothing was changed.
    """
    for path in (loose.path, loose.journal_path):
        check_writable(path.parent)
    if loose.settled:
        note(loose.settled)
    holding = loose.holding()
    if holding:
        note(f"{', '.join(holding)} hold: the arm will go limp. Hold it.")
        if not yes and not consent("Let go?", default=asks, asks=asks):
            raise IkservoError("Nothing was changed.", "Without asking: --yes")
    loose.let_go()


def greet(loose: LooseArm, pose: str) -> None:
    """Say who is on the line, and show the pose."""
    servos = list(loose.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    note(f"{loose.model.title} on {loose.bus.port.name}: {listed}, firmware {firmware}.")
    for line in sketch(loose.model, loose.model.joints[-1].name, pose)[:-1]:
        note(f"    {line}")
