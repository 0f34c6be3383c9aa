"""``ikservo import dataset``: convert the episodes of a LeRobotDataset to recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.teaching.dataset import DatasetOptions, import_dataset
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection

DatasetFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="A LeRobotDataset.")]


def command(
    folder: DatasetFolder,
    *,
    connection: ServoConnection,
    dataset: DatasetOptions,
    json: JsonOption = False,
) -> None:
    """Import the episodes of a LeRobotDataset, each as a recording of this arm.

    ikservo import dataset FOLDER --arm so101 --to DIR
    """
    import_dataset(model_from_option(connection.arm), folder, dataset, json=json)
