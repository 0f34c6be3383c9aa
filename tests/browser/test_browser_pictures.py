"""The pictures of the page that the README shows; `make pictures` draws them anew."""

import os
from pathlib import Path

import numpy as np
import pytest

pytestmark = [pytest.mark.browser, pytest.mark.campaign]


@pytest.fixture
def album(tmp_path):
    """Where pictures go: docs/pictures when they are wanted, else nowhere that lasts."""
    folder = Path(os.environ.get("IKSERVO_PICTURES") or tmp_path)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def taken(person, path):
    person.page.wait_for_timeout(1500)  # for the region of reach, which is found meanwhile
    person.page.screenshot(path=path)
    return path.stat().st_size


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_arm_follows_in_both_colours(visit, album, scheme):
    person = visit(color_scheme=scheme).throw_live()
    person.click(person.tip_px() + np.array([30.0, -120.0])).until_moving().until_still()
    person.drag(person.hub_px("wrist_flex"), np.array([45.0, 10.0])).until_still()
    assert taken(person, album / f"view_{scheme}.png") > 20_000
    person.release()


def test_a_target_out_of_reach(visit, album):
    person = visit(color_scheme="light")
    person.page.click("#views button[value=orbit]")
    person.page.wait_for_timeout(300)
    person.drag(person.tip_px(), np.array([60.0, -430.0]), steps=20)
    assert taken(person, album / "view_orbit.png") > 20_000


@pytest.mark.parametrize("house", [{"arm": "planar3", "port": "sim"}], indirect=True)
def test_the_lecture_in_a_plane(visit, album):
    person = visit(color_scheme="light")
    person.page.click("#solvers button[value=ccd]")
    person.wait_for("status.solver.name === 'ccd'")
    person.click(person.tip_px() + np.array([-260.0, -170.0]))
    assert taken(person, album / "view_planar.png") > 20_000


def test_a_phone(visit, album):
    person = visit(
        color_scheme="dark", is_mobile=True, has_touch=True, device_scale_factor=2,
        screen={"width": 390, "height": 844},
    )  # fmt: skip
    person.page.set_viewport_size({"width": 390, "height": 844})
    person.page.wait_for_timeout(500)
    person.wait_for_picture()
    assert taken(person, album / "view_phone.png") > 20_000


@pytest.mark.parametrize("house", [{}], indirect=True, ids=["own"])
def test_a_calibration(visit, album):
    person = visit(color_scheme="light")
    person.page.click("#calibrate")
    person.page.wait_for_selector("#wizard:not([hidden])")
    for _ in range(20):  # the arm has to lie still first
        person.page.wait_for_timeout(500)
        if person.status["calibration"]["stage"] == "sweep":
            break
        person.page.click("[data-action=accept]")
    assert taken(person, album / "view_calibration.png") > 20_000
