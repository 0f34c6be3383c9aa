"""``ikservo jog``: a joint or the tip goes on while a key is held, or for a time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Annotated

import typer

from ikservo.arm import Arm
from ikservo.arm.skills.jogging import DIRECTIONS, JogReport, Wanted
from ikservo.cli.calibrating.wiggle import check_once
from ikservo.cli.keyboard import keys
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    JsonOption,
    NoWiggleOption,
    PortOption,
    UncalibratedOption,
    YesOption,
)
from ikservo.cli.output import note, point, print_json, print_lines
from ikservo.cli.quantities import parse_angle_rad, parse_length_m, parse_time_s
from ikservo.cli.session import opened
from ikservo.errors import InputError

__all__ = ["command"]

_HOLD_S = 0.6  # a held key repeats only after up to half a second

What = Annotated[
    str, typer.Argument(metavar="JOINT|DIRECTION", help="A joint, or x y z -x -y -z up down.")
]
Speed = Annotated[
    str | None,
    typer.Option("--speed", help="10 is 10°/s of a joint; 20mm is 20 mm/s of the tip or a slide."),
]
Time = Annotated[
    float | None,
    typer.Option("--time", parser=parse_time_s, help="So long, without keys: 2, 0.5s."),
]


def command(
    what: What,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: Speed = None,
    time: Time = None,
    collision: CollisionOption = True,
    uncalibrated: UncalibratedOption = False,
    no_wiggle: NoWiggleOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Let a joint or the tip go on in one direction, for as long as you hold the space bar.

    Let go and it stops. A negative speed goes the other way; --time needs no key.

    ikservo jog elbow_flex --speed -10 --time 1 --arm so101 --port sim

    ikservo jog x --speed 20mm
    """
    if time is None and not sys.stdin.isatty():
        raise InputError("Nobody is here to hold a key.", "Give --time, as in --time 1.")
    with opened(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        wished = _speed(machine, what, speed)
        if not no_wiggle:
            check_once(machine, yes=yes)
        with _wanted(machine, time) as wanted:
            report = machine.jog(what, wished, wanted=wanted)
    _print(report, json=json)


def _speed(machine: Arm, what: str, speed: str | None) -> float | None:
    if speed is None:
        return None
    slides = what in DIRECTIONS and what not in machine.workings.servos.names
    if not slides and what in machine.workings.servos.names:
        slides = machine.model.joint(what).joint_map.unit == "m"
    return parse_length_m(speed) if slides else parse_angle_rad(speed)


@contextmanager
def _wanted(machine: Arm, time_s: float | None) -> Generator[Wanted]:
    """Yield what says whether to go on: a clock, or a key that is held."""
    if time_s is not None:
        end_s = machine.workings.now_s() + time_s
        yield lambda: machine.workings.now_s() < end_s
        return
    note("Hold the space bar to move, let go to stop.")
    with keys() as key:
        while key() != " ":
            pass
        yield _held(machine, key)


def _held(machine: Arm, key: Callable[[], str]) -> Wanted:
    pressed_s = machine.workings.now_s()

    def wanted() -> bool:
        nonlocal pressed_s
        if key() == " ":
            pressed_s = machine.workings.now_s()
        return machine.workings.now_s() - pressed_s < _HOLD_S

    return wanted


def _print(report: JogReport, *, json: bool) -> None:
    if json:
        print_json(
            "jog",
            ended=report.ended,
            measured_rad=report.measured_rad,
            measured_tip_m=report.measured_tip_m,
            duration_s=report.duration_s,
        )
        return
    print_lines(
        [
            f"ended     {report.ended}",
            f"tip       {point(report.measured_tip_m.tolist())}",
            f"duration  {report.duration_s:.2f} s",
        ]
    )
