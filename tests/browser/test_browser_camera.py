"""A click in the picture of a calibrated camera is a target on the table."""

import itertools

import numpy as np
import pytest
from playwright.sync_api import expect

import ikservo
from ikservo.apps.cameras.camera_file import SIMULATED, load_camera, save_camera
from ikservo.apps.page.panels import video
from ikservo.apps.page.picking.projection import Viewport
from ikservo.calibration.records import TipClick
from tests.browser.page_operator import Operator, serve_view, until
from tests.browser.test_browser_layout import boxes, overlap

cv2 = pytest.importorskip("cv2")

from servosim.camera import SimulatedCamera  # noqa: E402
from tests.apps.cameras.saved_camera import save_simulated_camera  # noqa: E402

pytestmark = pytest.mark.browser

PORT = "sim:?pose=home"


@pytest.fixture
def film(tmp_path):
    """Return a file with pictures of a camera that is not calibrated with any arm."""
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.full((48, 64, 3), (255, 0, 0), np.uint8))
    writer.release()
    return path


@pytest.fixture
def operator(browser, tmp_path, monkeypatch, film):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr(video, "_OLD_S", 30.0)  # drawing one takes seconds on a busy machine
    with ikservo.open_arm("so101", PORT) as arm:
        save_simulated_camera(arm)
    _, known = load_camera("so101", SIMULATED)
    click = TipClick(off_deg=0.0, click_deg=0.4, camera_deg=0.1)
    camera = known.camera.model_copy(update={"tip_shows": "wrist_roll", "tip_clicks": (click,)})
    save_camera("so101", SIMULATED, known.model_copy(update={"camera": camera}))
    with serve_view(port=PORT, cameras=["sim", str(film)]) as served:
        context = browser.new_context(viewport={"width": 1200, "height": 800})
        operator = Operator(context.new_page(), served)
        operator.page.click("#views [value=camera]")
        operator.wait_for("scene.camera.lens && scene.picture_trouble === ''")
        yield operator.wait_for_picture()
        context.close()


def lens_of(operator):
    size = operator.page.evaluate("window.ikservo.scene.camera.size")
    return operator.served.view.controller._camera_view.camera(Viewport(*size))


def test_tip_reaches_table_point_clicked_in_camera_view(operator):
    point_m = np.array([0.25, 0.08, 0.03])  # at the height that the page proposes
    px = lens_of(operator).project(point_m)[0]
    operator.click(px).wait_for("scene.goal && scene.marker?.reached")
    np.testing.assert_allclose(operator.items("target")[0]["at"], px, atol=0.6)
    operator.wait_for("!scene.refusal && !document.getElementById('execute').disabled")
    operator.page.click("#execute")
    until(lambda: np.linalg.norm(operator.served.tip_m() - point_m) < 0.002,
          operator.served.tip_m)  # fmt: skip
    assert operator.errors == []


def test_page_switches_between_cameras_of_the_arm(operator):
    page = operator.page
    page.click("#camera-names [value='film.avi']")
    page.wait_for_selector("#camera-names [value='film.avi'][aria-checked=true]")
    page.wait_for_selector("#views [value=camera]", state="detached")  # it was not calibrated
    operator.wait_for("!scene.camera.lens")
    page.wait_for_selector("text=Clicks in the picture cannot set targets")
    picture = page.locator("#camera-picture")
    until(lambda: picture.evaluate("picture => picture.naturalWidth") == 64)
    expect(page.locator("#camera-note")).to_have_text("film.avi – not calibrated")
    page.click("#camera-names [value='camera sim']")
    page.click("#views [value=camera]")
    operator.wait_for("scene.camera.lens && scene.picture_trouble === ''")
    until(lambda: picture.evaluate("picture => picture.naturalWidth") == 960)
    assert operator.errors == []


@pytest.mark.parametrize("view", ["camera", "side"])
def test_camera_choices_on_a_phone_do_not_overlap(operator, view):
    operator.page.set_viewport_size({"width": 390, "height": 844})
    operator.page.click(f"#views [value={view}]")
    operator.until_drawn()
    switches = ["#camera-names", *(["#camera-places"] if view == "side" else [])]
    found = boxes(operator, ".mode", "#views", ".readout", "#gripper", "#poses", *switches)
    assert not any(overlap(*pair) for pair in itertools.combinations(found, 2))


def test_click_in_stale_camera_picture_is_ignored(operator, monkeypatch):
    monkeypatch.setattr(video, "_OLD_S", 2.0)
    monkeypatch.setattr(SimulatedCamera, "take", lambda _: None)  # unplugged
    operator.wait_for("scene.picture_trouble")
    operator.click(lens_of(operator).project([0.25, 0.08, 0.03])[0])
    operator.until_drawn()
    assert operator.page.evaluate("window.ikservo.scene.goal") is None
    operator.page.wait_for_selector("#camera[data-trouble=late] #camera-note:has-text('is late')")


def test_click_after_mark_tip_button_does_not_set_target(operator):
    button = operator.page.locator("#mark-tip")
    assert button.inner_text() == "Click the tip (1 so far)"
    for _ in range(20):
        button.click()
        assert button.get_attribute("aria-checked") == "true"
        operator.click(lens_of(operator).project(operator.served.tip_m())[0])
        operator.page.wait_for_selector("#mark-tip[aria-checked=false]")
        operator.page.wait_for_timeout(300)
        if "are exact" in operator.page.inner_text("#log"):
            break  # the arm has rested for half a second while its picture was shown
    operator.page.wait_for_selector("text=The zeros of a simulated arm are exact")
    assert operator.page.evaluate("window.ikservo.scene.goal") is None
    operator.page.click("#views [value=top]")
    button.wait_for(state="hidden")
    assert operator.errors == []
