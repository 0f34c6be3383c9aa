"""``ikservo arms``: list the names of arms that the option ``--arm`` accepts."""

from __future__ import annotations

from collections import Counter

from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.errors import FileFormatError
from ikservo.model import Model, ModelServo, arm_names, load_model

_CONVENTION = "x forward, y left, z up, origin on the first axis at the mounting surface"


def command(*, json: JsonOption = False) -> None:
    """List the arms that ship with ikservo, and those of other packages.

    A path to an arm's folder can be used wherever a name can.

    ikservo arms new mine --from robot.urdf        makes the folder of a new arm
    """
    models: list[Model] = []
    for name in arm_names():
        try:
            models.append(load_model(name))
        except FileFormatError as error:  # in another package; the other arms are still listed
            print_status(f"Warning: {error.command_message}")
    if json:
        arms = [
            {
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
            for model in models
        ]
        print_json("arms", arms=arms)
        return
    rows: list[list[str]] = []
    for model in models:
        counts = Counter(servo.model for servo in _all_servos(model))
        servos = ", ".join(f"{count} {name}" for name, count in counts.items())
        joints, poses = str(model.chain.dof), ", ".join(model.poses)
        rows.append([model.name, model.title, joints, servos, poses])
    print_table(["name", "arm", "joints", "servos", "poses"], rows)
    frames = [["all others", _CONVENTION]]
    frames[:0] = [[model.name, model.base_frame] for model in models if model.base_frame]
    print_lines([""])
    print_table(["name", "base frame"], frames)


def _all_servos(model: Model) -> list[ModelServo]:
    return [servo for joint in model.joints for servo in (joint.servo, *joint.shadows)]
