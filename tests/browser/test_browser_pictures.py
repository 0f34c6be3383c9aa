"""The pictures of the page that the README shows; `make pictures` draws them anew."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.browser.page_operator import Operator

pytestmark = [pytest.mark.browser, pytest.mark.campaign]


@pytest.fixture
def album(tmp_path):
    """Where pictures go: docs/pictures when they are wanted, else nowhere that lasts."""
    folder = Path(os.environ.get("IKSERVO_PICTURES") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def taken(operator, path):
    operator.page.wait_for_timeout(1500)  # for the region of reach, which is found meanwhile
    operator.page.screenshot(path=path)
    return path.stat().st_size


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_arm_follows_in_both_colours(visit, album, scheme):
    operator = visit(color_scheme=scheme).enable_live()
    operator.click(operator.tip_px() + np.array([30.0, -120.0])).until_moving().until_still()
    operator.drag(operator.hub_px("wrist_flex"), np.array([45.0, 10.0])).until_still()
    assert taken(operator, album / f"view_{scheme}.png") > 20_000
    operator.release()


def test_from_all_around_in_3d(webgl_browser, view, album):
    context = webgl_browser.new_context(
        viewport={"width": 1100, "height": 720}, color_scheme="light"
    )
    operator = Operator(context.new_page(), view, options="&draw=3d")
    operator.page.click("#views button[value=orbit]")
    operator.wait_for("scene.webgl && scene.measured")
    operator.drag(operator.tip_px(), np.array([110.0, -90.0])).release()
    operator.page.mouse.move(5, 5)
    assert taken(operator, album / "view_orbit.png") > 20_000
    context.close()


@pytest.mark.parametrize("view", [{"arm": "planar3", "port": "sim"}], indirect=True)
def test_the_lecture_in_a_plane(visit, album):
    operator = visit(color_scheme="light")
    operator.open_solver().page.click("#solvers button[value=ccd]")
    operator.wait_for("status.solver.name === 'ccd'")
    operator.click(operator.tip_px() + np.array([-260.0, -170.0]))
    assert taken(operator, album / "view_planar.png") > 20_000


def test_a_phone(visit, album):
    operator = visit(
        color_scheme="dark", is_mobile=True, has_touch=True, device_scale_factor=2,
        screen={"width": 390, "height": 844},
    )  # fmt: skip
    operator.page.set_viewport_size({"width": 390, "height": 844})
    operator.page.wait_for_timeout(500)
    operator.wait_for_picture()
    assert taken(operator, album / "view_phone.png") > 20_000


@pytest.mark.parametrize("view", [{}], indirect=True, ids=["own"])
def test_a_calibration(visit, album):
    operator = visit(color_scheme="light").start_calibration()
    operator.page.wait_for_selector("#wizard:not([hidden])")
    for _ in range(20):  # the arm has to lie still first
        operator.page.wait_for_timeout(500)
        if operator.status["calibration"]["stage"] == "sweep":
            break
        operator.page.click("[data-action=accept]")
    assert taken(operator, album / "view_calibration.png") > 20_000
