"""Progress of long work: the same value in a terminal and on the page."""

import pytest

from ikservo.maintenance.dialogue import Progress


@pytest.mark.parametrize(("progress", "text"), [
    (Progress("searching at 57600 baud"), "searching at 57600 baud"),
    (Progress("mesh 1 of 17: a.stl", 0, 17, 0.1), "mesh 1 of 17: a.stl, 0 %"),
    (Progress("mesh 6 of 17: b.stl", 5, 17, 20.0), "mesh 6 of 17: b.stl, 29 %, about 48 s left"),
    (Progress("bus", 0.5, 1.0), "bus, 50 %"),
])  # fmt: skip
def test_progress_shows_share_and_remaining_time_if_known(progress, text):
    assert str(progress) == text
