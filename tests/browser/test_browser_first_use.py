"""First use of the page: each control is visible when it is needed."""

import math

import pytest
from playwright.sync_api import expect

from tests.browser.page_operator import Operator, serve_view, until
from tests.browser.tab_order import expect_read_in_order
from tests.calibration.narrow_arm import write_narrow_arm

pytestmark = pytest.mark.browser

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
IN_SIGHT = """(id) => {
  const box = document.getElementById(id).getBoundingClientRect();
  const at = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  return Boolean(at?.closest(`#${id}`)) && box.top >= 0 && box.bottom <= innerHeight;
}"""


COVERED = """() => {
  const box = document.querySelector(".readout").getBoundingClientRect();
  const from = document.getElementById("drawing").getBoundingClientRect();
  const links = window.ikservo.items.filter(({ style, link }) => style === "measured" && link);
  const inside = ([x, y]) => x + from.x > box.left && x + from.x < box.right && y + from.y > box.top && y + from.y < box.bottom;
  return links.filter(({ rings }) => rings.flat().some(inside)).map(({ link }) => link);
}"""  # noqa: E501


# Where in the camera's pose (4, 4), row by row, the base's axis is along which a view looks.
TOWARDS_EYE = {"side": 6, "top": 10, "front": 2}


def open_program(page):
    if page.get_attribute("#program", "open") is None:
        page.click("#program > summary")


def open_program_of_two_steps(page):
    open_program(page)
    for count in (1, 2):
        page.click("#add-wait")
        page.locator("#program-steps li").nth(count - 1).wait_for()


SCREENS = {
    "#program": open_program_of_two_steps,
    "#plots": lambda page: page.click("#plots-toggle"),
    "#help": lambda page: page.click("#help-button"),
}


@pytest.fixture(scope="module")
def newcomer(browser, shared):
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield Operator(context.new_page(), shared)
    context.close()


@pytest.fixture(params=SCREENS)
def screen(newcomer, request):
    """Open a screen of the page, and close it afterwards."""
    SCREENS[request.param](newcomer.page)
    yield request.param
    newcomer.page.evaluate(
        "(root) => document.querySelector(`${root} [id$=-close]`)?.click()", request.param
    )


@pytest.fixture(scope="module")
def on_a_phone(browser):
    """Return a user with a phone and an arm that was never calibrated."""
    with serve_view(calibrated=False) as view:
        context = browser.new_context(**PHONE)
        yield Operator(context.new_page(), view)
        context.close()


def test_tab_key_follows_reading_order_of_each_screen(newcomer, screen):
    expect_read_in_order(newcomer.page, screen)


def test_opened_program_section_is_scrolled_into_view(newcomer):
    open_program(newcomer.page)
    newcomer.page.click("#program > summary")
    newcomer.page.evaluate("document.querySelector('.panel').scrollTop = 0")
    newcomer.page.evaluate("document.querySelector('#program > summary').click()")
    newcomer.until(f"({IN_SIGHT})('program-play') && ({IN_SIGHT})('add-arm')")


@pytest.mark.parametrize(("width", "height"), [(390, 844), (820, 1100), (1100, 720)])
def test_tool_readout_does_not_cover_the_arm(newcomer, width, height):
    page = newcomer.page
    page.set_viewport_size({"width": width, "height": height})
    field = page.locator("#tool-z")
    field.fill(f"{float(field.input_value()) + 20:.1f}")
    field.press("Enter")
    newcomer.wait_for("status.tip.some(([name]) => name === 'target')")
    for view, towards_eye in TOWARDS_EYE.items():
        page.click(f"#views [value={view}]")
        newcomer.wait_for(f"Math.abs(scene.camera.pose[{towards_eye}]) > 0.9").wait_for_picture()
        assert len(newcomer.items("measured")) > 4
        assert page.evaluate(COVERED) == []
    page.click("#views [value=side]")
    page.evaluate("document.getElementById('undo').click()")
    newcomer.wait_for("!status.target")
    page.set_viewport_size({"width": 1280, "height": 800})
    newcomer.wait_for_picture()


@pytest.mark.parametrize(("width", "height"), [(390, 844), (1100, 720)])
def test_program_button_beside_drawing_shows_program_section(newcomer, width, height):
    page = newcomer.page
    page.set_viewport_size({"width": width, "height": height})
    page.evaluate("document.getElementById('program').open = false")
    page.evaluate("scrollTo(0, 0); document.querySelector('.panel').scrollTop = 0")
    assert page.evaluate(IN_SIGHT, "program-show")
    page.click("#program-show")
    newcomer.until(f"({IN_SIGHT})('program-play') && ({IN_SIGHT})('add-arm')")
    page.set_viewport_size({"width": 1280, "height": 800})


def test_refusal_of_typed_target_is_explained_beside_its_fields(newcomer):
    page = newcomer.page
    page.fill("#tool-z", "-60")
    page.press("#tool-z", "Enter")
    newcomer.until(
        "/would touch the table/.test(document.getElementById('target-note').textContent)"
    )
    page.click("#undo")
    newcomer.until("!document.getElementById('target-note').textContent")
    newcomer.wait_for("!status.target")


