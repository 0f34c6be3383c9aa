"""Identify an arm: plan and run its tour, estimate its parameters, and write them to its file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ikservo.apps.lab.drive_fit import JointPrior
from ikservo.apps.lab.drive_recording import DriveRecording
from ikservo.apps.lab.duty_model import JOINT_PARAMETERS
from ikservo.apps.lab.excitation import Excitation, TourOptions, plan_excitation, record_excitation
from ikservo.apps.lab.parameter_estimation import (
    Identification,
    ParameterEstimate,
    identify,
    identify_payload,
)
from ikservo.arm import Arm
from ikservo.calibration.identified_file import IdentifiedArm, IdentifiedJoint, load_identified
from ikservo.calibration.paths import identified_path
from ikservo.errors import RefusedError
from ikservo.kinematics.dynamics import Dynamics
from ikservo.model import Model
from ikservo.model.arm_model import link_masses
from ikservo.model.identified_drives import body_joints
from ikservo.model.servo_torque import find_servo_torque, nominal_supply_v
from ikservo.planning.reports import OnProgress

START_POSE = "home"
QUICK_TOUR = TourOptions(postures=3, slow_postures=0, swings=0)


@dataclass(frozen=True, slots=True)
class WeighResult:
    """Result of weighing the mass in the jaws, and whether the empty arm was identified before."""

    payload: ParameterEstimate
    with_identified: bool


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationRun:
    """A planned tour of an arm, which starts and ends in the pose `START_POSE`."""

    arm: Arm
    dynamics: Dynamics
    excitation: Excitation

    @classmethod
    def plan(cls, arm: Arm, options: TourOptions | None = None) -> IdentificationRun:
        """Plan the tour; nothing moves.

        Raises:
            CalibrationError: The arm is not calibrated.
            RefusedError: The motor of a servo is unknown, or the arm has no masses or no room to
                move.
        """
        context = arm.context
        context.require_zeros()
        masses = link_masses(context.model, context.chain)
        if not masses:
            hint = "Add <inertial> to its links; masses are estimated as multiples of these."
            raise RefusedError(f"{context.model.name} has no masses in its URDF.", hint)
        dynamics = Dynamics.from_masses(context.chain, masses)
        nominal_priors(context.model, context.chain.names)  # refuses unknown motors
        inside = arm.pose_within_limits(START_POSE)
        q = np.array([inside.positions[name] for name in context.chain.names])
        start = context.index.with_chain(context.servos.measure_positions(), q)
        return cls(arm, dynamics, plan_excitation(context, dynamics, start, options))

    @property
    def path(self) -> Path:
        """Path to the arm's identification file."""
        context = self.arm.context
        return identified_path(context.model.name, context.serial_number)

    @property
    def duration_s(self) -> float:
        """Duration of the tour, without the motion to its start."""
        return self.excitation.duration_s

    def go_to_start(self, on_progress: OnProgress | None = None) -> None:
        """Move to the pose in which the tour starts."""
        positions = self.arm.pose_within_limits(START_POSE).positions
        names = self.arm.chain.names
        self.arm.move_joints({n: positions[n] for n in names}, speed="slow",
                             on_progress=on_progress)  # fmt: skip

    def record(self, on_progress: OnProgress | None = None) -> DriveRecording:
        """Run the tour and return the recording of the servos.

        Raises:
            RefusedError: The guard stopped the tour; the arm holds.
            StoppedError: The tour was stopped; the arm holds.
        """
        context = self.arm.context
        reporter = context.progress_reporter(on_progress)
        return record_excitation(context, self.arm.runner, self.excitation, reporter)

    def identify(self, recording: DriveRecording) -> Identification:
        """Identify the parameters of the arm."""
        return identify(self.dynamics, self.priors(), recording)

    def weigh(self, recording: DriveRecording) -> WeighResult:
        """Weigh the mass in the jaws.

        Raises:
            FileFormatError: The arm's identification is damaged.
        """
        context, priors = self.arm.context, self.priors()
        stored = load_identified(context.model.name, context.serial_number)
        known = stored and known_identification(context.model, self.dynamics, priors, stored)
        found = identify_payload(self.dynamics, priors, recording, known)
        return WeighResult(found, known is not None)

    def priors(self) -> list[JointPrior]:
        """Read the present gains, and return the priors of the joints' servos."""
        context = self.arm.context
        names = context.chain.names
        gains = context.servos.drive_reader(names).p_gains()
        return [
            replace(prior, gain=gain and gain / prior.servo.p_gain)
            for prior, gain in zip(nominal_priors(context.model, names), gains, strict=True)
        ]

    def file(self, found: Identification, written: datetime) -> IdentifiedArm:
        """Return the content of the arm's identification file."""
        context = self.arm.context
        return identified_arm(
            context.model, self.dynamics, self.priors(), found, context.serial_number, written
        )


