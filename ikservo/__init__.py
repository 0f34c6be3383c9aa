"""A box of bus servos becomes an arm that goes where you point.

::

    import ikservo

    model = ikservo.load_model("so101")
    result = ikservo.solve(model.chain, ikservo.Target((0.25, 0.05, 0.15)))
    with ikservo.open_arm("so101", port="sim") as arm:
        report = arm.move_to((0.25, 0.05, 0.15))

Positions are metres in the arm's base frame, joints radians (metres for prismatic ones).
Names are imported when they are first used, so that the command line starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ikservo.arm import Arm, open_arm
    from ikservo.errors import IkservoError
    from ikservo.ik import Result, Solver, Target, solve, solve_batch
    from ikservo.kinematics import Chain
    from ikservo.model import Model, arm_names, load_model

__all__ = [
    "Arm",
    "Chain",
    "IkservoError",
    "Model",
    "Result",
    "Solver",
    "Target",
    "arm_names",
    "load_model",
    "open_arm",
    "solve",
    "solve_batch",
]

_HOMES = {
    "Arm": "arm",
    "Chain": "kinematics",
    "IkservoError": "errors",
    "Model": "model",
    "Result": "ik",
    "Solver": "ik",
    "Target": "ik",
    "arm_names": "model",
    "load_model": "model",
    "open_arm": "arm",
    "solve": "ik",
    "solve_batch": "ik",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'ikservo' has no attribute {name!r}")
    return getattr(import_module(f"ikservo.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
