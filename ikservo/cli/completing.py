"""What the shell offers at the Tab key: names of arms and of poses."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["arms", "poses"]


def arms(incomplete: str) -> list[str]:
    """Return the arms whose names begin like that."""
    from ikservo.model import arm_names  # noqa: PLC0415  # the Tab key should not wait for more

    return [name for name in arm_names() if name.startswith(incomplete)]


def poses(ctx: Any, incomplete: str) -> list[str]:  # noqa: ANN401  # typer hides click's types
    """Return the poses of the chosen arm whose names begin like that, taught ones included."""
    from ikservo.arm.skills.poses import poses_of_any  # noqa: PLC0415
    from ikservo.errors import IkservoError  # noqa: PLC0415
    from ikservo.model import load_model  # noqa: PLC0415

    arm = ctx.params.get("arm") or os.environ.get("IKSERVO_ARM", "")
    try:
        names = poses_of_any(load_model(arm))
    except IkservoError:
        return []
    return [name for name in names if name.startswith(incomplete)]
