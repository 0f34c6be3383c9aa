"""``ikservo where``: the measured tip, joints, limits and health."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from ikservo.arm import JointState, Whereabouts
from ikservo.arm.owner.elsewhere import ask_where
from ikservo.calibration import source_words
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption, UncalibratedOption
from ikservo.cli.output import point, print_json, print_lines, print_table
from ikservo.cli.quantities import parse_point_m, parse_time_s
from ikservo.cli.reports.conditioning import posture_fields, posture_lines
from ikservo.cli.session import opened
from ikservo.errors import InputError
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

if TYPE_CHECKING:
    from ikservo.cli.reports.visibility import Sights

__all__ = ["command"]

Watch = Annotated[bool, typer.Option("--watch", help="Repeat until Ctrl-C, joints as bars.")]
Interval = Annotated[
    float, typer.Option("--interval", parser=parse_time_s, help="Between two readings: 200ms.")
]
VisibleFrom = Annotated[
    str | None,
    typer.Option(
        "--visible-from",
        metavar="X,Y,Z",
        help="Say which links a camera, or a marker, at this point sees.",
    ),
]
Times = Annotated[int | None, typer.Option("--times", min=1, help="End after so many readings.")]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    watch: Watch = False,
    interval: Interval = 0.2,
    times: Times = None,
    visible_from: VisibleFrom = None,
    uncalibrated: UncalibratedOption = False,
    json: JsonOption = False,
) -> None:
    """Show where the arm is, measured by its servos; nothing moves.

    If another ikservo program uses the port, that one is asked.

    ikservo where --arm so101 --port sim --visible-from 0.6,0.3,0.4
    """
    model = chosen_model(arm)
    eye_m = None if visible_from is None else parse_point_m(visible_from)
    if watch and eye_m is not None:
        raise InputError("--visible-from cannot be combined with --watch.", "Omit --watch.")
    if watch:
        from ikservo.cli.watching import watch_arm  # noqa: PLC0415  # draws with rich

        watch_arm(model, port, interval, times, uncalibrated=uncalibrated, json=json)
        return
    here = ask_where(model, port)
    if here is None:
        with opened(arm, port, uncalibrated=uncalibrated) as machine:
            here = machine.where()
    sights = None if eye_m is None else _sights(model, here, eye_m)
    if json:
        more = posture_fields(model.chain, _q(here, model))
        more |= {} if sights is None else {"visible_from": sights.fields()}
        print_json("where", tip_m=here.tip_m, joints=here.joints, **more)
        return
    _print(here, model)
    if sights is not None:
        sights.print()


def _sights(model: Model, here: Whereabouts, eye_m: tuple[float, float, float]) -> Sights:
    from ikservo.cli.reports.visibility import Sights  # noqa: PLC0415  # few ask, numba loads

    return Sights.of(model, here.positions, eye_m)


def _print(here: Whereabouts, model: Model) -> None:
    posture = posture_lines(model.chain, _q(here, model))
    print_lines([f"tip {point(here.tip_m.tolist())}", *posture, ""])
    columns = ["joint", "position", "lower", "upper", "°C", "V", "load", "torque"]
    print_table(columns, [_row(state, model) for state in here.joints])
    print_lines(["", *_limit_lines(here), *_alarm_lines(here)], indent=4)


def _limit_lines(here: Whereabouts) -> list[str]:
    """Return where the limits come from: each source with its joints, or one for all."""
    sources: dict[str, list[str]] = {}
    for state in here.joints:
        sources.setdefault(source_words(state.limit_from), []).append(state.name)
    if len(sources) == 1:
        return [f"limits: {next(iter(sources))}"]
    return [f"limits: {source} ({', '.join(joints)})" for source, joints in sources.items()]


def _alarm_lines(here: Whereabouts) -> list[str]:
    return [f"alarm: {s.name}: {', '.join(s.alarms)}" for s in here.joints if s.alarms]


def _q(here: Whereabouts, model: Model) -> Vector:
    """Return the measured joints (dof,) of the chain, without the gripper's."""
    return np.array([here[name].position_rad for name in model.chain.names])


def _row(state: JointState, model: Model) -> list[str]:
    say = model.joint(state.name).joint_map.say
    return [
        state.name,
        *(say(value) for value in (state.position_rad, state.lower_rad, state.upper_rad)),
        f"{state.temperature_c:.0f}",
        f"{state.voltage_v:.1f}",
        "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
        "on" if state.torque else "off",
    ]
