"""Cubes are picked from clicks in the camera's picture, by arms with hidden mistakes."""

import math
from contextlib import contextmanager

import numpy as np
import pytest

from ikservo.errors import IkservoError
from tests.apps.grasping.hidden_mistakes import hidden_arm_with_cube
from tests.arm.seeds import log, part_of

pytest.importorskip("cv2")
pytest.importorskip("mujoco")

CUBE_M, LIFTED_M, NEAR_M = 0.035, 0.03, 0.025
CLICK_PX = 4.0
DISTANCES_M = {"so101": (0.18, 0.28), "koch": (0.14, 0.21)}


def drawn_place(name, chance):
    """Return a place (2,) on the table in reach of an arm, m."""
    away_m, angle = chance.uniform(*DISTANCES_M[name]), math.radians(chance.uniform(-40.0, 40.0))
    return away_m * np.array([math.cos(angle), math.sin(angle)])


@contextmanager
def clicked_scene(name, seed, folder):
    """Yield an arm with hidden mistakes, its world, the two clicks (2, 2), and the goal (2,), m.

    A seed gives the same mistakes, places and clicks whoever picks, so that ways are compared.
    """
    chance = np.random.default_rng(1000 + seed)
    cube, goal = drawn_place(name, chance), drawn_place(name, chance)
    noise = chance.normal(0.0, CLICK_PX, (2, 2))
    with hidden_arm_with_cube(name, seed, cube, folder) as (arm, world, camera):
        points = np.append(cube, CUBE_M / 2), np.append(goal, 0.0)
        yield arm, world, np.array([camera.pixel(point) for point in points]) + noise, goal


def pick_and_place_by_clicks(name, seed, folder):
    """Return how far the cube was lifted, and its distance from the second click, m."""
    with clicked_scene(name, seed, folder) as (arm, world, clicks, goal):
        block = arm.camera.block_at(*clicks[0])
        point_m = arm.camera.point_seen(*clicks[1]).point_m
        assert arm.pick(block).grasped, "the gripper found nothing"
        ((_, _, height_m),) = (T[:3, 3] for T in world.cube_poses())
        arm.place([*point_m[:2], point_m[2] + block.half_size_m[2]])
        (T,) = world.cube_poses()
        return height_m - CUBE_M / 2, float(np.linalg.norm(T[:2, 3] - goal))


@pytest.mark.campaign
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_camera_clicks_pick_and_place_cube_in_18_of_20_trials(tmp_path, monkeypatch, capsys, name):
    lifted, placed, tries = 0, 0, part_of(20)
    for seed in tries:
        folder = tmp_path / str(seed)
        monkeypatch.setenv("IKSERVO_HOME", str(folder / "home"))
        try:
            height_m, off_m = pick_and_place_by_clicks(name, seed, folder)
        except (IkservoError, AssertionError) as error:
            log(capsys, f"{name} {seed}: {error}")
            continue
        log(capsys, f"{name} {seed}: lifted {1e3 * height_m:.0f} mm, {1e3 * off_m:.0f} mm off")
        lifted += height_m > LIFTED_M
        placed += height_m > LIFTED_M and off_m < NEAR_M
    log(capsys, f"{name}: lifted {lifted}, placed {placed} of {len(tries)}")
    assert placed >= 0.9 * len(tries)
