"""An arm that was released lies somewhere; it can be moved there, too."""

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
