"""Every public method refuses hostile values of every parameter with an error of ikservo."""

import inspect
import math
import warnings

import pytest

import ikservo
from ikservo.errors import IkservoError

HOSTILE = [
    math.nan, math.inf, 1e308, -1, None, [], {}, b"x", "\0", "", "x" * 5000, 10**400, object(),
    [math.nan] * 3, [[1e308] * 3] * 3,
]  # fmt: skip
# Parts of ikservo call these for each other, with values that it has made.
INTERNAL = {"follow_goals", "is_of_same_arm", "request_stop", "take_over"}
# What ends the arm, waits for a hand, or takes another arm's place.
LEFT_OUT = {"close", "teach", "enable"}
VALID = {
    "positions": {"gripper": 0.5}, "position_m": (0.22, 0.0, 0.15), "point_m": (0.25, 0.0, 0.1),
    "points_m": [(0.22, 0.0, 0.15)], "strokes_m": [[(0.2, 0.0, 0.1), (0.22, 0.0, 0.1)]],
    "name": "cup", "pose": "home", "targets": [], "period_s": 0.1, "joints": ["gripper"],
    "until": None, "kind": "box", "path": "none.toml", "at_m": (1.0, 1.0, 0.0), "what": "gripper",
    "wanted": lambda *_: False,
}  # fmt: skip


def public_methods(part):
    for name, member in inspect.getmembers_static(type(part)):
        if not name.startswith("_") and name not in INTERNAL | LEFT_OUT and callable(member):
            yield name, getattr(part, name)


def hostile_calls(method):
    """Yield the arguments of calls: one argument hostile each time, then all of them."""
    parameters = inspect.signature(method).parameters.values()
    named = [
        each for each in parameters if each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)
    ]
    required = {each.name: VALID.get(each.name) for each in named if each.default is each.empty}
    for value in HOSTILE if named else ():
        yield dict.fromkeys(required, value)
        for each in named:
            if each.name != "wait":
                yield {**required, each.name: value}


def call(method, arguments):
    given = dict(arguments)
    first = [p.name for p in inspect.signature(method).parameters.values()
             if p.kind is p.POSITIONAL_ONLY and p.name in given]  # fmt: skip
    made = method(*[given.pop(name) for name in first], **given)
    if hasattr(made, "cancel"):
        made.cancel()


@pytest.mark.full
@pytest.mark.timeout(600)
@pytest.mark.parametrize("part", ["arm", "scene"])
def test_arm_and_scene_methods_refuse_hostile_values(part, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wrong = []
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm, warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, method in public_methods(arm if part == "arm" else arm.scene):
            for arguments in hostile_calls(method):
                try:
                    call(method, arguments)
                except IkservoError:
                    pass
                except Exception as error:
                    wrong.append(f"{name}({str(arguments)[:200]}): {error!r}")
            arm.acknowledge()
    assert not wrong, "\n".join(wrong[:40])
