"""The list of arms: opened, changed, stopped and closed on the page, without a restart."""

from contextlib import contextmanager

import pytest
from playwright.sync_api import expect

from ikservo.apps.page import arm_choices
from ikservo.apps.page.panels.video import VideoSource
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.hardware.serial_ports import SerialAdapter
from ikservo.model import load_model
from tests.apps.page.webcam import Webcam
from tests.arm.simulated import line_of, registers
from tests.browser.page_operator import HoldingView, Operator, ServedView, until, with_long_timeout
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

pytestmark = pytest.mark.browser

# What can be reached inside the list, in its order, and what is reached now.
IN_ORDER = """() => [...document.querySelectorAll("#arms :is(button, select, input)")]
  .filter((e) => e.checkVisibility() && !e.disabled)
  .map((e) => e.getAttribute("aria-label") || e.id || e.textContent)"""
IS_FOCUSED = """() => document.activeElement.getAttribute("aria-label")
  || document.activeElement.id || document.activeElement.textContent"""


@contextmanager
def opened_panel(*places, **options):
    arms = [ArmAtPort(load_model(arm), port) for arm, port in places]
    app = HoldingView(arms, dead_man_s=5.0, **options)
    with app as urls, app.serve_in_thread() as server:
        yield ServedView(app, urls, server)


@pytest.fixture
def page(browser):
    context = browser.new_context(viewport={"width": 1100, "height": 800})
    page = with_long_timeout(context.new_page())
    yield page
    context.close()


@pytest.fixture(scope="module")
def two():
    """Two arms that hold, for the tests that leave them open."""
    with opened_panel(("so101", "sim:?pose=home"), ("koch", "sim:?pose=home")) as served:
        yield served


def test_page_chooses_new_adapter_unless_another_was_chosen(page, monkeypatch):
    adapters = []
    monkeypatch.setattr(arm_choices, "list_adapters", lambda: tuple(adapters))
    with opened_panel() as served:
        page.goto(served.urls.control)
        expect(page.locator("#arms-port")).to_have_value("sim")
        adapters.append(SerialAdapter("/dev/ttyACM7", "", 0x1A86, 0x55D3, "5A1"))
        expect(page.locator("#arms-port")).to_have_value("/dev/ttyACM7")
        page.select_option("#arms-port", "sim")
        adapters.append(SerialAdapter("/dev/ttyACM8", "", 0x1A86, 0x55D3, "5A2"))
        page.wait_for_selector("#arms-port [value='/dev/ttyACM8']", state="attached")
        expect(page.locator("#arms-port")).to_have_value("sim")


def row(page, name):
    return page.locator(f"#arms-open [data-arm={name}]")


def test_page_without_arm_explains_how_to_show_camera(page):
    with opened_panel(cameras=["0"]) as served:
        page.goto(served.urls.control)
        page.wait_for_selector("text=The picture of camera 0 is shown with an arm: open one.")
        expect(page.locator("#camera")).to_be_hidden()


def test_page_without_arm_lists_opens_and_changes_arms(page):
    with opened_panel() as served:
        page.goto(served.urls.control)
        page.wait_for_selector("#arms-port [value=sim]", state="attached")
        expect(page.locator("#arms")).to_be_visible()
        expect(page.locator("#live")).to_be_hidden()
        page.select_option("#arms-model", "koch")
        page.select_option("#arms-port", "sim")
        page.click("#arms-form [type=submit]")
        page.wait_for_selector("#title:has-text('Koch')")
        page.wait_for_selector("body[data-mode=preview]")
        koch = served.app.arms.find("koch")
        assert set(koch.arm_thread.arm.chain.names) >= set(page.evaluate(
            "[...document.querySelectorAll('#joints [data-joint]')].map((e) => e.dataset.joint)"
        )) - {"gripper"}  # fmt: skip
        page.click("#arms-toggle")
        page.select_option("#arms-model", "planar3")
        page.click("#arms-form [type=submit]")
        page.wait_for_selector("#views [value=plane]")
        page.click("#arms-toggle")
        page.click("[aria-label='Show koch']")
        page.wait_for_selector("#title:has-text('Koch')")
        page.click("#arms-toggle")
        page.click("[aria-label='Close koch']")
        page.wait_for_selector("#banner-message:has-text('This arm was closed')")
        expect(page.locator("#stop")).to_be_disabled()
        until(lambda: [arm.name for arm in served.app.arms.all()] == ["planar3"])


def test_arm_list_is_legible_labelled_and_in_tab_order(page, two):
    for width, scheme in ((390, "dark"), (1100, "light")):
        page.set_viewport_size({"width": width, "height": 844})
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        page.goto("about:blank")
        operator = Operator(page, two)
        page.click("#arms-toggle")
        page.wait_for_selector("#arms-port [value=sim]", state="attached")
        row(page, "koch").wait_for()
        assert operator.page.evaluate(CONTRAST) == []
        assert operator.page.evaluate(SMALL, 24) == []
        assert operator.page.evaluate("document.documentElement.scrollWidth") <= width
        assert all(operator.page.evaluate(NAMES))
    page.focus("#arms-toggle")
    expected, reached = page.evaluate(IN_ORDER), []
    for _ in expected:
        page.keyboard.press("Tab")
        reached.append(page.evaluate(IS_FOCUSED))
    assert len(expected) >= 8  # close, show, stop and close of two arms, arm, port, open
    assert reached == expected