def nominal_priors(model: Model, names: Sequence[str]) -> list[JointPrior]:
    """Return the nominal priors of the servos of some joints, from the tables.

    Raises:
        RefusedError: The motor of a servo is unknown.
    """
    priors: list[JointPrior] = []
    for name in names:
        joint = model.joint(name)
        torque = find_servo_torque(joint.servo.model, model.supply_v)
        if torque is None:
            hint = "Only arms with servos listed in docs/lab/motors.md can be identified."
            raise RefusedError(f"The motor of {name} ({joint.servo.model}) is unknown.", hint)
        priors.append(
            JointPrior(
                servo=torque,
                servos=1 + len(joint.shadows),
                nominal_v=nominal_supply_v(joint.servo.model, model.supply_v),
                per_horn_rad=joint.travel_per_turn / math.tau,
            )
        )
    return priors


def _factors(prior: JointPrior) -> Mapping[str, float]:
    """Compute the factors that refer figures of one servo from the horn to the joint."""
    force, per_horn_rad = prior.force, prior.per_horn_rad
    return {
        "full_duty_nm": force,
        "damping_nm_s": force / per_horn_rad,
        "coulomb_nm": force,
        "load": 1.0,
        "slow_nm": force,
        "slow_load": 1.0,
        "slow_rad_s": per_horn_rad,
        "stiffness_nm_rad": force / per_horn_rad,
        "backlash_rad": per_horn_rad,
    }


def identified_arm(
    model: Model,
    dynamics: Dynamics,
    priors: Sequence[JointPrior],
    found: Identification,
    usb_serial_number: str,
    written: datetime,
) -> IdentifiedArm:
    """Return the content of an arm's identification file."""
    carried = dict(zip(body_joints(model, dynamics), dynamics.bodies, strict=True))
    joints = [
        _identified_joint(name, prior, found, carried[name])
        for name, prior in zip(found.joints, priors, strict=True)
    ]
    return IdentifiedArm(
        format=1,
        arm=model.name,
        written=written.replace(microsecond=0),
        tool_version=version("ikservo"),
        usb_serial_number=usb_serial_number,
        joints=tuple(joints),
    )


def _identified_joint(
    name: str, prior: JointPrior, found: Identification, body: str
) -> IdentifiedJoint:
    own = {
        key: (estimate.value / factor, estimate.error / factor)
        for key, factor in _factors(prior).items()
        if (estimate := found.estimates.get(f"{name}.{key}")) is not None
    }
    scale = found.estimates[f"{body}.mass_scale"]
    own["mass_scale"] = scale.value, scale.error
    values = {key: value for key, (value, _) in own.items()}
    damping = values.pop("damping_nm_s")
    motors = found.motors.get(name)
    brake = motors.back_emf_nm_s / _factors(prior)["damping_nm_s"] if motors else damping
    return IdentifiedJoint(
        name=name,
        p_gain=round(prior.gain * prior.servo.p_gain) if prior.gain else None,
        back_emf_nm_s=min(brake, damping),
        viscous_nm_s=max(damping - brake, 0.0),
        errors={key: error for key, (_, error) in own.items()},
        **values,
    )


def known_identification(
    model: Model, dynamics: Dynamics, priors: Sequence[JointPrior], stored: IdentifiedArm
) -> Identification | None:
    """Return a stored identification; None if it lacks a joint."""
    estimates: dict[str, ParameterEstimate] = {}
    joints = dict(zip(body_joints(model, dynamics), dynamics.bodies, strict=True))
    for name, prior in zip(dynamics.chain.names, priors, strict=True):
        own = stored.joint(name)
        if own is None or name not in joints:
            return None
        values = own.model_dump() | {"damping_nm_s": own.back_emf_nm_s + own.viscous_nm_s}
        for key in JOINT_PARAMETERS:
            factor = _factors(prior)[key]
            error = factor * own.errors.get(key, 0.0)
            estimates[f"{name}.{key}"] = ParameterEstimate(factor * values[key], error, error)
        error = own.errors.get("mass_scale", 0.0)
        scale = ParameterEstimate(own.mass_scale, error, error)
        estimates[f"{joints[name]}.mass_scale"] = scale
    return Identification(dynamics.chain.names, dynamics.bodies, estimates, {}, {})
