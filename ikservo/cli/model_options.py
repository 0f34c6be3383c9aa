"""The model of ``--arm``, its limits as text, and the posture of ``--prefer elbow_flex=30``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from ikservo.calibration import format_position, format_source
from ikservo.calibration.paths import calibrations_of
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.cli.terminal import print_status
from ikservo.errors import BadValueError, InputError, UnknownNameError, shown
from ikservo.ik import ActiveLimit, Posture
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model, arm_names, load_model

_ARM_FILE = "arm file"

_RANK_M = 1e-9  # metres per radian below which a joint does not move the tip in a direction

LEANING = ("auto", "pseudo_inverse")
"""Methods that use a preferred posture; the other methods have no null space."""


@dataclass(frozen=True, kw_only=True)
class PostureOptions:
    """The posture that is preferred if the target leaves a choice."""

    prefer: Annotated[
        list[str] | None,
        typer.Option(
            "--prefer",
            metavar="JOINT=POSITION",
            help="Preferred joint position or pose, used if the target leaves a choice; "
            "repeatable.",
        ),
    ] = None
    weight: Annotated[
        list[str] | None,
        typer.Option(
            "--weight",
            metavar="JOINT=NUMBER",
            help="Weight of a joint's preference; default: 1, and 0 ignores it; repeatable.",
        ),
    ] = None

    def posture(self, model: Model, chain: Chain) -> Posture | None:
        """Return the preferred posture; None if there is none.

        A pose sets a preferred position for every joint; single joints may then override it.

        Raises:
            BadValueError: A weight is not a number of at least 0, or something is given twice.
            InputError: Invalid text, or a weight of a joint without a preferred position.
            UnknownNameError: There is no such joint or pose.
        """
        q, weights = np.zeros(chain.dof), np.zeros(chain.dof)
        poses = [name for name in self.prefer or () if "=" not in name]
        if len(poses) > 1:
            raise BadValueError("--prefer", f"given as {' and '.join(poses)}", "one pose")
        for name in poses:
            if name in chain.names:
                raise InputError(f"--prefer {name} has no position.", f"Write --prefer {name}=30.")
            if name not in model.poses:
                raise UnknownNameError("pose", name, model.poses)
            pose = model.pose(name)
            q, weights = np.array([pose[joint] for joint in chain.names]), np.ones(chain.dof)
        for joint, text in _parse_pairs(chain, self.prefer, "--prefer", "elbow_flex=30"):
            slides = chain.kinds[joint] is JointType.PRISMATIC
            q[joint] = parse_length_m(text) if slides else parse_angle_rad(text)
            weights[joint] = 1.0
        for joint, text in _parse_pairs(chain, self.weight, "--weight", "elbow_flex=2"):
            if weights[joint] == 0.0:
                name = chain.names[joint]
                why = f"--weight {name}={text}: there is no preferred position for {name}."
                raise InputError(why, f"Give --prefer {name}=POSITION, or a pose, as well.")
            try:
                weights[joint] = float(text)
            except ValueError:
                weights[joint] = math.nan
            if not 0.0 <= weights[joint] < math.inf:
                what = f"The weight of {chain.names[joint]}"
                raise BadValueError(what, shown(text), "a number of at least 0")
        return Posture(q, weights) if weights.any() else None


def model_from_option(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm`` from its arm file.

    Raises:
        InputError: No arm was given; known arms are listed.
    """
    if not arm:
        known = ", ".join(arm_names())
        raise InputError("No arm given.", f"Add --arm or set IKSERVO_ARM. Known: {known}.")
    return load_model(arm, tip)


def calibrated_model_from_option(arm: str | None, tip: str | None = None) -> Model:
    """Return the model of ``--arm`` with its calibration's limits; print the calibration's name.

    Raises:
        InputError: No arm was given; known arms are listed.
        FileFormatError: The calibration is damaged.
        CalibrationError: The calibration belongs to another arm.
    """
    model = model_from_option(arm, tip)
    if not (model.joints and calibrations_of(model.name)):
        return model
    from ikservo.planning.calibrated_arm import calibrated_model  # noqa: PLC0415  # loads the servo modules

    own = calibrated_model(model)
    older = f" (the newest; older files: {len(own.others)})" if own.others else ""
    print_status(f"Limits from calibration: {own.file}{older}")
    return own.model


def describe_limit(model: Model, binding: ActiveLimit) -> str:
    """Describe an active limit, such as ``j2 at its lower limit, 5.0° (arm file)``."""
    joint = next((joint for joint in model.joints if joint.name == binding.joint), None)
    if joint is None:
        return str(binding)
    limit = joint.limits.lower if binding.side == "lower" else joint.limits.upper
    position = format_position(limit.value, joint.limits.unit)
    return f"{binding}, {position} ({format_source(limit.source)})"


def limit_sources(model: Model) -> list[str]:
    """Return the source of the limits of each joint of the chain (dof,)."""
    sources = {joint.name: joint.limits.source for joint in model.joints}
    return [sources.get(name, _ARM_FILE) for name in model.chain.names]


def report_missing_freedom(chain: Chain, q: Vector, *, directed: bool) -> None:
    """Print a note if the target leaves no choice for a preferred posture."""
    J = chain.jacobian(q)
    taken = int(np.linalg.matrix_rank(J[:3], _RANK_M)) + (2 if directed else 0)
    if taken >= chain.dof:
        print_status("The target leaves this arm no choice of posture, so --prefer has no effect.")


def _parse_pairs(
    chain: Chain, texts: Sequence[str] | None, option: str, example: str
) -> list[tuple[int, str]]:
    """Parse options into joint columns and the texts given for them."""
    pairs, named = list[tuple[int, str]](), set[str]()
    for each in texts or ():
        name, equals, text = each.partition("=")
        if not equals:
            if option == "--prefer":
                continue  # a pose
            raise InputError(
                f"{option} {each!r} is not JOINT=NUMBER.", f"Write {option} {example}."
            )
        if name not in chain.names:
            raise UnknownNameError("joint", name, chain.names)
        if name in named:
            raise BadValueError(f"{option} for {name}", "given twice", "one value per joint")
        named.add(name)
        pairs.append((chain.names.index(name), text))
    return pairs
