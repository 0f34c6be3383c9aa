"""``ikservo gripper --weigh``: weigh the object in the gripper."""

from __future__ import annotations

from ikservo.apps.lab.arm_identification import QUICK_TOUR, IdentificationRun
from ikservo.apps.lab.identify_command import announce_tour, record_tour
from ikservo.arm.opening import require_own_port
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.terminal import print_json, print_lines, print_status


def weigh_held_object(connection: ArmConnection, options: MotionOptions) -> None:
    """Weigh the object in the gripper by a short tour of the arm, and print its mass.

    Raises:
        IkservoError: The arm cannot make the tour, or the user declined.
    """
    with open_from_options(connection) as machine:
        run = IdentificationRun.plan(require_own_port(machine), QUICK_TOUR)
        announce_tour(run, options)
        result = run.weigh(record_tour(run))
    payload = result.payload
    if options.json:
        print_json(
            "weigh",
            payload_kg=payload.value,
            error_kg=payload.error,
            determined=payload.determined,
            identified=result.with_identified,
        )
        return
    if not result.with_identified:
        print_status(
            "This arm was not identified, so its own masses are taken from the arm file. "
            f"With empty jaws, run: ikservo identify --arm {machine.model.name}"
        )
    print_lines([f"payload  {1000 * payload.value:.0f} ± {1000 * payload.error:.0f} g"])
