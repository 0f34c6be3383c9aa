"""The chain of an arm given as a chain, a model, a name or a file."""

from __future__ import annotations

from pathlib import Path

from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics import Chain
from ikservo.model.model import Model

ArmLike = Chain | Model | str | Path
"""An arm's chain or model, its name, or the path of its file."""


def chain_and_start(arm: ArmLike, q0: ArrayLike | None = None) -> tuple[Chain, ArrayLike | None]:
    """Return the chain of an arm, and the default start: a model's initial joints.

    Raises:
        BadValueError: It is not an arm.
        UnknownNameError: No arm has that name.
    """
    if isinstance(arm, Chain):
        return arm, q0
    model: object = arm
    if isinstance(arm, str | Path):
        from ikservo.model import load_model  # noqa: PLC0415  # pydantic, which a chain needs not

        model = load_model(arm)
    if not isinstance(model, Model):
        expected = 'a Chain, a Model, or the name or file of an arm, as in "so101"'
        raise BadValueError("The arm", repr(arm), expected)
    return model.chain, model.initial_joints() if q0 is None else q0
