"""``ikservo import recording``: import the calibration in a recording for this arm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.calibrating.calibration_command import import_recorded
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection, YesOption

Recording = Annotated[Path, typer.Argument(metavar="FILE", help="An MCAP recording.")]


def command(
    file: Recording,
    *,
    connection: ServoConnection,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Import the calibration with which a recording was made.

    ikservo import recording wave.mcap --arm so101
    """
    model = model_from_option(connection.arm)
    import_recorded(model, connection.port, file, yes=yes, json=json)
