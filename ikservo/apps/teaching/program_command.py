"""``ikservo program``: write, check and run a file of steps."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.teaching.program import Program, ProgramStep, read_program, write_program
from ikservo.apps.teaching.program_run import NextStep, ProgramRun, StepCheck, StepReport
from ikservo.arm import OpenArm
from ikservo.arm.opening import require_own_port
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import confirm_motion, motion_progress_bar, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import (
    ArmConnection,
    ArmOption,
    MotionOptions,
    OverwriteOption,
    SceneOption,
)
from ikservo.cli.terminal import print_json, print_lines, print_status, wait_for_enter
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import IkservoError, InputError

File = Annotated[Path, typer.Argument(metavar="FILE", help="The program, a TOML file.")]
First = Annotated[int, typer.Option("--from", metavar="STEP", help="Begin with this step.")]
_KEPT_RESULTS = 100_000  # latest results kept of a program that is repeated until it is stopped
Time = Annotated[
    int, typer.Option("--time", min=1, metavar="N", help="Begin with this repetition.")
]
EachStep = Annotated[bool, typer.Option("--step", help="Wait for Enter before each step.")]


def new(file: File, arm: ArmOption = None, *, overwrite: OverwriteOption = False) -> None:
    """Write an example program for this kind of arm, with each possible action once.

    ikservo program new tea.toml --arm so101
    """
    model = model_from_option(arm)
    if file.exists() and not overwrite:
        raise IkservoError(f"File {file} exists.", "Replace it: --overwrite")
    tip_m = model.chain.forward(0.95 * model.chain_pose("home"))[:3, 3].tolist()
    x, y, z = (round(float(value), 3) + 0.0 for value in tip_m)  # never -0.0
    steps = [
        ProgramStep(name="begin", pose="home"),
        ProgramStep(name="near home", tip_m=(x, y, z), speed="slow"),
        ProgramStep(wait_s=0.5),
    ]
    if model.gripper is not None:
        steps += [ProgramStep(gripper="open"), ProgramStep(gripper="close")]
    steps.append(ProgramStep(name="end", pose="home"))
    write_program(file, Program(format=1, arm=model.name, steps=tuple(steps)))
    print_lines([f"Saved: {file}"])
    print_status(f"Edit it, then: ikservo program check {file} --port sim")


def check(
    file: File,
    *,
    connection: ArmConnection,
    first: First = 1,
    scene: SceneOption = None,
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Plan each step of a program from the end of the previous step; nothing moves.

    ikservo program check tea.toml --port sim
    """
    with _opened(file, connection, options, scene) as (_, program, runner):
        checks = _check(runner, program, file, first, quiet=options.json)
    if options.json:
        steps = [{"number": each.number, "does": each.step.description} for each in checks]
        print_json("program-check", steps=steps)


def run(
    file: File,
    *,
    connection: ArmConnection,
    first: First = 1,
    time: Time = 1,
    step: EachStep = False,
    scene: SceneOption = None,
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Check a program, and run it: poses, points, lines, arcs, gripper, waits, recordings.

    ikservo program run tea.toml --port sim          Ctrl-C stops the arm
    """
    has_terminal = sys.stdin.isatty()
    if step and not has_terminal:
        raise InputError(
            "Cannot wait for Enter, because input is not a terminal.", "Leave out --step."
        )
    with _opened(file, connection, options, scene) as (machine, program, steps):
        if steps.pauses and not has_terminal:
            raise InputError("A pause waits for Enter, but input is not a terminal.")
        _check(steps, program, file, first, quiet=options.json)
        confirm_motion(machine, yes=options.yes)
        check_directions_once(machine, options)
        results = _run(steps, program, first, time, wait=step)
    if options.json:
        fields: list[dict[str, object]] = [
            {
                "number": each.number,
                "repetition": each.repetition,
                "does": each.step.description,
                "duration_s": getattr(report, "duration_s", None),
                "error_m": getattr(report, "error_m", None),
            }
            for each, report in results
        ]
        print_json("program-run", steps=fields)
    else:
        print_lines([f"steps     {len(results)} done"])


@contextmanager
def _opened(
    file: Path, connection: ArmConnection, options: MotionOptions, scene: Path | None
) -> Generator[tuple[OpenArm, Program, ProgramRun]]:
    """Read a program, and open the given arm, or else the arm that the program names."""
    program = read_program(file)
    connection = replace(connection, arm=connection.arm or program.arm)
    with open_from_options(connection, options, scene) as machine:
        yield (
            machine,
            program,
            ProgramRun(require_own_port(machine), program, file.parent, machine.poses),
        )


def _check(
    run: ProgramRun, program: Program, file: Path, first: int, *, quiet: bool
) -> list[StepCheck]:
    """Check each step."""
    checks: list[StepCheck] = []
    failed: dict[int, IkservoError] = {}  # by step, because repetitions are checked again
    for each in run.check(first):
        checks.append(each)
        if each.error is not None and each.number not in failed:
            failed[each.number] = each.error
            _print_step(each.number, program, f"{each.step.description}: cannot be carried out")
            for line in (each.error.message, each.error.hint.partition("Try: ")[0].strip()):
                if line:
                    print_status(f"         {line}")
        elif each.error is None and not quiet:
            _print_step(each.number, program, f"{each.step.description}: ok")
    if failed:
        listed = ", ".join(map(str, failed))
        of = f"Step {listed}" if len(failed) == 1 else f"Steps {listed}"
        error = IkservoError(
            f"{of} of {len(program.steps)} cannot be carried out; nothing moved.",
            f"Correct the file, then: ikservo program check {file}",
        )
        error.exit_code = next(iter(failed.values())).exit_code
        raise error
    return checks


def _run(
    run: ProgramRun, program: Program, first: int, repetition: int, *, wait: bool
) -> Sequence[tuple[NextStep, StepReport | None]]:
    """Run the steps; print each before it begins, and after a failure where to continue."""
    done = deque[tuple[NextStep, StepReport | None]](maxlen=_KEPT_RESULTS)
    with motion_progress_bar() as on_progress:
        for each in run.steps(first, repetition):
            _print_step(each.number, program, each.step.description)
            try:
                if each.step.pause is not None:
                    wait_for_enter("Press Enter to continue, Ctrl-C to end.")
                elif wait:
                    wait_for_enter("Press Enter for this step, Ctrl-C to end.")
                done.append((each, run.run_step(each, on_progress)))
            except BaseException:
                again = f" --time {each.repetition}" if program.repetitions > 1 else ""
                number = each.number
                print_status(f"Stopped in step {number}. To resume there: --from {number}{again}")
                raise
    return done


def _print_step(number: int, program: Program, text: str) -> None:
    print_status(f"{number:>3}/{len(program.steps)}  {text}")
