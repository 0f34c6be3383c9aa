"""``ikservo pick``: pick up the block at a pixel of the camera, or a thing at a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from ikservo.arm.opening import require_own_port
from ikservo.cli.open_and_confirm import confirm_motion, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, ServoConnection, SpeedOption
from ikservo.cli.quantities import parse_length_m, parse_pixels
from ikservo.cli.terminal import format_port, print_status
from ikservo.errors import InputError

At = Annotated[
    list[str],
    typer.Argument(metavar="U V | X Y Z", help="A pixel, or the middle of the thing to pick up."),
]
To = Annotated[str | None, typer.Option("--to", metavar="U,V|X,Y,Z", help="Where to put it down.")]
Camera = Annotated[
    str | None,
    typer.Option("--camera", metavar="SOURCE", help="The camera, as in its calibration."),
]


def command(
    at: At,
    *,
    connection: ServoConnection,
    to: To = None,
    camera: Camera = None,
    speed: SpeedOption = "normal",
    options: Annotated[MotionOptions, Without("dry_run", "json", "tip")],
) -> None:
    """Pick up the coloured block at a pixel of the calibrated camera, or the thing at X Y Z.

    ikservo pick 480 360 --to 600,300 --arm so101

    ikservo pick 0.24 0.05 20mm --to 0.2,-0.1,20mm
    """
    thing: Any = _parse(at)
    place: Any = None if to is None else _parse(to.split(","))
    with open_from_options(connection, options) as machine:
        arm: Any = require_own_port(machine)  # with what apps add
        seeing = arm.camera if camera is None else arm.camera.named("", camera)
        thing = seeing.block_at(*thing) if len(thing) == 2 else thing
        on_table = place is not None and len(place) == 2
        if place is not None and on_table:  # before anything is picked up
            place = seeing.point_seen(*place).point_m
        print_status(
            f"{arm.model.title} on {format_port(arm.port_name)}: pick up at {' '.join(at)}."
        )
        confirm_motion(machine, yes=options.yes)
        arm.pick(thing, speed=speed)
        if place is not None:
            x, y, z = place
            arm.place((x, y, z + on_table * arm.grip.height_m / 2.0), speed=speed)
    print_status("Picked up." if place is None else "Picked up and put down.")


def _parse(parts: Sequence[str]) -> list[float]:
    """Return a pixel (2,), or a point (3,) [m]."""
    if len(parts) not in (2, 3):
        found = f"{' '.join(parts)} is neither a pixel nor a point."
        raise InputError(found, "Give U V, or X Y Z.")
    return [(parse_pixels if len(parts) == 2 else parse_length_m)(each) for each in parts]