def test_space_key_stops_every_arm_and_list_shows_reason(page, two):
    operator = Operator(page, two)
    operator.enable_live()
    koch = two.app.arms.find("koch").arm_thread
    page.click("#arms-toggle")
    page.click("[aria-label='Stop koch']")
    row(page, "koch").filter(has_text="Stopped from the list of arms").wait_for()
    assert "stopped – " not in row(page, "koch").inner_text()
    assert operator.status["mode"] == "live"
    koch.acknowledge()
    row(page, "koch").filter(has_text="preview").wait_for()
    before = [registers(koch.arm, "goal_position"), two.goals()]
    page.keyboard.press("Space")
    operator.wait_for("status.mode === 'stopped'")
    row(page, "koch").filter(has_text="Stopped by the Space key on the page").wait_for()
    expect(page.locator("#banner-message")).to_contain_text("by the Space key on the page")
    for goals, held in zip(
        [registers(koch.arm, "goal_position"), two.goals()], before, strict=True
    ):
        assert max(abs(goals[i] - held[i]) for i in held) <= 4  # each lifts what sags
    koch.acknowledge()
    row(page, "koch").filter(has_text="preview").wait_for()
    line_of(koch.arm).plugged = False
    row(page, "koch").filter(has_text="Lost connection").wait_for()
    page.click("#acknowledge")
    operator.wait_for("status.mode === 'preview'")


def test_camera_picture_is_shown_and_unplugged_camera_reported(page, monkeypatch):
    pytest.importorskip("cv2")
    webcam = Webcam()
    monkeypatch.setattr(
        "ikservo.apps.page.panels.page_cameras.VideoSource",
        lambda source, clock: VideoSource(source, clock, webcam.open),
    )
    with opened_panel(("planar2", "sim"), cameras=["0"]) as served:
        operator = Operator(page, served)
        operator.until("document.getElementById('camera-picture').naturalWidth === 32")
        page.wait_for_selector("#camera-note:text-is('camera 0 – not calibrated')")
        assert page.evaluate(CONTRAST) == []
        page.click("#camera-places [value=large]")
        stage, picture = (page.locator(each).bounding_box() for each in ("#drawing", "#camera"))
        assert picture["width"] == pytest.approx(stage["width"], abs=4)
        assert page.locator("#drawing").is_hidden()  # it would not fit the picture
        webcam.plugged = False
        page.wait_for_selector("#camera[data-trouble]")
        assert page.inner_text("#camera-note").startswith("camera 0 cannot be opened")
        page.click("#camera-places [value=off]")
        expect(page.locator("#camera")).to_be_hidden()
        until(lambda: webcam.released == webcam.opened)


def test_arm_is_created_and_opened_on_the_page(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with opened_panel() as served:
        page.goto(served.urls.control)
        page.wait_for_selector("#arms-port [value=sim]", state="attached")
        page.click("#new-arm summary")
        page.fill("#new-arm-name", "measured")
        page.click("#new-arm-start")
        page.set_default_timeout(60_000)
        page.wait_for_selector("#dialogue form:has-text('How many joints')")
        expect(page.locator("#new-arm-start")).to_be_disabled()
        page.select_option("#dialogue select", "2")
        for question, typed in [
            ("Joint 1: axis", "z"), ("Joint 1: distance", "0.1"), ("Joint 2: axis", "y"),
            ("Joint 2: distance", "0.12"),
        ]:  # fmt: skip
            page.keyboard.press("Tab")  # the answer is sent by the keyboard alone
            page.keyboard.press("Enter")
            page.wait_for_selector(f"#dialogue form:has-text('{question}')")
            entry = page.locator("#dialogue form :is(input, select)")
            if entry.evaluate("(e) => e.tagName") == "SELECT":
                entry.select_option(typed)
            else:
                entry.fill(typed)
        page.click("#dialogue form button")
        page.click("#dialogue form:has-text('Write') button:has-text('write')")
        page.wait_for_selector("#dialogue p:has-text('Written to')")
        page.wait_for_selector("#arms-model [value=measured]", state="attached")
        page.select_option("#arms-model", "measured")
        page.select_option("#arms-port", "sim")
        page.click("#arms-form [type=submit]")
        page.wait_for_selector("#title:has-text('measured')")
        assert (tmp_path / "measured" / "arm.toml").is_file()


def test_page_sets_up_and_checks_new_servos(page):
    with opened_panel() as served:
        page.goto(served.urls.control)
        page.wait_for_selector("#arms-port [value=sim]", state="attached")
        page.set_default_timeout(60_000)
        page.select_option("#arms-model", "so101")
        page.select_option("#arms-port", "sim")
        page.click("#arms-setup")
        page.click("#dialogue form button:has-text('Continue')")
        expect(page.locator("#arms-check")).to_be_disabled()
        page.wait_for_selector("#dialogue form:has-text('Set it to id 1 at 1000000 baud')")
        page.click("#dialogue form button:has-text('yes')")
        page.focus("#dialogue button:has-text('Leave')")
        page.wait_for_selector("#dialogue li:has-text('✓ shoulder_pan (id 1): id 9 → 1')")
        assert page.evaluate("document.activeElement.textContent") == "Leave"
        page.click("#dialogue button:has-text('Leave')")
        expect(page.locator("#dialogue")).to_be_hidden()
        for _ in range(100):
            page.click("#arms-check")
            page.wait_for_timeout(300)
            if page.locator("#dialogue").is_visible():  # the port was closed
                break
        page.wait_for_selector("#dialogue p:has-text('No faults found.')")
        assert page.evaluate(CONTRAST) == []
