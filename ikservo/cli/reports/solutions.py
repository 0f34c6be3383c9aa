"""All solutions in closed form, as ``ikservo solve --all`` prints them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.calibration import JointUnit, say
from ikservo.cli.output import print_json, print_lines, print_table
from ikservo.errors import InputError
from ikservo.ik import Result, Target, Tolerance
from ikservo.ik.answer import answer
from ikservo.ik.closed_form import Directions, intervals, solutions, structure
from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["Solutions", "all_solutions", "joint_units", "joint_words", "print_solutions"]


@dataclass(frozen=True, slots=True)
class Solutions:
    """What the closed form says of a target.

    Attributes:
        structure: How the arm was understood.
        results: One solution a branch, nearest the start first.
        freedom: The directions of the last link that a free one may have, by branch.
    """

    structure: str
    results: tuple[Result, ...]
    freedom: tuple[Directions, ...]


def all_solutions(model: Model, target: Target, start: Vector) -> Solutions:
    """Ask the closed form of an arm for everything it knows (lecture L3, L4).

    Raises:
        InputError: The arm has no closed form.
    """
    chain = model.chain
    arm = structure(chain, target.frame)
    if arm is None:
        raise InputError(
            f"{model.title} has no closed-form solution for its arrangement of joints.",
            "Omit --all for one numerical solution.",
        )
    found = solutions(chain, target, start)
    free = intervals(chain, target, start) if target.only_position else ()
    return Solutions(str(arm), tuple(_judged(chain, target, q) for q in found), free)


def print_solutions(model: Model, found: Solutions, *, json: bool) -> None:
    """Print one row a solution, and what the last link is free to do between them."""
    if json:
        print_json("solutions", **_fields(found))
        return
    rows = [
        [str(i), *joint_words(model.chain, result.q), f"{result.position_error_m * 1000:.4f} mm"]
        for i, result in enumerate(found.results, start=1)
    ]
    print_table(["#", *model.chain.names, "error"], rows)
    print_lines([f"closed form of {found.structure}", *map(_freedom, found.freedom)])


def joint_words(chain: Chain, q: Vector) -> Sequence[str]:
    """Return each joint's position as a person reads it."""
    return [say(value, unit) for value, unit in zip(q.tolist(), joint_units(chain), strict=True)]


def joint_units(chain: Chain) -> list[JointUnit]:
    """Return the unit of each joint's position."""
    return ["m" if kind is JointKind.PRISMATIC else "rad" for kind in chain.kinds]


def _judged(chain: Chain, target: Target, q: Vector) -> Result:
    return answer(chain, target, q, Tolerance(), method="closed_form", iterations=0)


def _fields(found: Solutions) -> dict[str, object]:
    return {
        "reached": any(result.reached for result in found.results),
        "structure": found.structure,
        "solutions": [
            {
                "q_rad": result.q,
                "position_error_m": result.position_error_m,
                "orientation_error_rad": result.orientation_error_rad,
            }
            for result in found.results
        ],
        "last_link_directions": list(found.freedom),
    }


def _freedom(free: Directions) -> str:
    low, high = math.degrees(free.lower_rad), math.degrees(free.upper_rad)
    return (
        f"one-parameter family, {_elbow(free.elbow)}: last link {low:z.1f}° to {high:z.1f}° "
        f"(yaw {math.degrees(free.yaw_rad):z.1f}°)"
    )


def _elbow(number: int) -> str:
    """Return which way the elbow points; 0 bends counterclockwise after it."""
    return "elbow-up" if number else "elbow-down"
