"""``ikservo relax``: the arm lowers itself and lets go."""

from __future__ import annotations

from ikservo.cli.joints import print_report
from ikservo.cli.options import ArmOption, JsonOption, PortOption, YesOption
from ikservo.cli.session import announce, opened, watched

__all__ = ["command"]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Lower the arm to its rest pose, slowly, then switch torque off."""
    with opened(arm, port) as machine:
        rest = machine.model.pose("rest")
        announce(machine.plan_joints(rest, speed="slow"), machine, yes=yes)
        with watched() as draw:
            report = machine.relax(draw)
    print_report(report, machine.model, json=json)
