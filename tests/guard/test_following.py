"""A joint that does not follow is named after three beats, not before."""

import numpy as np
import pytest

from ikservo.errors import RefusedError
from ikservo.guard import Following

MOST = np.array([0.2, 0.2])
GOALS = np.array([1.0, 1.0])
LATE = np.array([0.79, 1.0])
FINE = np.array([0.81, 1.0])


def following():
    return Following(["elbow", "wrist"], MOST)


def test_the_third_beat_in_a_row_stops_the_motion_and_names_the_joint():
    watch = following()
    watch.see(GOALS, LATE)
    watch.see(GOALS, LATE)
    with pytest.raises(RefusedError, match="elbow does not follow"):
        watch.see(GOALS, LATE)


def test_a_beat_in_time_between_two_late_ones_starts_the_count_again():
    watch = following()
    for measured in (LATE, LATE, FINE, LATE, LATE):
        watch.see(GOALS, measured)


def test_exactly_as_far_as_allowed_is_allowed():
    watch = following()
    for _ in range(10):
        watch.see(GOALS, GOALS - MOST)
