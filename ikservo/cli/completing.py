"""What the shell offers at the Tab key: arms, joints, poses, speeds, methods."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ikservo.model import Model

__all__ = ["actions", "arms", "jogs", "joints", "methods", "openings", "poses", "speeds"]

_SPEEDS = ("slow", "normal", "fast")
_DIRECTIONS = ("x", "y", "z", "up", "down")


def arms(incomplete: str) -> list[str]:
    """Return the arms whose names begin like that."""
    from ikservo.model import arm_names  # noqa: PLC0415  # the Tab key should not wait for more

    return [name for name in arm_names() if name.startswith(incomplete)]


def poses(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401  # typer hides click's types
    """Return the poses of the chosen arm whose names begin like that, taught ones included."""
    from ikservo.arm.skills.poses import poses_of_any  # noqa: PLC0415

    model = _model(ctx)
    return [] if model is None else _beginning(poses_of_any(model), incomplete)


def joints(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Return the joints of the chosen arm as ``NAME=``, without those that were given before."""
    model = _model(ctx)
    given = {str(goal).partition("=")[0] for goal in ctx.params.get("goals") or ()}
    names = [] if model is None else [joint.name for joint in model.joints]
    return _beginning([f"{name}=" for name in names if name not in given], incomplete)


def jogs(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Return what can be jogged: the joints of the chosen arm, and directions of the tip."""
    model = _model(ctx)
    names = [] if model is None else [joint.name for joint in model.joints]
    return _beginning([*names, *_DIRECTIONS], incomplete)


def speeds(incomplete: str) -> list[str]:
    """Return the speed classes that begin like that."""
    return _beginning(_SPEEDS, incomplete)


def methods(incomplete: str) -> list[str]:
    """Return the methods of ``solve`` that begin like that."""
    from ikservo.ik import METHODS  # noqa: PLC0415

    return _beginning(["auto", *METHODS], incomplete)


def openings(incomplete: str) -> list[str]:
    """Return what the gripper can be told that begins like that."""
    return _beginning(("open", "close"), incomplete)


def actions(incomplete: str) -> list[str]:
    """Return the actions of ``ikservo calibration`` that begin like that."""
    names = ("diff", "push", "pull", "adopt", "resume", "revert")
    return _beginning(names, incomplete)


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _model(ctx: Any) -> Model | None:  # noqa: ANN401
    """Return the arm of ``--arm`` or ``IKSERVO_ARM``; None where none is chosen yet."""
    from ikservo.errors import IkservoError  # noqa: PLC0415
    from ikservo.model import load_model  # noqa: PLC0415

    arm = ctx.params.get("arm") or os.environ.get("IKSERVO_ARM", "")
    try:
        return load_model(arm) if arm else None
    except IkservoError:
        return None