def test_number_field_selects_its_text_when_focused(newcomer):
    page = newcomer.page
    old = page.input_value("#tool-z")
    page.click("#tool-z")
    newcomer.until(f"String(getSelection()) === '{old}'")
    page.keyboard.type("123")
    assert page.input_value("#tool-z") == "123"
    page.fill("#tool-z", old)  # as it was: nothing is sent


def test_calibrate_button_asks_before_arm_goes_limp(newcomer):
    page = newcomer.page
    newcomer.wait_for("status.health.joints.every(({torque}) => torque === 'on')")
    page.click("#calibrate")
    page.wait_for_selector("#calibration [data-action=stops]")
    assert {joint["torque"] for joint in newcomer.status["health"]["joints"]} == {"on"}
    page.click("#calibration [data-action=cancel]")
    newcomer.wait_for("status.mode === 'preview'")


def test_stop_banner_contains_its_acknowledge_button(newcomer):
    page = newcomer.page
    page.click("#stop")
    page.wait_for_selector("#acknowledge")
    inner, outer = (page.locator(i).bounding_box() for i in ("#acknowledge", "#banner"))
    assert inner["x"] + inner["width"] < outer["x"] + outer["width"] - 4
    page.click("#acknowledge")
    newcomer.wait_for("status.mode === 'preview'")


def test_go_there_button_is_visible_on_phone(newcomer):
    page, before = newcomer.page, newcomer.served.joints()["wrist_roll"]
    page.set_viewport_size({"width": 390, "height": 844})
    field = page.locator("[data-joint=wrist_roll] input[type=text]")
    field.scroll_into_view_if_needed()
    field.fill(f"{math.degrees(before) + 10:.1f}")
    field.press("Enter")
    newcomer.until("!document.getElementById('execute').disabled")
    assert page.evaluate("scrollY") > 300
    for part in (0, 1):
        page.evaluate("(part) => scrollTo(0, part * document.documentElement.scrollHeight)", part)
        assert page.evaluate(IN_SIGHT, "execute")
        assert page.evaluate(IN_SIGHT, "stop")
    box = page.locator("#execute").bounding_box()
    assert box["height"] >= 40
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    turned = lambda: math.degrees(newcomer.served.joints()["wrist_roll"] - before)  # noqa: E731
    until(lambda: abs(turned() - 10) < 1.0, turned)
    page.set_viewport_size({"width": 1280, "height": 800})
    newcomer.until("Boolean(document.querySelector('.view-tools #execute'))")
    assert newcomer.errors == []


def test_calibration_screen_on_phone_shows_task_first(on_a_phone):
    page = on_a_phone.start_calibration().page
    page.wait_for_selector("[data-action=accept]")
    on_a_phone.until("document.querySelector('.task').textContent.includes('still; continue')")
    page.click("[data-action=accept]")
    on_a_phone.wait_for("status.calibration.stage === 'sweep'")
    page.wait_for_selector("#calibration .meters li")
    task, calibration = (
        page.locator(i).bounding_box() for i in ("#calibration .task", "#calibration")
    )
    assert task["y"] >= calibration["y"]
    expect(page.locator("#calibration .task")).to_contain_text("Move shoulder_pan")
    page.click("[data-action=cancel]")


@pytest.fixture
def searcher(browser, tmp_path, monkeypatch):
    """Return a user of an arm whose search for its stops is short."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    with serve_view(write_narrow_arm(tmp_path), "sim") as view:
        context = browser.new_context(viewport={"width": 1280, "height": 800})
        yield Operator(context.new_page(), view)
        context.close()


def begin_search(searcher):
    """Agree to everything until the arm searches for its stops."""
    page = searcher.start_calibration("stops").page
    expect(page.locator("#calibration")).to_contain_text("Clear its whole reach.")
    page.click("[data-action=accept]")
    searcher.until("document.querySelector('.task').textContent.includes('still; continue')")
    page.click("[data-action=accept]")
    for joint in ("joint1", "joint2"):
        expect(page.locator("#calibration .task")).to_contain_text(f"Did {joint} move")
        page.click("[data-action=accept]")
    page.wait_for_selector("#calibration progress")
    return page


def test_arm_is_calibrated_against_stops_on_page(searcher, tmp_path):
    page = begin_search(searcher)
    expect(page.locator("#mode")).to_have_text("Calibration – the arm moves")
    page.focus("[data-action=cancel]")
    searcher.wait_for("status.calibration.share > 0")
    assert page.evaluate("document.activeElement.dataset.action") == "cancel"
    page.click("#stop")
    expect(page.locator("#calibration .task")).to_contain_text("Support it")
    expect(page.locator("#stop-word")).to_have_text("Stop")
    page.click("[data-action=accept]")
    page.click("#acknowledge")  # the simulated arm is opened anew, and holds
    searcher.wait_for("status.mode === 'preview'")
    page = begin_search(searcher)
    expect(page.locator("#calibration .task")).to_contain_text("Save to")
    page.click("[data-action=accept]")
    expect(page.locator("#calibration .task")).to_have_text("Saved.")
    page.click("[data-action=accept]")
    searcher.wait_for("status.mode === 'preview'")
    assert list((tmp_path / "home").rglob("narrow*.toml"))
    assert searcher.errors == []
