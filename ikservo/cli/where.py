"""``ikservo where``: the measured tip, joints, limits and health."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm import JointState, Whereabouts
from ikservo.arm.owner.elsewhere import ask_where
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption, UncalibratedOption
from ikservo.cli.output import point, print_json, print_lines, print_table
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.session import opened
from ikservo.model import Model

__all__ = ["command"]

Watch = Annotated[bool, typer.Option("--watch", help="Go on until Ctrl-C, joints as bars.")]
Interval = Annotated[
    float, typer.Option("--interval", parser=parse_time_s, help="Between two looks: 200ms.")
]
Times = Annotated[int | None, typer.Option("--times", min=1, help="End after so many looks.")]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    watch: Watch = False,
    interval: Interval = 0.2,
    times: Times = None,
    uncalibrated: UncalibratedOption = False,
    json: JsonOption = False,
) -> None:
    """Say where the arm is, measured by its servos; nothing moves.

    Where another program of yours has the port, that one is asked.
    """
    model = chosen_model(arm)
    if watch:
        from ikservo.cli.watching import watch_arm  # noqa: PLC0415  # draws with rich

        watch_arm(model, port, interval, times, uncalibrated=uncalibrated, json=json)
        return
    here = ask_where(model, port)
    if here is None:
        with opened(arm, port, uncalibrated=uncalibrated) as machine:
            here = machine.where()
    if json:
        print_json("where", tip_m=here.tip_m, joints=here.joints)
    else:
        _print(here, model)


def _print(here: Whereabouts, model: Model) -> None:
    print_lines([f"tip {point(here.tip_m.tolist())}", ""])
    columns = ["joint", "position", "lower", "upper", "limits from", "°C", "V", "load", "torque"]
    print_table([*columns, "alarms"], [_row(state, model) for state in here.joints])


def _row(state: JointState, model: Model) -> list[str]:
    say = model.joint(state.name).joint_map.say
    return [
        state.name,
        *(say(value) for value in (state.position_rad, state.lower_rad, state.upper_rad)),
        state.limit_from,
        f"{state.temperature_c:.0f}",
        f"{state.voltage_v:.1f}",
        "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
        "on" if state.torque else "off",
        ", ".join(state.alarms),
    ]
