"""What commands that open an arm have in common: which arm, may it move, how far is it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

import typer

from ikservo.arm import Arm, Plan, Progress, Zeros, open_arm
from ikservo.cli.choosing import chosen_model
from ikservo.cli.output import note, point
from ikservo.cli.stopping import stoppable
from ikservo.errors import IkservoError, InputError

__all__ = ["agree", "announce", "opened", "watched"]


@contextmanager
def opened(
    arm: str | None, port: str | None, *, collisions: bool = True, uncalibrated: bool = False
) -> Generator[Arm]:
    """Open the arm of ``--arm`` on ``--port``, and leave it holding."""
    model = chosen_model(arm)
    with open_arm(model, port, collisions=collisions, uncalibrated=uncalibrated) as machine:
        _warn_uncalibrated(machine)
        with stoppable(machine):
            yield machine


def announce(plan: Plan, machine: Arm, *, yes: bool) -> None:
    """Say what is about to move, and ask once where a person can answer.

    Raises:
        IkservoError: The person said no.
        InputError: An arm whose zeros nobody knows would move and nobody is asked.
    """
    where_to = "" if plan.target_m is None else f" to {point(plan.target_m.tolist())}"
    note(f"{machine.model.title} on {machine.port_name}{where_to}: {plan.duration_s:.1f} s, "
         f"{plan.speed}.")  # fmt: skip
    if plan.by:
        note(f"The straight way is not free; it goes by its pose {plan.by}.")
    if plan.slowed:
        note("It is the first motion after torque comes on, therefore slow.")
    agree(machine, yes=yes)


def agree(machine: Arm, *, yes: bool) -> None:
    """Ask once whether what was announced shall move, where a person can answer.

    Raises:
        IkservoError: The person said no.
        InputError: An arm whose zeros nobody knows would move and nobody is asked.
    """
    if yes or machine.zeros is Zeros.SIMULATED:
        return
    if not sys.stdin.isatty():
        if machine.zeros is Zeros.UNKNOWN:
            raise InputError("Nobody is here to agree to this step.", "Give --yes.")
        return
    if not typer.confirm("Move?", default=True, err=True):
        raise IkservoError("Nothing moved.")


@contextmanager
def watched() -> Generator[Callable[[Progress], None] | None]:
    """Yield what draws a progress bar on a terminal's stderr, or None elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console  # noqa: PLC0415
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    columns = (BarColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)

        def draw(progress: Progress) -> None:
            bar.update(
                task,
                completed=progress.elapsed_s,
                total=progress.duration_s if math.isfinite(progress.duration_s) else None,
                description=point(progress.tip_m.tolist()),
            )

        yield draw


def _warn_uncalibrated(machine: Arm) -> None:
    if machine.zeros is Zeros.SIMULATED and not machine.port_name.startswith("sim:"):
        note(f"{machine.port_name} is a pseudo-terminal: the arm behind it is taken for simulated.")
    if machine.zeros in (Zeros.ACCEPTED, Zeros.UNKNOWN):
        note(
            f"{machine.model.title} is not calibrated; its zeros are {machine.zeros.value}: "
            "the tip is only as right as the horns are mounted."
        )
