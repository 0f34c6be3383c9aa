"""What an arm on another machine is: joints, limits, chain and poses, checked against the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ikservo.arm import ZeroSource
from ikservo.arm.poses import PoseLibrary, Positions
from ikservo.arm.replies import SAME_VERSION
from ikservo.arm.result_json import FloatArray
from ikservo.errors import IkservoError, InputError, UnknownNameError
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector, freeze_arrays
from ikservo.model import Model
from ikservo.network.connection import Connection

__all__ = ["ArmDescription", "RemotePoses", "describe"]

Names = Annotated[tuple[str, ...], Field(max_length=256)]


class _Described(BaseModel):
    model_config = ConfigDict(extra="ignore", arbitrary_types_allowed=True)
    arm: str
    port: str
    zeros: str
    joints: Names
    lower: FloatArray
    upper: FloatArray
    chain: Names
    chain_lower: FloatArray
    chain_upper: FloatArray
    origins: dict[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class ArmDescription:
    """A served arm.

    Attributes:
        port: The port it is on, there.
        joints: All joints, in the order of vectors (n,).
        lower: Their lower limits (n,), rad or m.
        upper: Their upper limits.
        chain: Base to tip, as it was calibrated there, inside its limits.
        zeros: Where the zeros of its joints come from.
    """

    port: str
    joints: tuple[str, ...]
    lower: Vector
    upper: Vector
    chain: Chain
    zeros: ZeroSource

    def __post_init__(self) -> None:
        freeze_arrays(self)


def describe(model: Model, connection: Connection) -> ArmDescription:
    """Ask what an arm is, and compare it with the model that this machine has of it.

    Raises:
        InputError: It has other joints.
        IkservoError: The answer is of another version.
    """
    try:
        there = _Described.model_validate(connection.watch("describe"))
        zeros = ZeroSource[there.zeros]
    except (ValidationError, KeyError):
        raise IkservoError(
            "The other end describes its arm in an unknown way.", SAME_VERSION
        ) from None
    own = tuple(joint.name for joint in model.joints)
    same = (there.joints, there.chain) == (own, model.chain.names)
    if there.arm != model.name or not same:
        raise InputError(
            f"{connection.address} is {there.arm} with {', '.join(there.joints)}; "
            f"{model.name} has {', '.join(own)}.",
            f"Choose {there.arm} with --arm.",
        )
    origins = {name: np.reshape(flat, (4, 4)) for name, flat in there.origins.items()}
    chain = model.chain.with_origins(origins).with_limits(there.chain_lower, there.chain_upper)
    return ArmDescription(there.port, own, there.lower, there.upper, chain, zeros)


class RemotePoses(PoseLibrary):
    """The poses of an arm on another machine: of its arm file, and those taught there."""

    def __init__(self, model: Model, connection: Connection) -> None:
        super().__init__(model, "")
        self._connection = connection
        self._names = model.poses
        self.path = Path(str(self._fetch()["path"]))

    def all_poses(self) -> dict[str, Positions]:
        """Return every pose by name, the arm file's first."""
        return dict(cast("Mapping[str, Positions]", self._fetch()["all"]))

    def user_poses(self) -> dict[str, Positions]:
        """Return the taught poses by name."""
        return dict(cast("Mapping[str, Positions]", self._fetch()["taught"]))

    def save(self, name: str, positions: Positions) -> Path:
        """Refuse: a pose is saved beside the arm.

        Raises:
            UnknownNameError: Always.
        """
        raise UnknownNameError("file of poses on this machine", name, ())

    def _fetch(self) -> Mapping[str, object]:
        return cast("Mapping[str, object]", self._connection.watch("poses"))
