"""What commands that open an arm have in common: which arm, may it move, how far is it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager

from ikservo.arm import Arm, Plan, Progress, Zeros, open_arm
from ikservo.cli.choosing import chosen_model
from ikservo.cli.output import note, point, port_words
from ikservo.cli.prompts import confirm
from ikservo.cli.stopping import stoppable
from ikservo.errors import IkservoError, InputError

__all__ = ["agree", "announce", "announce_lowering", "opened", "watched"]


@contextmanager
def opened(
    arm: str | None,
    port: str | None,
    *,
    tip: str | None = None,
    collisions: bool = True,
    uncalibrated: bool = False,
) -> Generator[Arm]:
    """Open the arm of ``--arm`` on ``--port``, and leave it holding."""
    model = chosen_model(arm, tip)
    with open_arm(model, port, collisions=collisions, uncalibrated=uncalibrated) as machine:
        _warn_uncalibrated(machine)
        with stoppable(machine):
            yield machine


def announce(plan: Plan, machine: Arm, *, yes: bool) -> None:
    """Say what is about to move, and ask once where a person can answer.

    Raises:
        IkservoError: The person said no.
        InputError: A real arm would move, without --yes and without a terminal to ask on.
    """
    where_to = "" if plan.target_m is None else f" to {point(plan.target_m.tolist())}"
    note(f"{machine.model.title} on {port_words(machine.port_name)}{where_to}: "
         f"{plan.duration_s:.1f} s, {plan.speed}.")  # fmt: skip
    if plan.by:
        note(f'Direct path would collide; moving via pose "{plan.by}".')
    if plan.slowed:
        note("First motion after torque-on: slow speed.")
    agree(machine, yes=yes)


def announce_lowering(machine: Arm, *, yes: bool) -> None:
    """Say that the arm is about to be lowered and let go, and ask once as ``announce`` does.

    Raises:
        IkservoError: The person said no.
    """
    for words in machine.inside("rest").changed:
        note(f"{words}.")
    try:
        plan = machine.plan_down()
    except IkservoError as error:
        if machine.stop_reason is not None:
            raise
        note(f"It cannot be lowered: {error.message}")
        note("Torque is switched off where it stands. Support the arm.")
        agree(machine, yes=yes)
        return
    announce(plan, machine, yes=yes)


def agree(machine: Arm, *, yes: bool) -> None:
    """Ask once whether to make the motion that was announced; a simulated arm needs no answer.

    Raises:
        IkservoError: The person said no.
        InputError: A real arm would move, without --yes and without a terminal to ask on.
    """
    if yes or machine.zeros is Zeros.SIMULATED:
        return
    if not sys.stdin.isatty():
        raise InputError(
            "Cannot ask: input is not a terminal.", "To move without being asked, add --yes."
        )
    if not confirm("Move?"):
        raise IkservoError("Cancelled; nothing moved.")


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
        note(f"{machine.port_name} is a pseudo-terminal: treated as a simulated arm.")
    if machine.zeros in (Zeros.ACCEPTED, Zeros.UNKNOWN):
        note("Not calibrated: using nominal zeros; the position may be wrong by several cm.")
