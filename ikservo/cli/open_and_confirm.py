"""A command's session with an arm: open it, confirm motions, handle Ctrl-C and SIGTERM."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from ikservo.arm import Arm, MotionPlan, MotionProgress, OpenArm, StopKind, ZeroSource, open_arm
from ikservo.arm.opening import open_own_arm, require_own_port
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.terminal import confirm, format_port, print_status, progress_bar
from ikservo.clock import Clock, RealClock
from ikservo.control.real_time import allowed_priority
from ikservo.control.stop_requests import RELAX_HINT, REQUEST_HINT
from ikservo.errors import IkservoError, InputError, StoppedError, format_point
from ikservo.kernels.compiled import is_compiled
from ikservo.model import load_model
from ikservo.model.scene_file import PlacedArm, with_scene_and_arms
from ikservo.planning.motions import MotionValue

_KEY_TIMEOUT_S = 2.0  # time to wait for a second Ctrl-C from a user
_SIGNAL_TIMEOUT_S = 1.0  # time to wait for a second signal from a script
_SLOW_PLAN_S = 1.0  # after this time, the user is told why planning takes long

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
        if (
            reason is not None
            and reason.kind in _REPEATABLE
            and _is_interrupted_again(machine, clock or RealClock())
        ):
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
            model,
            connection.port,
            collisions=options.collision,
            uncalibrated=options.uncalibrated,
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
