"""Explain why a point is out of reach where no joint limit is the reason."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from ikservo.cli.entry_point import with_connection_options
from ikservo.cli.terminal import print_status
from ikservo.ik import Target, in_millimetres
from ikservo.kinematics import Chain, JointType

__all__ = ["ask_about_millimetres", "explain_unreachable"]

_SAMPLES, _FLAT_M = 64, 1e-6


def explain_unreachable(chain: Chain, target: Target) -> str:
    """Return in words why an arm does not reach a point inside its joint limits."""
    flat = _base_plane(chain)
    if flat is not None:
        axis, at_m = flat
        if abs(float(target.position[axis]) - at_m) > _FLAT_M:
            return f"the arm moves only in the plane {'xyz'[axis]} = {at_m:z.3f} m"
    if JointType.PRISMATIC in chain.kinds or target.only_position:
        return "the links are too short"
    return "the links are too short, or the arm has too few joints for this orientation"


def ask_about_millimetres(chain: Chain, position_m: Sequence[float], command: str) -> None:
    """Ask on stderr whether millimetres were meant, where the arm would reach such a point.

    Args:
        chain: The arm.
        position_m: The point (3,) that was taken for metres.
        command: What to type instead, ``{}`` for the point.
    """
    meant = in_millimetres(chain, position_m)
    if meant:
        hint = f"Did you mean millimetres? Try: ikservo {command.format(meant)}"
        print_status(with_connection_options(hint, sys.argv[1:]))


def _base_plane(chain: Chain) -> tuple[int, float] | None:
    """Return the axis (0, 1, 2) and offset [m] of the base plane in which the tip stays, if any."""
    chance = np.random.default_rng(1)
    low, high = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    q = chance.uniform(low, high, (_SAMPLES, chain.dof))
    tips_m = np.array([chain.forward(each)[:3, 3] for each in q])
    spread_m = np.ptp(tips_m, axis=0)
    axis = int(np.argmin(spread_m))
    return (axis, float(tips_m[0, axis])) if spread_m[axis] < _FLAT_M else None
