"""Simulated arms with wrong zeros, bending links and play, before a simulated camera."""

import numpy as np

from ikservo.eyes.board import DEFAULT_BOARD, Board
from servosim.camera import SimulatedCamera
from servosim.joint import Hand, hold
from servosim.specimen import Specimen
from tests.calibration.mounted_arms import STRENGTH, load_model
from tests.cli.fixtures_mounted_arm import connect_arm, write_calibration

BOARD = Board.named(DEFAULT_BOARD)


def hidden_arm(monkeypatch, name, seed, zeros_deg=3.0, compliance=0.15):
    """Return a calibrated arm whose calibration is wrong, and a camera before it."""
    chance, model = np.random.default_rng(seed), load_model(name)
    names = [joint.name for joint in model.joints]
    bends = dict(
        zip(model.chain.names, chance.uniform(0, compliance, model.chain.dof), strict=True)
    )
    specimen = Specimen(mass_scales=dict.fromkeys(names, 1.0), compliances=bends)
    arm = connect_arm(monkeypatch, name, seed=seed, gravity=True, specimen=specimen, spoiled=False)
    home = {each: arm.true_position(each) for each in names}
    for each in model.chain.names:
        arm.world.place(each, home[each] + np.radians(chance.uniform(-zeros_deg, zeros_deg)))
    for joint in arm.world.joints:
        arm.world.grasp(joint.name, Hand(hold(joint.position), STRENGTH))
    write_calibration(arm)
    for each in names:
        arm.world.release(each)
        arm.world.place(each, home[each])
    camera = SimulatedCamera(arm.world, BOARD.opencv(), seed=seed)
    return arm, camera


def tip_errors_m(arm, camera, chain, zeros, T_camera_base, count=200):
    """How far the tip is in the camera from where the arm says, over its workspace.

    Args:
        chain: The arm as it is known.
        zeros: What its joints measure more than they are (dof,), rad.
    """
    low, high = np.maximum(chain.lower_rad, -2.0), np.minimum(chain.upper_rad, 2.0)
    positions, errors = [joint.position for joint in arm.world.joints], []
    column = {joint.name: i for i, joint in enumerate(arm.world.joints)}
    for q in np.random.default_rng(9).uniform(low, high, (count, chain.dof)):
        for name, value in zip(chain.names, q, strict=True):
            positions[column[name]] = value
        truth = np.linalg.inv(camera.T_base_camera) @ arm.world.tip.pose(positions)
        said = T_camera_base @ chain.forward(q + zeros)
        errors.append(np.linalg.norm(truth[:3, 3] - said[:3, 3]))
    return np.array(errors)
