"""Draft of a new arm: the decisions about it, and the text of its files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ikservo.apps.importing.shapes import ContactFit
from ikservo.apps.importing.urdf_text import urdf_text
from ikservo.model.urdf_types import Urdf, UrdfJoint, UrdfJointType
from ikservo.registers import MODELS

_EDGE = 0.001  # distance of poses from the limits, as a fraction of the range
_JOINTS_IN_LINE = 32  # a pose with more joints has one line per joint
_USED_TURN = 0.8  # fraction of a servo's turn that is assumed to move a slide over its range
_BAUD = {"feetech_sts": 1_000_000, "feetech_scs": 1_000_000, "dynamixel_2": 1_000_000,
         "dynamixel_1": 1_000_000}  # fmt: skip
# Speeds by name: deg/s, deg/s² and deg/s³.
_SPEEDS = {"slow": (25.0, 50.0, 500.0), "normal": (60.0, 180.0, 1800.0),
           "fast": (120.0, 480.0, 4800.0)}  # fmt: skip


_CONTACT_LINES = (
    "Capsules contain each mesh. If a link has several meshes, the smallest was fitted "
    "first; parts inside its capsules get no capsules of their own.",
    "The excess is the largest distance from a capsule's surface to the meshes of the link:",
    "",
    "| link | mesh | triangles | capsules | excess |",
    "|---|---|---|---|---|",
)


@dataclass(frozen=True, slots=True)
class DraftServo:
    """A servo of a joint: its id, its model, and the sign of its direction of rotation."""

    id: int
    model: str
    sign: int = 1


@dataclass(frozen=True, slots=True)
class DraftJoint:
    """A joint with its servos.

    Attributes:
        name: The name in the URDF.
        is_gripper: Whether it moves the jaws.
        servos: The first servo, and further servos that drive the joint together with it.
        m_per_turn: Metres per turn of the servo; None for a joint that turns.
    """

    name: str
    is_gripper: bool
    servos: tuple[DraftServo, ...]
    m_per_turn: float | None = None


@dataclass(slots=True)
class ArmDraft:
    """The draft of a new arm.

    Attributes:
        name: The arm name.
        source: The name of the description with its geometry.
        urdf: The links and joints, with simple shapes.
        tip: The link of the tool.
        joints: The joints from base to tip, the jaws last.
        baud: Baud rate of the bus, bit/s; 0: the usual rate of the servos.
        supply_v: Supply voltage of servos that are sold for several voltages; None if unknown.
        floor_m: Height of the table in the base frame.
        poses: Joint positions [rad or m] by pose and joint.
        pictures: The content of each mesh file by its name.
        fits: The capsules that were fitted to meshes.
        decisions: The decisions, one sentence each.
        dropped: The parts of the description that were left out, one sentence each.
    """

    name: str
    source: str
    urdf: Urdf
    tip: str
    joints: tuple[DraftJoint, ...] = ()
    baud: int = 0
    supply_v: float | None = None
    floor_m: float = 0.0
    poses: dict[str, Mapping[str, float]] = field(default_factory=dict[str, Mapping[str, float]])
    pictures: Mapping[str, bytes] = field(default_factory=dict[str, bytes])
    fits: Sequence[ContactFit] = ()
    decisions: list[str] = field(default_factory=list[str])
    dropped: list[str] = field(default_factory=list[str])

    def joint(self, name: str) -> UrdfJoint:
        """Return a joint of the tree."""
        return next(joint for joint in self.urdf.joints if joint.name == name)

    def files(self) -> dict[str, bytes]:
        """Return the content of each file of the arm's folder, by its name."""
        return {
            "arm.toml": self.toml().encode(),
            "arm.urdf": urdf_text(self.urdf).encode(),
            "import.md": self.report().encode(),
            **self.pictures,
        }

    def toml(self) -> str:
        """Return the text of the draft's ``arm.toml``."""
        table = MODELS[self.joints[0].servos[0].model]
        head = [
            "format = 1",
            f"name   = {_quoted(self.name)}",
            f"title  = {_quoted(self.name)}",
            'urdf   = "arm.urdf"',
            f"tip    = {_quoted(self.tip)}",
            f"source = {_quoted(self.source)}",
            "",
            "[bus]",
            f"family = {_quoted(table.family.value)}",
            f"baud   = {self.baud or _BAUD[table.family.value]}",
        ]
        if self.supply_v is not None:
            head.append(f"supply_v = {self.supply_v}")
        if self.floor_m:
            head += ["", "[surroundings]", f"floor_m = {round(self.floor_m, 4)}"]
        for name, (speed, acceleration, jerk) in _SPEEDS.items():
            head += ["", f"[speeds.{name}]", f"deg_s  = {speed}", f"deg_s2 = {acceleration}",
                     f"deg_s3 = {jerk}"]  # fmt: skip
        for joint in self.joints:
            head += ["", *self._joint_lines(joint)]
        for name, pose in self.poses.items():
            head += ["", f"[poses.{name}]", *self._pose_lines(pose)]
        return "\n".join([*head, ""])

    def _joint_lines(self, joint: DraftJoint) -> list[str]:
        lines = [
            "[[joints]]",
            f"name      = {_quoted(joint.name)}",
            f'role      = "{"gripper" if joint.is_gripper else "arm"}"',
            'zero_from = "nominal"',
        ]
        body = self.joint(joint.name)
        turn = math.tau if joint.m_per_turn is None else joint.m_per_turn
        servos: list[str] = []
        for servo in joint.servos:
            # The middle of the servo's turn is zero, or else the middle of the joint's range.
            ticks = MODELS[servo.model].ticks_per_turn
            zero_tick = 0.5 * ticks
            if max(abs(body.lower), abs(body.upper)) > 0.5 * turn:
                zero_tick -= servo.sign * 0.5 * (body.lower + body.upper) / turn * ticks
            fields = [
                f"id = {servo.id}",
                f"model = {_quoted(servo.model)}",
                f"sign = {servo.sign}",
                f"zero_tick = {zero_tick:.0f}",
            ]
            if joint.m_per_turn is not None and servo == joint.servos[0]:
                fields.append(f"m_per_turn = {round(joint.m_per_turn, 6)}")
            servos.append(f"{{ {', '.join(fields)} }}")
        lines.append(f"servo     = {servos[0]}")
        if servos[1:]:
            lines.append(f"shadows   = [{', '.join(servos[1:])}]")
        return lines

    def _pose_lines(self, pose: Mapping[str, float]) -> list[str]:
        turning, sliding = list[str](), list[str]()
        for joint in self.joints:
            body, at = self.joint(joint.name), pose[joint.name]
            edge = min(_EDGE * (body.upper - body.lower), math.radians(0.1))
            inside = min(max(at, body.lower + edge), body.upper - edge)  # also after rounding
            if joint.m_per_turn is None:
                turning.append(f"{joint.name} = {round(math.degrees(inside), 2)}")
            else:
                sliding.append(f"{joint.name} = {round(inside, 5)}")
        tables = (("deg", turning), ("m", sliding))
        if len(self.joints) > _JOINTS_IN_LINE:
            return [f"{unit}.{value}" for unit, values in tables for value in values]
        return [f"{unit} = {{ {', '.join(values)} }}" for unit, values in tables if values]

    def report(self) -> str:
        """Return the report on decisions and dropped parts, as Markdown."""
        lines = [f"# {self.name}", "", f"Made by `ikservo arms new` from {self.source}.", ""]
        lines += ["## Decisions", "", *(f"- {each}" for each in self.decisions), ""]
        lines += ["## Joints", "", "| joint | servo | range |", "|---|---|---|"]
        for joint in self.joints:
            servos = ", ".join(
                f"{each.model} at id {each.id}, sign {each.sign:+d}" for each in joint.servos
            )
            lines.append(f"| {joint.name} | {servos} | {format_range(self.joint(joint.name))} |")
        if self.fits:
            lines += ["", "## Contact", "", *_CONTACT_LINES]
        for fit in self.fits:
            excess = f"{1000 * fit.excess_m:.1f} mm"
            if fit.excess_m > fit.allowed_m:
                excess += f", more than {1000 * fit.allowed_m:.0f} mm; eight capsules fit no closer"
            lines.append(
                f"| {fit.link} | {fit.name} | {fit.triangles:,} | {fit.capsules} | {excess} |"
            )
        if self.dropped:
            lines += ["", "## Left out", "", *(f"- {each}" for each in self.dropped)]
        return "\n".join([*lines, ""])


def format_range(joint: UrdfJoint) -> str:
    """Format the range of a joint in degrees or millimetres."""
    if joint.kind is UrdfJointType.PRISMATIC:
        return f"{1000 * joint.lower:.0f} to {1000 * joint.upper:.0f} mm"
    return f"{math.degrees(joint.lower):.0f}° to {math.degrees(joint.upper):.0f}°"


def guessed_m_per_turn(joint: UrdfJoint) -> float:
    """Guess the metres per turn of a sliding joint that crosses its range in about one turn."""
    return (joint.upper - joint.lower) / _USED_TURN


def _quoted(text: str) -> str:
    return json.dumps(
        "".join(char for char in text if char.isprintable())[:200], ensure_ascii=False
    )
