"""``ikservo jog``: move a joint or the tip while a key is held, or for a duration."""

from __future__ import annotations

import math
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Annotated

import typer

from ikservo.arm import OpenArm
from ikservo.arm.arm_protocol import KeepGoing
from ikservo.arm.jogging import JOG_DIRECTIONS, NO_LONGER_REQUESTED
from ikservo.cli.completion import complete_jogs
from ikservo.cli.open_and_confirm import confirm_motion, open_from_options, warn_uncompiled
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions, SceneOption
from ikservo.cli.quantities import parse_angle_rad, parse_length_m, parse_time_s
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import Keys, format_port, print_status, read_keys
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import InputError, format_point
from ikservo.planning.reports import JogResult

_HOLD_S = 0.6  # a held key repeats only after up to half a second

What = Annotated[
    str,
    typer.Argument(
        metavar="JOINT|DIRECTION",
        help="A joint, or x y z -x -y -z up down.",
        autocompletion=complete_jogs,
    ),
]
Speed = Annotated[
    str | None,
    typer.Option(
        "--speed",
        help="Degrees/s for a joint, such as 10; mm/s for the tip or a sliding joint, such as "
        "20mm.",
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(
        "--duration", parser=parse_time_s, help="Move for this long, without keys: 2 or 0.5s."
    ),
]

_FIELDS: Fields[JogResult] = (
    Field("ended", "ended"),
    Field("measured_rad"),
    Field("measured_tip_m", "tip", lambda jog: format_point(jog.measured_tip_m)),
    Field("duration_s", "duration", lambda jog: f"{jog.duration_s:.2f} s"),
)


def command(
    what: What,
    *,
    connection: ArmConnection,
    speed: Speed = None,
    duration: Duration = None,
    scene: SceneOption = None,
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Move a joint or the tip in one direction while the space bar is held.

    Release the space bar to stop. A negative speed reverses; --duration needs no key.

    ikservo jog elbow_flex --speed -10 --duration 1 --arm so101 --port sim

    ikservo jog x --speed 20mm
    """
    if duration is None and not sys.stdin.isatty():
        raise InputError(
            "Cannot read keys: input is not a terminal.", "Add --duration, as in --duration 1."
        )
    with open_from_options(connection, options, scene) as machine:
        requested_speed = None
        if speed is not None:
            slides = what in JOG_DIRECTIONS
            if what in machine.joint_names:
                slides = machine.model.joint(what).joint_map.unit == "m"
            requested_speed = parse_length_m(speed) if slides else parse_angle_rad(speed)
        warn_uncompiled()
        if duration is not None:  # without a duration, the held key is the confirmation
            print_status(f"{machine.model.title} on {format_port(machine.port_name)}: "
                 f"{what} for {duration:g} s.")  # fmt: skip
            confirm_motion(machine, yes=options.yes)
        check_directions_once(machine, options)
        with _keep_going_check(machine, duration) as keep_going:
            report = machine.jog(what, requested_speed, wanted=keep_going)
    if report.ended == NO_LONGER_REQUESTED:
        report = replace(report, ended="key released" if duration is None else "time is up")
    print_fields("jog", report, _FIELDS, json=options.json)
    if report.blocked and speed is None:
        print_status("Jog back with a negative --speed.")
    elif report.blocked and speed is not None:
        digits = speed.lstrip("-\N{MINUS SIGN}")  # `main` has replaced the sign of a number
        print_status(f"Jog back with --speed {digits if digits != speed else f'-{speed}'}.")


@contextmanager
def _keep_going_check(machine: OpenArm, time_s: float | None) -> Generator[KeepGoing]:
    """Yield a function that returns True for a given time, or while the space bar is held."""
    if time_s is not None:
        yield _duration_check(machine, time_s)
        return
    print_status("Hold the space bar to move; release it to stop.")
    with read_keys() as key:
        while " " not in key():
            pass
        yield _key_held_check(machine, key)


def _duration_check(machine: OpenArm, duration_s: float) -> KeepGoing:
    """Return a function that returns True until a duration has passed since its first call."""
    end_s = math.inf

    def keep_going() -> bool:
        nonlocal end_s
        now_s = machine.clock.now_s()
        end_s = min(end_s, now_s + duration_s)
        return now_s < end_s

    return keep_going


def _key_held_check(machine: OpenArm, key: Keys) -> KeepGoing:
    pressed_s = machine.clock.now_s()

    def keep_going() -> bool:
        nonlocal pressed_s
        if " " in key():
            pressed_s = machine.clock.now_s()
        return machine.clock.now_s() - pressed_s < _HOLD_S

    return keep_going
