"""Arguments for every public method of an arm, from its signature.

A new method is in the matrix as soon as the names of its required parameters are known here; an
unknown parameter fails the test that lists the methods.
"""

import inspect
import itertools

import numpy as np

from ikservo.arm import Arm
from ikservo.guard import StopKind, StopReason
from ikservo.model.tool import tool_frame
from ikservo.planning.motions import MoveJoints, Wait
from tests.journeys.command_arguments import usual_target_m
from tests.journeys.recordings import write_wave_recording

# Methods whose calls need another one first, or a program of their own.
LISTENING = ("listen",)  # opens a socket; tests/arm/test_control_socket.py
PLUGGED = ("reconnect",)  # needs a cable that was pulled; tests/arm/test_faults_in_motion.py


def methods():
    """Return the name of every public method of an arm."""
    found = inspect.getmembers(Arm, inspect.isfunction)
    return tuple(name for name, _ in found if not name.startswith("_"))


def parameters(name):
    """Return the parameters of a method except self and its options, which have defaults."""
    found = list(inspect.signature(getattr(Arm, name)).parameters.values())[1:]
    return [each for each in found if each.kind is not inspect.Parameter.VAR_KEYWORD]


def arguments(name, arm, folder):
    """Return the required arguments of a method, for this arm.

    Raises:
        LookupError: A parameter has no value here.
    """
    values = {}
    for parameter in parameters(name):
        if (name, parameter.name) in _OWN:
            values[parameter.name] = _OWN[name, parameter.name](arm, folder)
        elif parameter.default is inspect.Parameter.empty:
            if parameter.name not in _VALUES:
                raise LookupError(
                    f"No value for {parameter.name!r} of arm.{name}(); add it to {__name__}."
                )
            values[parameter.name] = _VALUES[parameter.name](arm, folder)
    return values | _OPTIONS.get(name, {})


def _some_joints(arm, _):
    joint = arm.chain.names[-1]
    return {joint: arm.model.pose("home")[joint] + 0.05}


def _points(arm, _):
    return [_target(arm), arm.chain.forward(arm.model.chain_pose("home"))[:3, 3]]


def _beside(arm, _=None):
    """Return a point 2 cm beside the target at its height, because planar arms reach no other."""
    return _target(arm) + np.array([-0.02, 0.015, 0.0])


def _ahead_of_home(arm, _):
    """Return a point that the tool points at in the pose home."""
    T = arm.chain.forward(arm.model.chain_pose("home"))
    return T[:3, 3] + 0.2 * T[:3, :3] @ tool_frame(arm.model).approach_axis


def _target(arm, _=None):
    return np.array(usual_target_m(arm.model.name))


class _Silent:
    """A source of goals that ends at once."""

    def next_goal(self, _):
        return None


def _wave(arm, folder):
    write_wave_recording(arm.model.name, folder / "wave.jsonl")
    return folder / "wave.jsonl"


def _leader(arm, _):
    import ikservo

    return ikservo.open_arm(arm.model.name, port="sim:?pose=home")


def _stop_after_20():
    calls = itertools.count()
    return lambda *_: next(calls) > 20


_VALUES = {
    "position_m": _target,
    "point_m": _ahead_of_home,
    "points_m": _points,
    "strokes_m": lambda arm, _: [[_target(arm), _beside(arm)]],
    "positions": _some_joints,
    "motion": lambda arm, folder: MoveJoints(_some_joints(arm, folder)),
    "plan": lambda arm, folder: arm.plan_joints(_some_joints(arm, folder)),
    "speed": lambda *_: "slow",
    "name": lambda *_: "home",
    "pose": lambda *_: "rest",
    "targets": lambda *_: iter(()),
    "source": lambda *_: _Silent(),
    "leader": _leader,
    "what": lambda arm, _: arm.chain.names[0],
    "joints": lambda arm, _: arm.chain.names,
    "period_s": lambda *_: 0.02,
    "until": lambda *_: _stop_after_20(),
    "wanted": lambda *_: _continue_for_20(),
}
_OPTIONS = {  # planar arms stay in their plane
    "draw": {"lift_m": 0.0},
    "plan_drawing": {"lift_m": 0.0},
}
_OWN = {
    ("record", "path"): lambda _, folder: folder / "new.jsonl",
    ("record", "duration_s"): lambda *_: 0.1,
    ("replay", "path"): _wave,
    ("load_replay", "path"): _wave,
    ("start", "motion"): lambda *_: Wait(0.1),  # nothing moves after the call
    ("execute", "plan"): lambda arm, _: arm.plan_to(_target(arm)),
    ("request_stop", "reason"): lambda *_: StopReason(StopKind.PROGRAM, "enough"),
    ("teach", "name"): lambda *_: "cup",
    ("follow_arm", "until"): lambda *_: _stop_after_20(),
    ("plan_arc", "via_m"): _beside,
    ("plan_arc", "end_m"): _target,
    ("move_arc", "via_m"): _beside,
    ("move_arc", "end_m"): _target,
    ("gripper", "to"): lambda *_: "open",
}


def _continue_for_20():
    calls = itertools.count()
    return lambda *_: next(calls) < 20
