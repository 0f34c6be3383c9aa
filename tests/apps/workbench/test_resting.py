"""The posture in which a relaxed arm rests is one to which it can move."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import ikservo
from ikservo.apps.importing.resting import find_resting_place
from tests.oracle import CONFIGS

OTHER_ARMS = [pytest.param(name, marks=pytest.mark.full) for name in ("koch", "px150")]


@pytest.mark.parametrize("name", ["so101", *OTHER_ARMS])
def test_arm_moves_from_home_to_found_rest_pose(name: str):
    place = find_resting_place(CONFIGS / name)
    assert place.still
    with ikservo.open_arm(name, port="sim:?pose=home", uncalibrated=True) as arm:
        assert arm.move_joints(place.positions).reached


def test_rest_pose_search_leaves_6_mm_clearance_for_sag():
    place = find_resting_place(CONFIGS / "so101")
    with ikservo.open_arm("so101", port="sim:?pose=home", uncalibrated=True) as arm:
        joints = [[place.positions[name] for name in arm.context.servos.names]]
        body = arm.context.index.body_joints(np.array(joints))
        load = arm.context.planner.dynamic_load_factor("normal")
        assert arm.context.checked_collision.distances_with_sag(body, load).min() >= 0.006


@pytest.mark.full
def test_rest_pose_search_names_link_overlapping_table(tmp_path: Path):
    folder = tmp_path / "buried"
    shutil.copytree(CONFIGS / "so101", folder)
    text = (folder / "arm.toml").read_text().replace('name   = "so101"', 'name   = "buried"')
    raised = re.sub(r"floor_m\s*=.*", "", text).replace("[surroundings]", "")
    (folder / "arm.toml").write_text(raised + "\n[surroundings]\nfloor_m = 0.2\n")
    place = find_resting_place(folder)
    assert place.gap_m < 0.0
    assert place.pair[1] == "the table"
