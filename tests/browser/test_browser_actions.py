"""Preview executed by one button, undo by keys, zoom, help, and a hundred poses in a list."""

import math

import numpy as np
import pytest
import tomli_w
from playwright.sync_api import expect

from tests.arm.simulated import registers
from tests.browser.page_operator import Operator, serve_view, until
from tests.browser.tab_order import expect_read_in_order
from tests.browser.test_browser_page import CONTRAST

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Yield a view of an arm with 97 taught poses, each turning the wrist by a degree more."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IKSERVO_HOME", str(tmp_path_factory.mktemp("home")))
        with serve_view() as view:
            library, home = view.arm.poses, view.arm.model.pose("home")
            poses = {
                f"place_{i:02}": library._pose_tables({**home, "wrist_roll": math.radians(i)})
                for i in range(97)
            }
            library.path.parent.mkdir(parents=True, exist_ok=True)
            library.path.write_text(tomli_w.dumps({"format": 1, "arm": "so101", "poses": poses}))
            yield view


@pytest.fixture(scope="module")
def person(browser, served):
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield Operator(context.new_page(), served)
    context.close()


def joints_deg(operator):
    return [math.degrees(angle) for angle in operator.served.joints().values()]


def test_previewed_goal_is_executed_by_button_and_undone_by_key(person):
    page, before = person.page, person.served.goals()
    page.click("#speeds button[value=fast]")
    expect(page.locator("#execute")).to_be_disabled()
    person.click(person.tip_px() + np.array([25.0, -90.0])).wait_for("status.target")
    first = person.status["goals"]
    page.wait_for_timeout(100)
    page.locator("[data-joint=wrist_roll]").get_by_label("more by one step").click()
    person.wait_for("Math.abs(status.goals[4] - 1) < 0.05")
    page.focus("#drawing")
    page.keyboard.press("Control+z")
    person.wait_for("Math.abs(status.goals[4]) < 0.05")
    assert person.status["goals"] == pytest.approx(first, abs=0.1)
    page.keyboard.press("Control+Shift+z")
    person.wait_for("Math.abs(status.goals[4] - 1) < 0.05")
    assert person.served.goals() == before
    goal = person.status["goals"]
    page.click("#execute")
    until(
        lambda: joints_deg(person) == pytest.approx(goal, abs=0.7),
        lambda: (joints_deg(person), goal, person.status),
    )
    person.wait_for("status.mode === 'preview'")


def test_pose_list_of_100_is_searched_and_used_by_keyboard(person):
    page = person.page
    page.click("#all-poses")
    page.keyboard.type("e_4")
    expect(page.locator("#pose-count")).to_have_text("10 of 100")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    person.wait_for("Math.abs(status.goals[4] - 41) < 0.1")
    assert page.evaluate(CONTRAST) == []
    page.fill("#pose-filter", "e_4")
    expect_read_in_order(page, "#pose-dialog")
    page.fill("#pose-filter", "cup")
    expect(page.locator("#pose-count")).to_contain_text("No pose is called “cup”")
    page.click("#pose-close")


def test_help_opened_by_key_leaves_stop_button_usable(person):
    page = person.page
    page.focus("#drawing")
    page.keyboard.press("?")
    for words in ("Mouse", "Touch", "Keyboard", "Gamepad"):
        assert page.get_by_role("heading", name=words, exact=True).is_visible()
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        assert page.evaluate(CONTRAST) == []
    page.click("#stop")
    person.wait_for("status.mode === 'stopped'")
    page.click("#acknowledge")
    person.wait_for("status.mode === 'preview'")
    page.keyboard.press("?")
    expect(page.locator("#help")).to_be_hidden()


def test_wheel_beside_arm_zooms_and_f_key_resets_zoom(person):
    page = person.wait_for_picture().page  # the drawing is larger again without a stop's notice
    scale, at = person.pixels_per_metre, person.tip_px()
    page.mouse.move(*person.over([40.0, 120.0]))
    person.wait_for("!scene.hover")
    page.mouse.wheel(0, -200)
    until(lambda: person.pixels_per_metre > 1.5 * scale)
    place = np.array([40.0, 120.0])

    def expected_px():
        return place + person.pixels_per_metre / scale * (at - place)

    until(
        lambda: person.tip_px() == pytest.approx(expected_px(), abs=3.0),
        lambda: (person.tip_px(), expected_px()),
    )
    page.keyboard.press("f")
    until(lambda: abs(person.pixels_per_metre / scale - 1) < 1e-3)


@pytest.mark.smoke
def test_relax_button_asks_before_arm_goes_limp(person):
    page = person.page
    page.click("#release")
    expect(page.locator("#release")).to_have_text("The arm will fall. Sure?")
    page.click("#release")
    person.until("document.getElementById('mode').textContent === 'Preview – the arm is limp'")
    expect(page.locator("#relax")).to_be_hidden()
    assert person.errors == []


def test_hold_button_switches_torque_of_all_servos_on(person):
    arm = person.served.arm
    arm.disable_torque()
    person.page.wait_for_selector("#relax", state="hidden")
    person.page.click("#hold")
    until(lambda: all(registers(arm, "torque_enable").values()))
    person.page.wait_for_selector("#relax")
    expect(person.page.locator("#hold")).to_be_hidden()
    assert person.errors == []


def test_partly_limp_arm_can_be_held_and_relaxed(person):
    person.served.arm.runner.set_joint_torque("wrist_roll", on=False)
    person.page.wait_for_selector("#hold")
    expect(person.page.locator("#relax")).to_be_visible()
