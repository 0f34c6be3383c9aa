"""Completions for the Tab key: arms, poses, joints, and other names."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ikservo.model import Model

_DIRECTIONS = ("x", "y", "z", "up", "down")


def complete_from(*names: str) -> Callable[[str], list[str]]:
    """Return a function that completes one of fixed names."""

    def complete(incomplete: str) -> list[str]:
        return _filter_by_prefix(names, incomplete)

    return complete


def complete_arms(incomplete: str) -> list[str]:
    """Return the names of arms that begin with a prefix."""
    from ikservo.model import arm_names  # noqa: PLC0415  # the Tab key should not wait for more

    return [name for name in arm_names() if name.startswith(incomplete)]


def complete_poses(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401  # typer hides click's types
    """Complete a prefix to poses of the chosen arm, including taught poses."""
    from ikservo.planning.poses import known_pose_names  # noqa: PLC0415

    model = _model_from_context(ctx)
    return [] if model is None else _filter_by_prefix(known_pose_names(model), incomplete)


def complete_joints(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Complete the joints of the chosen arm as ``NAME=``, except those already given."""
    model = _model_from_context(ctx)
    given = {str(goal).partition("=")[0] for goal in ctx.params.get("goals") or ()}
    names = [] if model is None else [joint.name for joint in model.joints]
    return _filter_by_prefix([f"{name}=" for name in names if name not in given], incomplete)


def complete_jogs(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401
    """Complete a prefix to joints of the chosen arm and directions of the tip, for ``jog``."""
    model = _model_from_context(ctx)
    names = [] if model is None else [joint.name for joint in model.joints]
    return _filter_by_prefix([*names, *_DIRECTIONS], incomplete)


def complete_methods(incomplete: str) -> list[str]:
    """Complete a prefix to methods of ``solve``."""
    from ikservo.ik import METHODS  # noqa: PLC0415

    return _filter_by_prefix(["auto", *METHODS], incomplete)


def _filter_by_prefix(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _model_from_context(ctx: Any) -> Model | None:  # noqa: ANN401
    """Return the arm of ``--arm`` or ``IKSERVO_ARM``; None if none is chosen yet."""
    from ikservo.errors import IkservoError  # noqa: PLC0415
    from ikservo.model import load_model  # noqa: PLC0415

    arm = ctx.params.get("arm") or os.environ.get("IKSERVO_ARM", "")
    try:
        return load_model(arm) if arm else None
    except IkservoError:
        return None
