"""A command's session with an arm: open it, confirm motions, lower it on a second Ctrl-C."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from ikservo.arm import Arm, MotionPlan, MotionProgress, OpenArm, ZeroSource, open_arm
from ikservo.arm.opening import open_own_arm, require_own_port
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.second_interrupt import second_interrupt_lowers
from ikservo.cli.terminal import confirm, format_port, print_status, progress_bar
from ikservo.clock import RealClock
from ikservo.control.stop_requests import REQUEST_HINT
from ikservo.control.thread_priority import allowed_priority
from ikservo.errors import IkservoError, InputError, format_point
from ikservo.kernels.compiled import is_compiled
from ikservo.model import load_model
from ikservo.model.scene_file import PlacedArm, with_scene_and_arms
from ikservo.planning.motions import MotionValue

_SLOW_PLAN_S = 1.0  # after this time, the user is told why planning takes long


@contextmanager
def open_from_options(
    connection: ArmConnection, options: MotionOptions | None = None, scene: Path | None = None
) -> Generator[OpenArm]:
    """Open the arm of a command with the things of a scene; afterwards, the arm holds.

    Raises:
        InputError: Another arm of the scene has no port.
    """
    options = options or MotionOptions()
    model, other_arms = model_from_option(connection.arm, options.tip), ()
    if scene is not None:
        model, other_arms = with_scene_and_arms(model, scene)
        for each in other_arms:
            if not each.port:
                raise InputError(
                    f"{scene} does not name the port of {each.name}.",
                    'Add the port to its table, as in: port = "/dev/ttyUSB1". '
                    "Arms on one page of ikservo view need no port.",
                )
    with (
        open_arm(
            model, connection.port, collisions=options.collision, uncalibrated=options.uncalibrated
        ) as machine,
        _opened_beside(machine, other_arms),
    ):
        served_here = machine.zeros is ZeroSource.SIMULATED and not machine.is_remote
        if served_here and not machine.port_name.startswith("sim:"):
            print_status(f"{machine.port_name} is a pseudo-terminal: treated as a simulated arm.")
        if machine.zeros in (ZeroSource.ACCEPTED, ZeroSource.UNKNOWN):
            print_status(
                "Not calibrated: using nominal zeros; the position may be wrong by several cm."
            )
        if isinstance(machine, Arm):
            machine.context.servos.warn = print_status
            machine.context.servos.stop_request.raise_if_set(REQUEST_HINT)
        with second_interrupt_lowers(machine):
            yield machine


@contextmanager
def _opened_beside(machine: OpenArm, placed: Sequence[PlacedArm]) -> Generator[None]:
    """Open the other arms of a scene to measure them, so that they can be avoided."""
    with ExitStack() as opened:
        for each in placed:
            scene = require_own_port(machine).scene
            other = open_own_arm(load_model(each.arm or each.name), each.port)
            opened.enter_context(other)
            scene.add_arm(other, each.name, each.at_m, each.rpy_deg)
        yield


def plan_motion(machine: OpenArm, motion: MotionValue[Any]) -> MotionPlan:
    """Return the plan of a motion; tell the user if planning takes more than a second."""
    words = "Searching for a path around obstacles; Ctrl-C ends the search."
    timer = threading.Timer(_SLOW_PLAN_S, print_status, [words])
    timer.daemon = True
    timer.start()
    try:
        return machine.plan(motion)
    finally:
        timer.cancel()


def announce(plan: MotionPlan, machine: OpenArm, options: MotionOptions) -> None:
    """Print a planned motion, and ask the user to confirm it unless it is only planned.

    Raises:
        IkservoError: The user declined.
        InputError: A real arm would move, without --yes and without a terminal.
    """
    where_to = "" if plan.target_m is None else f" to {format_point(plan.target_m)}"
    print_status(f"{machine.model.title} on {format_port(machine.port_name)}{where_to}: "
         f"{plan.duration_s:.1f} s, {plan.speed}.")  # fmt: skip
    if isinstance(machine.clock, RealClock) and allowed_priority():
        print_status(f"Real-time priority {allowed_priority()} while the arm moves.")
    if plan.via_pose:
        print_status(f'The direct path would collide; moving via pose "{plan.via_pose}".')
    if plan.around:
        print_status(f"The straight path is not possible: {plan.around}. Taking a detour.")
    if plan.speed_reduced:
        print_status("First motion after torque-on: slow speed.")
    if plan.tool_speed is not None and not plan.tool_speed.is_constant:
        print_status(f"Tool speed: {plan.tool_speed}.")
    confirm_motion(machine, yes=options.yes or options.dry_run)


def announce_lowering(machine: OpenArm, options: MotionOptions) -> None:
    """Announce that the arm will be lowered and relaxed, and confirm it like ``announce``.

    Raises:
        IkservoError: The user declined.
    """
    for change in machine.pose_within_limits("rest").changed:
        print_status(f"{change}.")
    try:
        plan = machine.plan_lowering()
    except IkservoError as error:
        if machine.stop_reason is not None:
            raise
        print_status(f"The arm cannot be lowered: {error.command_message}")
        print_status("Torque will be switched off in the present pose: support the arm.")
        confirm_motion(machine, yes=options.yes, question="Switch torque off?")
        return
    announce(plan, machine, options)


def confirm_motion(machine: OpenArm, *, yes: bool, question: str = "Move?") -> None:
    """Ask the user to confirm an announced motion; a simulated arm needs no confirmation.

    Raises:
        IkservoError: The user declined.
        InputError: A real arm would move, without --yes and without a terminal.
    """
    if yes or machine.zeros is ZeroSource.SIMULATED:
        return
    if not sys.stdin.isatty():
        raise InputError(
            "Cannot ask: input is not a terminal.", "To move without being asked, add --yes."
        )
    if not confirm(question):
        raise IkservoError("Cancelled; nothing moved.")


@contextmanager
def motion_progress_bar() -> Generator[Callable[[MotionProgress], None] | None]:
    """Yield a callback that draws a motion's progress, or None if stderr is not a terminal."""
    with progress_bar() as show:

        def draw(progress: MotionProgress) -> None:
            if show:
                show(format_point(progress.tip_m), progress.elapsed_s, progress.duration_s)

        yield draw if show else None


def warn_uncompiled() -> None:
    """Warn, before goals are streamed, that the solver is slow because it is not compiled."""
    if not is_compiled():
        print_status(
            "The solver is not compiled, so goals are sent late. Install a C compiler, then"
        )
        print_status("reinstall ikservo; in a clone run: make build.")
