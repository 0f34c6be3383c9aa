"""The refusal of a point at the table names a motion that is accepted."""

import math
import re

import pytest

import ikservo
from ikservo.errors import CollisionError
from ikservo.planning.motions import MoveTo
from ikservo.planning.tool_orientation import ToolOrientation

HINT = re.compile(r"Try: ikservo move (\S+) (\S+) (\S+)( --pitch -90)?")


@pytest.mark.sample(3)
@pytest.mark.full
@pytest.mark.parametrize("z_m", [0.0, -0.05])
@pytest.mark.parametrize("name", ["so101", "koch", "wx250s"])
def test_point_suggested_by_table_collision_error_is_accepted(name, z_m):
    with ikservo.open_arm(name, port="sim:?pose=home") as arm:
        with pytest.raises(CollisionError) as refused:
            arm.plan(MoveTo((0.2, 0.03, z_m), straight=True))
        error = refused.value
        assert "no-collision" not in error.command_hint
        assert ("below the table" in error.command_message) == (z_m < 0.0)
        *point, pitch = HINT.fullmatch(error.command_hint).groups()
        tool = ToolOrientation(pitch_rad=-math.pi / 2) if pitch else ToolOrientation()
        arm.move_to(tuple(map(float, point)), stance=tool)
