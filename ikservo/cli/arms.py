"""``ikservo arms``: list the values of ``--arm``; expand a description with macros."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_table
from ikservo.errors import InputError, UnknownNameError
from ikservo.files.writing import write_atomic
from ikservo.model import Model, ModelServo, arm_names, load_model
from ikservo.model.urdf_xml import expand_xacro

__all__ = ["command"]

_CONVENTION = "x forward, y left, z up, origin on the first axis at the mounting surface"


ACTIONS = ("list", "expand")
Action = Annotated[
    str,
    typer.Argument(
        metavar="[list|expand]",
        help="list: list the arms. expand: write the URDF of a xacro file; runs code in it.",
    ),
]
File = Annotated[Path | None, typer.Argument(metavar="FILE", help="Xacro file to expand.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing URDF.")]


def command(
    action: Action = "list",
    file: File = None,
    *,
    overwrite: Overwrite = False,
    json: JsonOption = False,
) -> None:
    """List the arms that ship with ikservo; expand a description with macros.

    A path to an arm.toml works wherever a name does.

    ikservo arms expand arm.urdf.xacro      writes arm.urdf; only for files that you trust
    """
    if action not in ACTIONS:
        raise UnknownNameError("action", action, ACTIONS)
    if (file is None) == (action == "expand"):
        raise InputError(
            "No file to expand." if file is None else f"{action} takes no file.",
            "Expand a description with macros: ikservo arms expand arm.urdf.xacro",
        )
    if file is not None:
        path = _expand(file, overwrite=overwrite)
        if json:
            print_json("arms-expand", path=path)
        else:
            print_lines([f"Written to {path}"])
        return
    models = [load_model(name) for name in arm_names()]
    if json:
        print_json("arms", arms=[_arm_metadata(model) for model in models])
        return
    rows = [
        [
            model.name,
            model.title,
            str(model.chain.dof),
            _format_servos(model),
            ", ".join(model.poses),
        ]
        for model in models
    ]
    print_table(["name", "arm", "joints", "servos", "poses"], rows)
    frames = [["all others", _CONVENTION]]
    frames[:0] = [[model.name, model.base_frame] for model in models if model.base_frame]
    print_lines([""])
    print_table(["name", "base frame"], frames)


def _expand(file: Path, *, overwrite: bool) -> Path:
    path = file.with_suffix("") if file.suffix == ".xacro" else file
    path = path if path.suffix == ".urdf" else path.with_suffix(".urdf")
    if path == file:
        path = file.with_name(f"{file.stem}.expanded.urdf")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists already.", "Replace it with --overwrite.")
    write_atomic(path, expand_xacro(file))
    return path


def _arm_metadata(model: Model) -> dict[str, object]:
    return {
        "name": model.name,
        "title": model.title,
        "joints": list(model.chain.names),
        "servos": {servo.id: servo.model for servo in _all_servos(model)},
        "poses": list(model.poses),
        "family": model.family,
        "baud_rate": model.baud_rate,
        "base_frame": model.base_frame or _CONVENTION,
        "path": str(model.path),
    }


def _format_servos(model: Model) -> str:
    counts: dict[str, int] = {}
    for servo in _all_servos(model):
        counts[servo.model] = counts.get(servo.model, 0) + 1
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _all_servos(model: Model) -> list[ModelServo]:
    return [servo for joint in model.joints for servo in (joint.servo, *joint.shadows)]
