"""A cube is picked up and put down by two clicks in the camera's picture."""

import os

import numpy as np
import pytest

import ikservo
from ikservo.apps.page.panels import video
from ikservo.apps.page.picking.projection import Viewport
from tests.browser.page_operator import Operator, serve_view, until

pytest.importorskip("cv2")
pytest.importorskip("mujoco")

from tests.apps.cameras.saved_camera import save_simulated_camera

pytestmark = pytest.mark.browser

CUBE_M, GOAL_M = np.array([0.24, 0.05, 0.0175]), np.array([0.22, -0.08, 0.0])
PORT = "sim:?pose=home&board=0&physics=1&cubes=red@0.24,0.05"


@pytest.fixture
def operator(browser, tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr(video, "_OLD_S", 30.0)  # drawing one takes seconds on a busy machine
    with ikservo.open_arm("so101", PORT) as arm:
        save_simulated_camera(arm)
    with serve_view(port=PORT, cameras=["sim"]) as served:
        context = browser.new_context(viewport={"width": 1200, "height": 800})
        operator = Operator(context.new_page(), served)
        operator.page.click("#views [value=camera]")
        operator.wait_for("scene.camera.lens && scene.picture_trouble === ''")
        yield operator.wait_for_picture()
        context.close()


def click_and_go(operator, point_m, button):
    """Click the pixel of a point (3,), press the button of the picture, then Go there."""
    size = operator.page.evaluate("window.ikservo.scene.camera.size")
    camera = operator.served.view.controller._camera_view.camera(Viewport(*size))
    operator.click(camera.project(point_m)[0])
    operator.page.click(f"#grasp:not([disabled]):has-text('{button}')")
    operator.wait_for(
        "!scene.marker && scene.swept && scene.path && !document.getElementById('execute').disabled"
    )
    if os.environ.get("SHOTS"):
        operator.page.screenshot(path=f"{os.environ['SHOTS']}/{button.split()[0]}.png")
    operator.page.click("#execute")


@pytest.mark.timeout(240)
def test_cube_is_picked_and_placed_by_two_clicks(operator):
    world = operator.served.arm.context.port.transport.line.world
    click_and_go(operator, CUBE_M, "Pick up")
    operator.page.wait_for_selector("#grasp:has-text('Put it here')")
    assert world.cube_poses()[0][2, 3] > 0.06
    operator.wait_for("status.mode === 'preview'")
    click_and_go(operator, GOAL_M, "Put it here")
    operator.page.wait_for_selector("#grasp:has-text('Pick up')")
    until(lambda: np.linalg.norm(world.cube_poses()[0][:2, 3] - GOAL_M[:2]) < 0.02)
    operator.wait_for("status.mode === 'preview'")
    assert operator.errors == []
