"""``ikservo arms``: list the values of ``--arm``."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.errors import FileFormatError
from ikservo.model import Model, ModelServo, arm_names, load_model

_CONVENTION = "x forward, y left, z up, origin on the first axis at the mounting surface"


def command(*, json: JsonOption = False) -> None:
    """List the arms that ship with ikservo, and those of other packages.

    A path to an arm's folder works wherever a name does.

    ikservo arms new mine --from robot.urdf        makes the folder of a new arm
    """
    models = list(_readable_models())
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


def _readable_models() -> Iterator[Model]:
    """Yield all arms; an arm of another package with damaged files is named and left out."""
    for name in arm_names():
        try:
            yield load_model(name)
        except FileFormatError as error:
            print_status(f"Warning: {error.command_message}")


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
