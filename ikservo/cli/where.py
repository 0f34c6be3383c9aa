"""``ikservo where``: the measured tip, joints, limits and health."""

from __future__ import annotations

from ikservo.arm import JointState, Whereabouts
from ikservo.cli.options import ArmOption, JsonOption, PortOption, UncalibratedOption
from ikservo.cli.output import point, print_json, print_lines, print_table
from ikservo.cli.session import opened
from ikservo.model import Model

__all__ = ["command"]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    uncalibrated: UncalibratedOption = False,
    json: JsonOption = False,
) -> None:
    """Say where the arm is, measured by its servos; nothing moves."""
    with opened(arm, port, uncalibrated=uncalibrated) as machine:
        here = machine.where()
    if json:
        print_json("where", tip_m=here.tip_m, joints=here.joints)
    else:
        _print(here, machine.model)


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
        f"{state.load_percent:.0f} %",
        "on" if state.torque else "off",
        ", ".join(state.alarms),
    ]
