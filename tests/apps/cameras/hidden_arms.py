"""Simulated arms with wrong zeros, bending links and backlash before a simulated camera."""

import re

import numpy as np

from ikservo.apps.cameras.arm_camera import table_m
from ikservo.apps.cameras.board import Board
from ikservo.apps.cameras.tip_click import find_tip_zero, save_tip_zero
from ikservo.arm.opening import open_own_arm
from ikservo.cli.camera_options import DEFAULT_BOARD
from ikservo.errors import CalibrationError, IkservoError
from ikservo.maintenance.dialogue import Notice
from servosim.camera import SimulatedCamera, SimulatedView
from servosim.joint import Hand, hold
from servosim.specimen import Specimen
from tests.calibration.mounted_arms import STRENGTH, load_model
from tests.cli.fixtures_mounted_arm import PORT, WHEN, connect_arm, write_calibration

BOARD = Board.named(DEFAULT_BOARD)


def drawn_view(chance):
    """Return a camera near an arm, above the tip, with random lens parameters."""
    away_m, aside = chance.uniform(0.3, 0.55), np.radians(chance.uniform(-50.0, 50.0))
    above = np.radians(chance.uniform(10.0, 60.0))
    ahead = np.array([np.cos(aside), np.sin(aside)]) * np.cos(above)
    width = int(chance.choice([640, 960, 1280]))
    return SimulatedView(
        from_tip_m=tuple(away_m * np.append(ahead, np.sin(above))),
        focal_px=width * chance.uniform(0.75, 1.1),
        off_centre_px=tuple(chance.normal(0.0, 0.015 * width, 2)),
        distortion=(chance.uniform(-0.2, 0.05), chance.uniform(0.0, 0.06)),
        size=(width, width * 3 // 4),
        noise=chance.uniform(1.0, 4.0),
    )


def hidden_arm(monkeypatch, name, seed, zeros_deg=3.0, compliance=0.15, view=None):
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
    camera = SimulatedCamera(arm.world, BOARD.opencv(), view, seed)
    return arm, camera


def tip_errors_m(arm, camera, chain, zeros, T_camera_base, count=200):
    """Return the distances between the true and the computed tip, in the camera frame, m.

    Args:
        chain: The chain of the calibrated arm.
        zeros: The errors of its measured joints (dof,), rad.
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


def finish(dialogue, said=None):
    """Run a dialogue without questions; return its result, and add its notices to ``said``."""
    while True:
        try:
            item = next(dialogue)
        except StopIteration as end:
            return end.value
        if said is not None and isinstance(item, Notice):
            said.append(item.text)


def click_on_tip(arm, camera, opened, chance, noise_px=1.5):
    """Click on the tip as a user does, after a move to another posture if that is asked for."""
    for _ in range(3):
        positions = [joint.position for joint in arm.world.joints]
        at = camera.pixel(arm.world.tip.position_m(positions)) + chance.normal(0.0, noise_px, 2)
        try:
            return find_tip_zero(opened, [tuple(at)], WHEN)
        except CalibrationError as error:
            if not follow_advice(opened, error.hint):
                raise
    raise AssertionError("the postures that were asked for do not show enough")


def follow_advice(opened, text):
    """Move the joint that a text asks for; return whether it asks for one."""
    asked = re.search(r"Move (\w+) to (-?\d+)°", text)
    if asked is not None:
        opened.move_joints({asked[1]: np.radians(float(asked[2]))})
    return asked is not None


def save_clicks(arm, camera, chance, count=3):
    """Click on the tip in each proposed posture and save the result."""
    for _ in range(count):
        with open_own_arm(load_model(arm.name), PORT) as opened:
            opened.enable()
            found = click_on_tip(arm, camera, opened, chance)
            save_tip_zero(opened, found)
            follow_advice(opened, found.advice)
    return found


def click_errors_m(arm, camera, opened, count, seed=0):
    """Return the distances between the tip and clicked points of the table, m.

    The camera sees the points, and the arm can reach a finger's width above them. The arm goes
    there by the calibration of its camera.
    """
    chance, errors = np.random.default_rng(seed), []
    while len(errors) < count:
        point = np.append(chance.uniform([0.08, -0.2], [0.38, 0.2]), table_m(opened.model) + 0.03)
        u, v = camera.pixel(point)
        try:
            result = opened.move_to(opened.camera.point_on_table(u, v, height_m=0.03))
        except IkservoError:
            continue  # beside the picture, or out of reach
        if not result.reached:
            continue  # at an end stop that its calibration has not met: the arm says so
        positions = [joint.position for joint in arm.world.joints]
        errors.append(np.linalg.norm(arm.world.tip.position_m(positions) - point))
    return np.array(errors)
