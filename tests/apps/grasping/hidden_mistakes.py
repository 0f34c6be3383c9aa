"""A simulated arm with hidden mistakes: wrong zeros, play, a camera that stands elsewhere."""

import re
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import ikservo
from ikservo.apps.cameras.camera_file import SIMULATED, CameraFile, save_camera
from ikservo.kinematics.se3 import exp_so3, log_so3
from ikservo.model import load_model
from servosim.camera import SimulatedCamera
from tests.apps.cameras.saved_camera import BOARD, SEEN, calibrated_camera

# What a good calibration by camera leaves; docs/benchmarks.md has the errors of the tip.
ZERO_DEG, CAMERA_MM, CAMERA_DEG = 0.4, 2.0, 0.3
TICKS_PER_DEG = 4096 / 360


@contextmanager
def hidden_arm_with_cube(name, seed, cube, folder, edge_m=0.035):
    """Open an arm that does not know its own mistakes; yield it, its world, and the true camera.

    The simulator has zeros of its own, and a member of its family: backlash up to 2 degrees per
    joint, friction, motors.

    Args:
        name: The arm.
        seed: The seed of all mistakes.
        cube: The place (2,) of a red cube, m.
        folder: An empty folder.
        edge_m: The length of the cube's edges.
    """
    chance = np.random.default_rng(seed)
    model = load_model(name)
    file = shutil.copytree(Path(model.path).parent, folder / name) / "arm.toml"

    def spoil(found):
        off = round(chance.uniform(-ZERO_DEG, ZERO_DEG) * TICKS_PER_DEG)
        return f"zero_tick = {int(found[1]) + off}"

    file.write_text(re.sub(r"zero_tick = (\d+)", spoil, file.read_text("utf-8")), "utf-8")
    place = ",".join(f"{each:.4f}" for each in (*cube, edge_m))
    port = f"sim:{file}?pose=home&seed={seed}&board=0&physics=1&cubes=red@{place}"
    with ikservo.open_arm(name, port=port) as arm:
        arm.gripper("open")
        world = arm.context.port.transport.line.world
        camera = SimulatedCamera(world, BOARD.opencv())
        known = calibrated_camera(camera, "sim")
        R = exp_so3(np.radians(chance.uniform(-CAMERA_DEG, CAMERA_DEG, 3)))
        turned = tuple(np.degrees(log_so3(R @ camera.T_base_camera[:3, :3])).tolist())
        at = tuple((np.array(known.at_mm) + chance.uniform(-CAMERA_MM, CAMERA_MM, 3)).tolist())
        known = known.model_copy(update={"at_mm": at, "turned_deg": turned, "board": None})
        save_camera(name, SIMULATED, CameraFile(calibrated=SEEN, camera=known))
        yield arm, world, camera
