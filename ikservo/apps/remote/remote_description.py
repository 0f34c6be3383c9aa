"""Description and poses of an arm on another machine, checked against the local model."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.wire_messages import ServedPoses, parse_result
from ikservo.arm import ZeroSource
from ikservo.arm.result_json import decode_fields
from ikservo.arm.service import ArmDescription
from ikservo.errors import InputError, UnknownNameError
from ikservo.kinematics import Chain
from ikservo.model import Model
from ikservo.planning.poses import PoseLibrary, Positions
from ikservo.serving.replies import other_version_error


def describe(model: Model, connection: Connection) -> ArmDescription:
    """Request the description of an arm, and compare it with the local model.

    Raises:
        InputError: The arm's joints differ from the model's.
        IkservoError: The answer is from a different version of ikservo.
    """
    said = parse_result(dict[str, object], connection.watch("describe"))
    known = {each.name for each in fields(ArmDescription)}  # a newer version may have more fields
    there = decode_fields(ArmDescription, {key: said[key] for key in said.keys() & known})
    if there.zeros not in ZeroSource.__members__:
        raise other_version_error()
    own = tuple(joint.name for joint in model.joints)
    same = (there.joints, there.chain) == (own, model.chain.names)
    if there.arm != model.name or not same:
        raise InputError(
            f"{connection.address} is {there.arm} with {', '.join(there.joints)}; "
            f"{model.name} has {', '.join(own)}.",
            f"Choose {there.arm} with --arm.",
        )
    return there


def described_chain(model: Model, there: ArmDescription) -> Chain:
    """Return the chain of a model with the calibration and limits from the other machine."""
    origins = {name: np.reshape(rows, (4, 4)) for name, rows in there.origins.items()}
    return model.chain.with_origins(origins).with_limits(there.chain_lower, there.chain_upper)


class RemotePoses(PoseLibrary):
    """The poses of an arm on another machine: poses of its arm file and poses taught there."""

    def __init__(self, model: Model, connection: Connection) -> None:
        super().__init__(model, "")
        self._connection = connection
        self._names = model.poses
        self.path = Path(self._fetch().path)

    def all_poses(self) -> dict[str, Positions]:
        """Return all poses by name, the poses of the arm file first."""
        return dict(self._fetch().all)

    def user_poses(self) -> dict[str, Positions]:
        """Return the taught poses by name."""
        return dict(self._fetch().taught)

    def save(self, name: str, positions: Positions) -> Path:
        """Refuse, because poses are saved on the machine of the arm.

        Raises:
            UnknownNameError: Always.
        """
        raise UnknownNameError("file of poses on this machine", name, ())

    def _fetch(self) -> ServedPoses:
        return parse_result(ServedPoses, self._connection.watch("poses"))
