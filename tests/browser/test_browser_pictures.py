"""The pictures of the panel in README and docs; `make pictures` draws them again."""

import io
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.browser.page_operator import Operator

pytestmark = [pytest.mark.browser, pytest.mark.campaign]


@pytest.fixture
def album(tmp_path):
    """Return the folder for pictures: docs/pictures if requested, else a temporary one."""
    folder = Path(os.environ.get("IKSERVO_PICTURES") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def taken(operator, path):
    operator.page.wait_for_timeout(1500)  # for the region of reach, which is found meanwhile
    operator.page.screenshot(path=path)
    return path.stat().st_size


def test_screenshot_of_arm_in_2d_drawing_is_written(visit, album):
    operator = visit(color_scheme="dark").enable_live()
    operator.click(operator.tip_px() + np.array([30.0, -120.0])).until_moving().until_still()
    operator.drag(operator.hub_px("wrist_flex"), np.array([45.0, 10.0])).until_still()
    assert taken(operator, album / "view_dark.png") > 20_000
    operator.release()


@pytest.fixture
def orbiting(webgl_browser, view):
    context = webgl_browser.new_context(
        viewport={"width": 1100, "height": 720}, color_scheme="light"
    )
    operator = Operator(context.new_page(), view, options="&draw=3d")
    operator.page.click("#views button[value=orbit]")
    operator.wait_for("scene.webgl && scene.measured")
    yield operator
    context.close()


POINTER = """() => {
  const pointer = document.body.appendChild(document.createElement("div"));
  pointer.style.cssText = "position:fixed;z-index:99;width:22px;height:22px;margin:-11px;"
    + "border-radius:50%;background:#d9480f99;border:2px solid #d9480f;pointer-events:none";
  addEventListener("pointermove", (event) => {
    pointer.style.left = `${event.clientX}px`;
    pointer.style.top = `${event.clientY}px`;
  }, true);
}"""


class Film:
    """Screenshots of the page, each with its display time."""

    def __init__(self, page, size=(880, 576)):
        self.page, self.size = page, size
        self.frames, self.shown_ms = [], []

    def take(self, shown_ms):
        shot = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        self.frames.append(shot.resize(self.size, Image.Resampling.LANCZOS))
        self.shown_ms.append(shown_ms)

    def follow(self, operator, start, move, frames):
        """Drag from a pixel along an arc, and record each step once the page has drawn it."""
        self.page.mouse.move(*operator.over(start))
        self.page.mouse.down()
        for share in np.linspace(0.0, 1.0, frames):
            bow = 0.3 * np.sin(np.pi * share) * np.array([-move[1], move[0]])
            self.page.mouse.move(*operator.over(start + share * move + bow))
            self.page.wait_for_timeout(120)
            self.take(80)
        self.page.mouse.up()

    def save(self, path):
        first, *others = self.frames
        first.save(path, save_all=True, append_images=others, duration=self.shown_ms, loop=0,
                   quality=55)  # fmt: skip


@pytest.mark.timeout(600)  # each picture takes a second of a busy core
def test_animation_of_drag_in_3d_is_written(orbiting, album):
    page, film = orbiting.page, Film(orbiting.page)
    page.evaluate(POINTER)
    page.wait_for_timeout(1500)  # for the region of reach
    film.take(600)
    film.follow(orbiting, orbiting.tip_px(), np.array([90.0, -120.0]), frames=14)
    film.take(900)  # the ghost, the path of the tip and Go there
    orbiting.before = orbiting.served.ticks()
    page.click("#execute")
    film.take(300)
    orbiting.until_moving().until_still()
    film.take(600)
    orbiting.enable_live()
    film.take(500)
    film.follow(orbiting, orbiting.tip_px(), np.array([-130.0, -80.0]), frames=20)
    orbiting.until_still()
    film.take(1500)
    film.save(album / "drag.webp")
    assert 50_000 < (album / "drag.webp").stat().st_size < 1_000_000


@pytest.mark.parametrize("view", [{"arm": "planar3", "port": "sim"}], indirect=True)
def test_screenshot_of_planar_solver_is_written(visit, album):
    operator = visit(color_scheme="light")
    operator.open_solver().page.click("#solvers button[value=ccd]")
    operator.wait_for("status.solver.name === 'ccd'")
    operator.click(operator.tip_px() + np.array([-260.0, -170.0]))
    assert taken(operator, album / "view_planar.png") > 20_000


def test_screenshot_of_page_on_phone_is_written(visit, album):
    operator = visit(
        color_scheme="dark", is_mobile=True, has_touch=True, device_scale_factor=2,
        screen={"width": 390, "height": 844},
    )  # fmt: skip
    operator.page.set_viewport_size({"width": 390, "height": 844})
    operator.page.wait_for_timeout(500)
    operator.wait_for_picture()
    assert taken(operator, album / "view_phone.png") > 20_000


@pytest.mark.timeout(600)
@pytest.mark.parametrize("view", [{"port": "sim:?hand=calibrate"}], indirect=True, ids=["own"])
def test_animation_of_calibration_is_written(orbiting, album):
    page, film = orbiting.start_calibration().page, Film(orbiting.page)
    page.wait_for_selector("#calibration:not([hidden])")
    for _ in range(20):  # the arm has to lie still first
        page.wait_for_timeout(500)
        if orbiting.status["calibration"]["stage"] == "sweep":
            break
        film.take(700)
        page.click("[data-action=accept]")
    for _ in range(40):  # the simulated person moves one joint after the other
        page.wait_for_timeout(250)
        film.take(120)
    film.save(album / "calibration.webp")
    assert 50_000 < (album / "calibration.webp").stat().st_size < 1_000_000
