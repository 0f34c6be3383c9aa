"""A cube is picked up and put down by two clicks in the camera's picture."""

import numpy as np
import pytest
from playwright.sync_api import expect

import ikservo
from ikservo.apps.page.panels import video
from ikservo.apps.page.picking.projection import Viewport
from tests.browser.page_operator import Operator, serve_view, until

pytest.importorskip("cv2")
pytest.importorskip("mujoco")
pytest.importorskip("ikservo.apps.grasping")

from tests.apps.cameras.saved_camera import save_simulated_camera
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

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


def click_and_go(operator, point_m, words):
    """Click the pixel of a point (3,), read what is offered, then press Go."""
    size = operator.page.evaluate("window.ikservo.scene.camera.size")
    camera = operator.served.view.controller._camera_view.camera(Viewport(*size))
    operator.click(camera.project(point_m)[0])
    panel = operator.page.locator("#app-panels")
    expect(panel).to_contain_text(words)
    operator.wait_for("scene.path?.several && scene.swept && scene.goal")
    go = operator.page.locator("#execute")
    expect(go).to_have_text("Go")
    expect(go).to_be_enabled()
    assert operator.page.evaluate(CONTRAST) == []
    assert operator.page.evaluate(SMALL, 24) == []
    assert "" not in operator.page.evaluate(NAMES)
    go.click()


def moved_cube_m(operator):
    return operator.served.arm.context.port.transport.line.world.cube_poses()[0][:3, 3]


@pytest.mark.timeout(240)
def test_two_clicks_on_page_pick_and_place_cube(operator):
    switch = operator.page.get_by_role("switch", name="Pick up")
    switch.click()
    expect(switch).to_be_checked()
    click_and_go(operator, CUBE_M, "Pick up the red block, 3")
    until(lambda: moved_cube_m(operator)[2] > 0.06, lambda: operator.status["messages"])
    operator.wait_for("status.mode === 'preview'")
    click_and_go(operator, GOAL_M, "Put it down at (0.2")
    until(lambda: np.linalg.norm(moved_cube_m(operator)[:2] - GOAL_M[:2]) < 0.02)
    operator.wait_for("status.mode === 'preview'")
    expect(operator.page.locator("#execute")).to_have_text("Go there")
    assert operator.errors == []
