"""Control of robot arms built from serial bus servos.

::

    import ikservo

    model = ikservo.load_model("so101")
    result = ikservo.solve(model.chain, ikservo.Target((0.25, 0.05, 0.15)))
    with ikservo.open_arm("so101", port="sim") as arm:
        report = arm.move_to((0.25, 0.05, 0.15))

Positions are metres in the arm's base frame, joints radians (metres for prismatic joints). Names
are imported when they are first used, so that the command line starts at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from ikservo.arm import Arm, MotionPlan, OpenArm, PathConstraint, ToolOrientation, open_arm
    from ikservo.errors import (
        AimError,
        BadReplyError,
        BadValueError,
        BlockedError,
        BusError,
        CalibrationError,
        CartesianPathError,
        CollisionError,
        ConstraintError,
        ExitCode,
        FileFormatError,
        HeldUpError,
        IkservoError,
        InputError,
        LatchedStopError,
        LeaseLostError,
        NoPortError,
        NotSettledError,
        OrientationError,
        PictureError,
        PortBusyError,
        PortError,
        PortLostError,
        RefusedError,
        RegisterAccessError,
        ServoAlarmError,
        ServoRejectedError,
        ServoSilentError,
        StoppedError,
        UnknownNameError,
        UnreachableError,
    )
    from ikservo.files.drawing import Drawing, read_drawing
    from ikservo.files.writing import FileWriteError
    from ikservo.ik import Posture, Result, Solver, Target, solve
    from ikservo.ik.batch import solve_batch
    from ikservo.kinematics import Chain
    from ikservo.model import Model, arm_names, load_model

__all__ = [
    "AimError",
    "Arm",
    "BadReplyError",
    "BadValueError",
    "BlockedError",
    "BusError",
    "CalibrationError",
    "CartesianPathError",
    "Chain",
    "CollisionError",
    "ConstraintError",
    "Drawing",
    "ExitCode",
    "FileFormatError",
    "FileWriteError",
    "HeldUpError",
    "IkservoError",
    "InputError",
    "LatchedStopError",
    "LeaseLostError",
    "Model",
    "MotionPlan",
    "NoPortError",
    "NotSettledError",
    "OpenArm",
    "OrientationError",
    "PathConstraint",
    "PictureError",
    "PortBusyError",
    "PortError",
    "PortLostError",
    "Posture",
    "RefusedError",
    "RegisterAccessError",
    "Result",
    "ServoAlarmError",
    "ServoRejectedError",
    "ServoSilentError",
    "Solver",
    "StoppedError",
    "Target",
    "ToolOrientation",
    "UnknownNameError",
    "UnreachableError",
    "arm_names",
    "load_model",
    "open_arm",
    "read_drawing",
    "solve",
    "solve_batch",
]

# Modules of the names in `__all__` that are not in `errors`.
_HOMES = {
    "Arm": "arm",
    "Chain": "kinematics",
    "Drawing": "files.drawing",
    "FileWriteError": "files.writing",
    "Model": "model",
    "OpenArm": "arm",
    "MotionPlan": "arm",
    "PathConstraint": "arm",
    "Posture": "ik",
    "Result": "ik",
    "Solver": "ik",
    "ToolOrientation": "arm",
    "Target": "ik",
    "arm_names": "model",
    "load_model": "model",
    "open_arm": "arm",
    "read_drawing": "files.drawing",
    "solve": "ik",
    "solve_batch": "ik.batch",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  # apps add names
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415  # slow to import

        return version("ikservo")
    if name in __all__:
        value = getattr(import_module(f"ikservo.{_HOMES.get(name, 'errors')}"), name)
    else:
        value = _find_in_apps(name)
    globals()[name] = value  # later look-ups do not come here
    return value


def _find_in_apps(name: str) -> Any:  # noqa: ANN401
    if not name.startswith("_"):
        from ikservo.app_discovery import all_apps, load_place  # noqa: PLC0415  # of --help, too

        for app in all_apps():
            if name in app.names:
                return load_place(app.names[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)


def __dir__() -> list[str]:
    from ikservo.app_discovery import all_apps  # noqa: PLC0415

    return sorted([*__all__, *(name for app in all_apps() for name in app.names)])
