"""Path accuracy by what the program knows of an arm: the tables, its identification, the truth.

Run ``python tools/bench/identified_path.py``; the table goes to docs/lab/identification.md.
Simulated arms have masses and servos that differ from the arm file. Each goes along the same
seeded lines three times, in virtual time: as its file says, identified by its tour
(`ikservo identify`), and with the figures of its simulated motors and masses. The judge are the
simulated joints.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from path_accuracy import Observer, Trace, move_away, next_line

import ikservo
from ikservo.arm import Arm
from ikservo.calibration.identified_file import IdentifiedArm, IdentifiedJoint, save_identified
from ikservo.maintenance.arm_identification import IdentificationRun
from ikservo.model.identified_drives import body_joints

ARMS = ("so101", "koch", "open_manipulator_x", "px100", "wx250s")
Learn = Callable[[Arm, float], IdentifiedArm | None]


def main() -> None:
    """Measure each arm with all three and print the table."""
    options = _parser().parse_args()
    print("| arm | seed | masses | tables, rms / most | identified | true | identified / true |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name in options.arms:
        for seed in range(options.seeds):
            print(_row(name, seed, options), flush=True)


def _row(name: str, seed: int, options: argparse.Namespace) -> str:
    scale = 0.75 + 0.45 * (seed * 0.618 % 1.0)
    port = f"sim:?seed={seed}&mass_scale={scale}&backlash_deg={options.backlash_deg}"
    found = [
        _errors_m(name, port, learn, scale, options)
        for learn in (_by_the_tables, _by_its_tour, _by_the_simulator)
    ]
    rms = [float(np.sqrt(np.mean(errors**2))) for errors in found]
    cells = [f"{1e3 * r:.2f} / {1e3 * e.max():.2f} mm" for r, e in zip(rms, found, strict=True)]
    return f"| {name} | {seed} | {scale:.2f} | {' | '.join(cells)} | {rms[1] / rms[2]:.2f} |"


def _errors_m(
    name: str, port: str, learn: Learn, scale: float, options: argparse.Namespace
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the distances from the lines (k,) of an arm with what is known of it."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["IKSERVO_HOME"] = folder
        with ikservo.open_arm(name, port=port) as arm:
            known = learn(arm, scale)
        if known is not None:
            save_identified(known)
        with ikservo.open_arm(name, port=port) as arm:
            traces = _traces(arm, options)
    return np.concatenate([trace.deviations_m() for trace in traces if not trace.failure])


def _traces(arm: Arm, options: argparse.Namespace) -> Sequence[Trace]:
    observer, rng = Observer(arm), np.random.default_rng(1)
    move_away(arm, rng)
    return [observer.trace(next_line(arm, rng, options.speed)) for _ in range(options.count)]


def _by_the_tables(arm: Arm, scale: float) -> None:
    """Leave the arm as its file says."""


def _by_its_tour(arm: Arm, scale: float) -> IdentifiedArm:
    run = IdentificationRun.plan(arm)
    run.go_to_start()
    return run.file(run.identify(run.record()), datetime.now(UTC))


def _by_the_simulator(arm: Arm, scale: float) -> IdentifiedArm:
    """Return the file of an arm whose figures are those of its simulated servos and masses."""
    run = IdentificationRun.plan(arm)
    port: Any = arm.context.port
    world = port.transport.line.world
    carried = body_joints(arm.model, run.dynamics)
    gains = [
        prior.servo.p_gain * (1.0 if prior.gain is None else prior.gain) for prior in run.priors()
    ]
    return IdentifiedArm(
        format=1,
        arm=arm.model.name,
        written=datetime.now(UTC).replace(microsecond=0),
        tool_version="simulated",
        usb_serial_number=arm.context.serial_number,
        joints=tuple(
            _true_joint(name, world.joint(name).servos[0], gain, scale if name in carried else 1.0)
            for name, gain in zip(arm.chain.names, gains, strict=True)
        ),
    )


def _true_joint(name: str, servo: Any, p_gain: float, scale: float) -> IdentifiedJoint:  # noqa: ANN401  # of the simulator
    motor = servo.motor.parameters
    return IdentifiedJoint(
        name=name,
        mass_scale=scale,
        p_gain=round(p_gain),
        stiffness_nm_rad=servo.drive.kp * motor.duty_torque_nm,
        full_duty_nm=motor.duty_torque_nm,
        back_emf_nm_s=motor.torque_constant_nm_a**2 / motor.resistance_ohm,
        viscous_nm_s=motor.viscous_nm_s,
        coulomb_nm=motor.friction_nm,
        load=motor.load_friction,
        slow_nm=motor.stribeck_nm,
        slow_load=motor.load_stribeck,
        slow_rad_s=motor.stribeck_rad_s,
        backlash_rad=None if math.isnan(motor.backlash_rad) else motor.backlash_rad,
        errors={},
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=ARMS, help="names in the catalogue")
    parser.add_argument("--seeds", type=int, default=2, help="arms of each kind")
    parser.add_argument("--count", type=int, default=10, help="lines an arm")
    parser.add_argument("--speed", default="normal", choices=("slow", "normal", "fast"))
    parser.add_argument("--backlash-deg", type=float, default=0.5, help="of every servo")
    return parser


if __name__ == "__main__":
    main()
