"""Arguments for every command, from its parameters.

A new command is in the matrix as soon as the names of its parameters are known here; an unknown
parameter fails the test that lists the commands.
"""

import itertools
from functools import cache

import numpy as np

from ikservo.cli import command_group
from ikservo.model import load_model

SERVERS = ("view", "sim", "serve", "ros", "mcp")  # end by Ctrl-C or with their input
BY_HAND = ("calibrate", "setup", "import")  # wait for an operator
FILED = ("calibration", "export", "replay")  # work on a file that must exist

_TESTED_APART = (
    "arms new", "net acknowledge", "calibration adopt", "calibration restore", "calibration undo",
    "calibration resume", "calibration revert", "servo read", "servo write", "servo reboot",
    "servo reset", "servo backup", "servo restore", "servo packets", "servo tune",
)  # fmt: skip
# The value of each option, if the command has it. Options that need more hardware or have tests of
# their own are left out.
_OPTIONS = {
    "--arm": "{arm}",
    "--port": "{port}",
    "--yes": None,
    "--quick": None,
    "--duration": "0.3",
    "--now": None,
    "--count": "10",
    "--no-open": None,
    "--wait": "1",
    "--leader-port": "sim",
}
_ARGUMENTS = {
    "x": ["{x}"],
    "y": ["{y}"],
    "z": ["{z}"],
    "u": ["480"],
    "v": ["400"],
    "arm": ["{arm}"],
    "name": ["home"],
    "goals": ["{joint}={degrees}"],
    "file": ["{folder}/wave.jsonl"],
    "leader": ["{arm}"],
    "source": ["my_arm"],
    "kind": ["lerobot"],
    "what": ["bus"],
    "hosts": ["127.0.0.1:9"],
}
_OWN = {  # commands in which a name means something else
    ("scan", "name"): [""],
    ("view", "arms"): [""],
    ("draw", "file"): ["{folder}/stroke.csv"],
    ("teach", "name"): ["cup"],
    ("jog", "what"): ["{joint}", "z"],
    ("gripper", "to"): ["open", "close"],
    ("pick", "at"): ["{x} {y} {z}"],
    ("program new", "file"): ["{folder}/new.toml"],
    ("program check", "file"): ["{folder}/program.toml"],
    ("program run", "file"): ["{folder}/program.toml"],
    ("servo plot", "plotted"): [""],
    ("sim", "arguments"): ["{arm}"],
    ("scene check", "file"): ["{folder}/scene.toml"],
    ("scene show", "file"): ["{folder}/scene.toml"],
    ("import dataset", "folder"): ["{folder}/set"],
}
_NEEDED = {  # options that a command cannot do without
    "arc": ("--via", "{via}"),
    "net keys": ("--folder", "{folder}/keys"),
    "program new": ("--overwrite",),
    "servo table": ("--id", "{joint}"),
    "test": ("--parts", "poses", "--cycles", "2", "--html", "{folder}/test.html"),
    "draw": ("--origin", "{x},{y},{z}", "--lift", "0"),  # planar arms stay in their plane
}
_WHOLE = {  # arguments that depend on each other: their names and the command line
    "camera": (("action", "file"), ["board {folder}/board.pdf"]),  # check, tip: tests/cli
    "export": (
        ("kind", "recordings"),
        ["lerobot", "csv {folder}/wave.jsonl", "dataset {folder}/wave.jsonl --to {folder}/set"],
    ),
}


@cache
def commands():
    """Return the names of all commands except those with tests of their own."""
    return tuple(
        name
        for name, each in command_group.all_commands().items()
        if each.module and name not in _TESTED_APART
    )


@cache
def lines_of(command):
    """Return the argument lines that are typed after a command, with places for the arm.

    Raises:
        LookupError: No value is known for a parameter.
    """
    parameters = _loaded(command).params
    names = tuple(p.name for p in parameters if p.param_type_name == "argument")
    if command in _WHOLE and _WHOLE[command][0] == names:
        lines = [(text,) for text in _WHOLE[command][1]]
    else:
        lines = list(itertools.product(*(_values(command, name) for name in names)))
    options = list(_NEEDED.get(command, ()))
    options += [w for p in parameters for w in _typed(p) if p.param_type_name == "option"]
    return [" ".join((command, *line, *options)) for line in lines]


def filled(line, arm, port, folder):
    """Return the words of a line for one arm, as the shell passes them."""
    model = load_model(arm)
    x, y, z = usual_target_m(arm)
    joint = model.chain.names[-1]
    degrees = round(float(np.degrees(model.pose("home")[joint])) + 3.0, 1)
    text = line.format(
        arm=arm, port=port, folder=folder, x=f"{x:.3f}", y=f"{y:.3f}", z=f"{z:.3f}",
        joint=joint, degrees=degrees, via=f"{x - 0.02:.3f},{y + 0.015:.3f},{z:.3f}",
    )  # fmt: skip
    return text.split()


@cache
def usual_target_m(arm):
    """Return a point (3,) [m] well inside the reach, beside the tip in the pose home."""
    chain, home = load_model(arm).chain, load_model(arm).chain_pose("home")
    return tuple(chain.forward(0.7 * home + 0.05)[:3, 3].tolist())


def _loaded(command):
    return command_group.load_command(command, command_group.all_commands()[command])


def _values(command, name):
    found = _OWN.get((command, name), _ARGUMENTS.get(name))
    if found is None:
        raise LookupError(f"No value for {name!r} of `ikservo {command}`; add it to {__name__}.")
    return found


def _typed(parameter):
    for option in parameter.opts:
        if option in _OPTIONS:
            value = _OPTIONS[option]
            return [option] if value is None else [option, value]
    return []
