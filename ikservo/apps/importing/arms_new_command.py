"""``ikservo arms new``: make the folder of a new arm."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from ikservo.apps.importing.building import ImportOptions
from ikservo.apps.importing.draft import ArmDraft, DraftServo
from ikservo.apps.importing.folder import write_drafts
from ikservo.apps.importing.new_arm import NewArm, draft_new_arm
from ikservo.apps.importing.ruler import RulerJoint, parse_measured
from ikservo.apps.importing.servo_assignment import parse_servo
from ikservo.cli.options import JsonOption
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import BadValueError, InputError

Name = Annotated[str, typer.Argument(metavar="NAME", help="Name of the new arm.")]
From = Annotated[
    Path | None,
    typer.Option("--from", metavar="PATH", help="URDF, xacro or MJCF, or a folder with one."),
]
File = Annotated[
    str | None, typer.Option("--file", help="Description to use, if the folder has several.")
]
Joint = Annotated[
    list[str] | None,
    typer.Option(
        "--joint",
        metavar="NAME=AXIS:METRES",
        help="Without --from: one joint. AXIS is x, y or z with the arm upright, METRES the "
        "distance to the next joint. Repeat it for each joint, from base to tip.",
    ),
]
Tip = Annotated[
    list[str] | None,
    typer.Option("--tip", metavar="LINK", help="Link of the tool; repeat it to make several arms."),
]
Base = Annotated[
    str | None,
    typer.Option(
        "--base", metavar="LINK", help="Use only this link and the links that it carries."
    ),
]
BaseFrame = Annotated[
    str | None,
    typer.Option(
        "--base-frame",
        metavar="WORDS",
        help="Placement of the base, such as: rotate 90, raise 0.05",
    ),
]
GripperJoint = Annotated[
    str | None,
    typer.Option(
        "--gripper", metavar="JOINT", help="Joint of the jaws; `none` if there are no jaws."
    ),
]
ServoOf = Annotated[
    list[str] | None,
    typer.Option(
        "--servo",
        metavar="JOINT=ID[:MODEL]",
        help="Servo of a joint; -ID if its ticks fall while the joint position rises. Repeatable.",
    ),
]
ServoModel = Annotated[
    str | None,
    typer.Option(
        "--servo-model", metavar="MODEL", help="Servo model, for servos without a model in --servo."
    ),
]
JointLimits = Annotated[
    list[str] | None,
    typer.Option(
        "--limits", metavar="JOINT=LOW:HIGH", help="Range of a joint, degrees or mm. Repeatable."
    ),
]
Slide = Annotated[
    list[str] | None,
    typer.Option(
        "--m-per-turn",
        metavar="JOINT=METRES",
        help="Travel of a slide in metres per turn; repeatable.",
    ),
]
Package = Annotated[
    list[str] | None,
    typer.Option("--package", metavar="NAME=FOLDER", help="Folder of a ROS package. Repeatable."),
]
XacroArgument = Annotated[
    list[str] | None,
    typer.Option(
        "--xacro-arg", metavar="NAME:=VALUE", help="Argument of a xacro file. Repeatable."
    ),
]
AllowXacro = Annotated[
    bool, typer.Option("--allow-xacro", help="Run the expressions in a xacro file that you trust.")
]
NewPort = Annotated[
    str | None,
    typer.Option(
        "--port",
        metavar="PORT",
        help="Find the servos on this port; those without --servo move a little.",
    ),
]
Folder = Annotated[
    Path, typer.Option("--folder", help="Folder that will contain the arm's folder.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files of an existing arm.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would be written.")]


def command(  # one parameter per option
    name: Name,
    *,
    source: From = None,
    file: File = None,
    joint: Joint = None,
    tip: Tip = None,
    base: Base = None,
    base_frame: BaseFrame = None,
    gripper: GripperJoint = None,
    servo: ServoOf = None,
    servo_model: ServoModel = None,
    limits: JointLimits = None,
    m_per_turn: Slide = None,
    package: Package = None,
    xacro_arg: XacroArgument = None,
    allow_xacro: AllowXacro = False,
    port: NewPort = None,
    folder: Folder = Path(),
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    json: JsonOption = False,
) -> None:
    """Make the folder of a new arm, from a description or from measured joints.

    ikservo arms new mine --from robot.urdf        converts it once; mine/import.md says how

    ikservo arms new mine --joint pan=z:0.05 --joint lift=y:0.12     measured with a ruler
    """
    of_descriptions: dict[str, object] = {"--file": file, "--package": package}
    of_descriptions |= {"--xacro-arg": xacro_arg, "--allow-xacro": allow_xacro}
    ignored = [option for option, value in of_descriptions.items() if value and joint]
    if ignored:
        hint = "Use: ikservo arms new NAME --from FILE"
        raise InputError(f"{', '.join(ignored)} cannot be given with --joint.", hint)
    options = ImportOptions(
        base=base,
        tips=tuple(tip or ()),
        gripper="" if gripper == "none" else gripper,
        base_frame=base_frame,
        limits=dict(_parse_pairs("--limits", limits, _parse_range, "elbow=-90:90")),
        servos=_parse_servos(servo or []),
        servo_model=servo_model,
        m_per_turn=dict(_parse_pairs("--m-per-turn", m_per_turn, _parse_positive, "slide=0.04")),
    )
    new = NewArm(
        name,
        folder,
        source,
        file,
        _parse_joints(joint or []),
        dict(_parse_pairs("--package", package, Path, "NAME=FOLDER")),
        dict(_parse_pairs("--xacro-arg", xacro_arg, str, "NAME:=VALUE", ":=")),
        allow_xacro,
        overwrite,
        options,
        port,
    )
    with exiting_on_signals():  # which then switches the torque of a moved servo off
        drafts = Operator.of(None, yes=False, no_input=json).run(draft_new_arm(new))
    written = [] if dry_run else write_drafts(drafts, folder)
    _print_drafts(drafts, written, folder, json=json)


_Value = TypeVar("_Value")


def _parse_pairs(
    option: str,
    texts: Sequence[str] | None,
    parse: Callable[[str], _Value],
    example: str,
    sign: str = "=",
) -> Iterator[tuple[str, _Value]]:
    """Parse options such as ``NAME=VALUE``."""
    for text in texts or ():
        name, found, value = text.partition(sign)
        try:
            if not (name and found and value):
                raise ValueError
            yield name.strip(), parse(value)
        except ValueError:
            raise BadValueError(option, text, f"a value such as {example}") from None


def _parse_range(text: str) -> tuple[float, float]:
    low, high = (float(part) for part in text.split(":"))
    if not (math.isfinite(low) and math.isfinite(high)):
        raise ValueError
    return low, high


def _parse_positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError
    return value


def _parse_joints(texts: Sequence[str]) -> tuple[RulerJoint, ...]:
    """Parse ``NAME=AXIS:METRES``; refuse a name that is given twice."""
    joints = tuple(parse_measured(text) for text in texts)
    names = [joint.name for joint in joints]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--joint names {name} twice.", "Use each name once.")
    return joints


def _parse_servos(texts: Sequence[str]) -> dict[str, tuple[DraftServo, ...]]:
    """Parse ``JOINT=[-]ID[:MODEL]``; several servos of a joint drive it together."""
    found: dict[str, tuple[DraftServo, ...]] = {}
    for name, servo in _parse_pairs("--servo", texts, parse_servo, "elbow=3:STS3215 or elbow=-3"):
        if any(servo.id == other.id for servos in found.values() for other in servos):
            raise InputError(f"--servo gives the id {servo.id} twice.", "Use each id once.")
        found[name] = (*found.get(name, ()), servo)
    return found


def _print_drafts(
    drafts: Sequence[ArmDraft], written: Sequence[Path], folder: Path, *, json: bool
) -> None:
    if json:
        arms = [
            {
                "name": draft.name,
                "folder": str(folder / draft.name),
                "tip": draft.tip,
                "joints": [joint.name for joint in draft.joints],
                "decisions": draft.decisions,
                "left_out": draft.dropped,
                "files": {name: len(content) for name, content in draft.files().items()},
            }
            for draft in drafts
        ]
        print_json("arms-new", written=[str(path) for path in written], arms=arms)
        return
    for draft in drafts:
        if written:
            print_lines([f"{draft.name}: {len(draft.joints)} joints, tip {draft.tip}"])
            for line in (*draft.decisions, *draft.dropped):
                print_status(f"  {line}")
        else:
            for name, content in draft.files().items():
                size = f"{len(content):,} bytes"
                print_lines([f"--- {folder / draft.name / name}, {size}"])
                if not name.startswith("meshes/"):
                    print_lines(content.decode().splitlines())
    for path in written:
        print_lines([f"Written to {path}/; {path / 'import.md'} lists every decision."])
        print_status(f"Try it: ikservo view --arm {path}/ --port sim")
