"""An arm that was released lies somewhere; it can be moved there, too."""

import re
import shutil
from pathlib import Path

import pytest

import ikservo
from ikservo.maintenance.resting import find_resting_place
from tests.oracle import CONFIGS


@pytest.mark.parametrize("name", ["so101", "koch", "px150"])
def test_an_arm_can_be_moved_from_home_to_where_it_would_sink(name: str):
    place = find_resting_place(CONFIGS / name)
    assert place.still
    with ikservo.open_arm(name, port="sim:?pose=home", uncalibrated=True) as arm:
        assert arm.move_joints(place.positions).reached


def test_what_overlaps_where_a_limp_arm_lies_is_named(tmp_path: Path):
    folder = tmp_path / "buried"
    shutil.copytree(CONFIGS / "so101", folder)
    text = (folder / "arm.toml").read_text().replace('name   = "so101"', 'name   = "buried"')
    raised = re.sub(r"floor_m\s*=.*", "", text).replace("[surroundings]", "")
    (folder / "arm.toml").write_text(raised + "\n[surroundings]\nfloor_m = 0.2\n")
    place = find_resting_place(folder)
    assert place.gap_m < 0.0
    assert place.pair[1] == "the table"
