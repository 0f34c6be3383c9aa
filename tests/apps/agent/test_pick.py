"""A scripted agent picks the simulated cube with the tools alone."""

import base64
import io
import math

import numpy as np
import pytest

from ikservo.apps.agent.allowance import Consent

CUBE_M, ABOVE_M, AXIS_M, BESIDE_M = 0.035, 0.10, 0.039, 0.022
STANCE = {"pitch_rad": math.radians(-75), "roll_rad": math.radians(90)}
PORT = "sim:?pose=home&board=0&physics=1&cubes=red@0.24,0.05"


def red_pixel(png):
    """Return the middle pixel (u, v) of all that is red."""
    image = pytest.importorskip("PIL.Image")
    red, green, blue = np.moveaxis(np.array(image.open(io.BytesIO(png))).astype(int), 2, 0)
    v, u = np.nonzero(red > 2 * np.maximum(blue, green) + 20)
    return float(u.mean()), float(v.mean())


@pytest.mark.campaign
def test_scripted_agent_lifts_cube_using_only_mcp_tools(open_session, run_cli):
    pytest.importorskip("cv2")
    pytest.importorskip("mujoco")
    words = "calibrate so101 --camera sim --port sim:?pose=home --pictures 14 --yes --json"
    assert run_cli(words).code == 0
    with open_session(port=PORT, consent=Consent.SIMULATOR) as session:

        def move(**motion):
            done = session.call("execute", plan_id=session.plan(**motion))
            assert done["status"] == "done", done

        assert session.call("gripper", to="open")["status"] == "done"
        (picture,) = session.call("look")
        u, v = red_pixel(base64.b64decode(picture.data))
        x, y, _ = session.call("point_of_pixel", u=u, v=v, height_m=CUBE_M / 2)["point_m"]
        heading = math.atan2(y, x - AXIS_M)
        x, y = x - BESIDE_M * math.sin(heading), y + BESIDE_M * math.cos(heading)
        move(move_to={"position_m": [x, y, ABOVE_M], "stance": STANCE})
        move(move_line={"position_m": [x, y, 0.028], "stance": STANCE})
        closed = session.call("gripper", to="close")
        assert closed["results"][0]["grasped"]
        move(move_line={"position_m": [x, y, ABOVE_M], "stance": STANCE})
        world = session.audit.line.world
        ((_, _, height_m),) = [T[:3, 3] for T in world.cube_poses()]
        assert height_m > 0.06
        assert session.audit.faults() == []
