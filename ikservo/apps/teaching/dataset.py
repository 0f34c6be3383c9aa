"""``ikservo import dataset`` and ``ikservo export dataset``: convert episodes and recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ikservo.apps.teaching.dataset_reading import Dataset, read_dataset
from ikservo.apps.teaching.dataset_writing import write_dataset
from ikservo.apps.teaching.lerobot_positions import positions_of_lerobot
from ikservo.apps.teaching.lerobot_values import JointValues
from ikservo.apps.teaching.recorder import read_recording, recording_header
from ikservo.apps.teaching.recording import RecordingWriter
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.lerobot import find_lerobot, read_lerobot
from ikservo.calibration.paths import calibrations_of
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import CalibrationError, FileFormatError, InputError
from ikservo.files.writing import FileWriteError, make_folder
from ikservo.kinematics.arrays import Matrix
from ikservo.model import Model

_OWN_TYPES = ("ikservo",)  # robots whose values refer to the zeros of the geometry


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """Options for converting episodes to recordings."""

    to: Annotated[
        Path, typer.Option("--to", metavar="FOLDER", help="Folder for the recordings.")
    ] = Path()
    what: Annotated[
        str,
        typer.Option(
            "--what",
            metavar="state|action",
            help="Import the measured or the commanded joints.",
        ),
    ] = "state"
    calibration: Annotated[
        str,
        typer.Option(
            "--calibration",
            metavar="ID|FILE",
            help="LeRobot calibration used when the data were recorded.",
        ),
    ] = ""  # empty: the data were recorded by ikservo
    percent: Annotated[
        bool,
        typer.Option("--percent", help="Data were recorded with use_degrees=false (-100 to 100)."),
    ] = False


def import_dataset(model: Model, folder: Path, options: DatasetOptions, *, json: bool) -> None:
    """Write each episode as a recording of the arm; write nothing if one fails.

    Raises:
        IkservoError: The data set, a calibration or the folder cannot be used.
    """
    dataset = read_dataset(folder, options.what)
    episodes = [_positions(episode.values, dataset, model, options) for episode in dataset.episodes]
    header = recording_header(model, 1.0 / dataset.fps)
    paths = [options.to / f"{folder.resolve().name}-{e.number:03d}.jsonl" for e in dataset.episodes]
    for path in paths:
        if path.exists():
            raise InputError(f"File {path} exists.", "Give another folder with --to.")
    make_folder(options.to)
    try:
        for path, episode, positions in zip(paths, dataset.episodes, episodes, strict=True):
            with RecordingWriter(path, header) as writer:
                for time_s, q in zip(episode.times_s - episode.times_s[0], positions, strict=True):
                    writer.write(float(time_s), q)
    except BaseException as error:
        for path in paths:
            path.unlink(missing_ok=True)
        if isinstance(error, FileWriteError):
            raise FileWriteError(error.path, error.why, kept="No episode was written") from error
        raise
    if json:
        print_json("import-dataset", robot_type=dataset.robot_type, fps=dataset.fps,
                   recordings=[str(path) for path in paths])  # fmt: skip
        return
    for path, episode in zip(paths, dataset.episodes, strict=True):
        span_s = float(np.ptp(episode.times_s))
        print_lines([f"{path}  {len(episode.times_s)} samples, {span_s:.1f} s"])


def export_dataset(
    model: Model, recordings: Sequence[Path], to: Path | None, fps: int | None, task: str
) -> None:
    """Write recordings as the episodes of a new data set.

    Raises:
        InputError: No recording or no folder is given.
    """
    if not recordings:
        raise InputError(
            "No recording is given.", "Name one or more: ikservo export dataset wave.jsonl"
        )
    if to is None:
        raise InputError("No folder is given.", "Give a new one with --to.")
    frames = write_dataset(to, model, [read_recording(path) for path in recordings], fps, task)
    print_lines([f"{to}: {len(recordings)} episodes, {frames} frames"])


def _positions(values: Matrix, dataset: Dataset, model: Model, options: DatasetOptions) -> Matrix:
    if options.calibration:
        joints = read_lerobot(find_lerobot(options.calibration))
        found = calibrations_of(model.name)
        if not found:
            raise CalibrationError(
                f"{model.name} is not calibrated, so its zeros are not known.",
                "Calibrate it, or import LeRobot's ranges: ikservo import lerobot ID",
            )
        newest = max((read_calibration(path) for path in found), key=lambda own: own.written)
        return positions_of_lerobot(
            values, dataset.joints, joints, newest, model, percent=options.percent
        )
    if dataset.robot_type not in _OWN_TYPES:
        raise CalibrationError(
            f"{dataset.folder} was recorded with {dataset.robot_type or 'an unknown robot'}, "
            "whose zeros are the middle of each swept range.",
            "Give the id or file of that arm in LeRobot: --calibration ID",
        )
    own = JointValues(model)
    if set(own.names) != set(dataset.joints):
        found = f"has the joints {', '.join(dataset.joints)}"
        raise FileFormatError(
            dataset.folder, "", found, f"those of {model.name}: {', '.join(own.names)}"
        )
    return own.rows_to_positions(values[:, [dataset.joints.index(name) for name in own.names]])
