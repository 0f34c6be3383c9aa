"""The program panel: two poses taught, ordered, saved, played, stopped; judged by the servos."""

import math
import re

import pytest
from playwright.sync_api import expect

from ikservo.apps.teaching.program import read_program
from tests.browser.page_operator import Operator, serve_view, until
from tests.browser.test_browser_page import CONTRAST, SMALL

pytestmark = pytest.mark.browser

PHASE = "document.getElementById('program-state').className === '{}'"


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IKSERVO_HOME", str(folder))
        yield folder


@pytest.fixture(scope="module")
def teacher(browser, home):
    """Return a user with the panel open during all tests of this module."""
    with serve_view() as view:
        context = browser.new_context(viewport={"width": 1100, "height": 720})
        operator = Operator(context.new_page(), view)
        operator.page.click("#program summary")
        yield operator
        context.close()


@pytest.fixture
def empty(teacher):
    """Return the same user with a program without steps."""
    teacher.page.click("#program-new")
    if teacher.page.inner_text("#program-new") != "New":
        teacher.page.click("#program-new")
    return teacher.until("document.querySelectorAll('#program-steps li').length === 0")


def roll_deg(operator):
    return math.degrees(operator.served.joints()["wrist_roll"])


def teach_roll(operator, degrees):
    """Turn the wrist of the target and add it as a step."""
    field = operator.page.locator("[data-joint=wrist_roll] input[type=text]")
    field.fill(str(degrees))
    field.press("Enter")
    operator.wait_for(f"Math.abs(status.goals.at(-2) - {degrees}) < 0.1")
    count = operator.page.locator("#program-steps li").count()
    operator.page.click("#add-target")
    return operator.until(f"document.querySelectorAll('#program-steps li').length === {count + 1}")


def places(operator):
    return operator.page.locator("#program-steps li").evaluate_all(
        "rows => rows.map((row) => Number(row.dataset.step))"
    )


def test_taught_program_is_reordered_saved_and_played_on_page(empty, home):
    page, before = empty.page, roll_deg(empty)
    page.click("#program-speed button[value=fast]")
    teach_roll(empty, 25)
    teach_roll(empty, -15)
    first, second = places(empty)
    grip = page.get_by_label("Move step 1: arrow up, arrow down")
    grip.press("ArrowDown")
    until(lambda: places(empty) == [second, first])
    assert page.evaluate("document.activeElement.closest('li').dataset.step") == str(first)
    top, bottom = (page.locator(".grip").nth(i).bounding_box() for i in (0, 1))
    page.mouse.move(bottom["x"] + 9, bottom["y"] + 9)
    page.mouse.down()
    page.mouse.move(top["x"] + 9, top["y"] - 8, steps=4)
    page.mouse.up()
    until(lambda: places(empty) == [first, second])
    page.fill("#program-name", "wrist")
    page.click("#program-save")
    empty.until("document.getElementById('program-title').textContent === 'wrist'")
    assert (home / "programs" / "wrist.toml").read_text().count("[[steps]]") == 2
    page.click("#program-check")
    empty.until(PHASE.format("ok"))
    assert abs(roll_deg(empty) - before) < 1.0
    page.click("#program-step")
    empty.until(PHASE.format("paused"))
    assert roll_deg(empty) == pytest.approx(25.0, abs=1.0)
    expect(page.locator("#program-play")).to_have_text("Play from 2")
    page.click("#program-play")
    empty.until(PHASE.format("done"))
    assert roll_deg(empty) == pytest.approx(-15.0, abs=1.0)


def test_stopped_program_does_not_move_after_acknowledgement(empty):
    page = empty.page
    teach_roll(empty, 80)
    teach_roll(empty, -80)
    page.click("#program-play")
    empty.until(PHASE.format("playing")).wait_for("status.mode === 'busy'")
    expect(page.locator("#add-wait")).to_be_disabled()
    expect(page.locator("#live")).to_be_disabled()
    expect(page.locator("#mode")).to_have_text("Playing the program, step 1 of 2 …")
    expect(page.locator("#left")).to_have_text(re.compile(r"about \d+ s left"))
    expect(page.locator("#program-left")).to_have_text(re.compile(r"about \d+ s left"))
    start = roll_deg(empty)
    until(lambda: abs(roll_deg(empty) - start) > 5)
    page.keyboard.press("Escape")
    empty.wait_for("status.mode === 'stopped'").until_still()
    page.wait_for_selector("#program-state:has-text('Stopped in step')")
    expect(page.locator("#left, #program-left")).to_have_text(["", ""])
    expect(page.locator("#program-play")).to_be_disabled()
    before = empty.served.goals()
    page.wait_for_timeout(300)
    assert empty.served.goals() == before
    page.click("#acknowledge")
    empty.wait_for("status.mode === 'preview'")
    assert page.inner_text("#program-play").startswith("Play")
    assert empty.served.goals() == before


def test_program_step_that_cannot_be_run_is_marked_with_reason(empty):
    page, before = empty.page, empty.served.goals()
    page.click("#add-wait")
    for joint, degrees in [("shoulder_lift", "90"), ("elbow_flex", "-20")]:
        page.fill(f"[data-joint={joint}] input[type=text]", degrees)
        page.press(f"[data-joint={joint}] input[type=text]", "Enter")
    empty.wait_for("status.refused")
    page.click("#add-target")
    until(lambda: len(places(empty)) == 2)
    page.click("#program-play")
    empty.until(PHASE.format("bad"))
    expect(page.locator("#program-steps li.bad .reason")).to_contain_text("the table")
    page.click("#add-wait")
    page.click("#add-target")
    until(lambda: len(places(empty)) == 4)
    page.click("#program-check")
    page.wait_for_selector("#program-state:has-text('Steps 2, 4 cannot be carried out')")
    reasons = page.locator("#program-steps li.bad .reason")
    assert ["the table" in text for text in reasons.all_inner_texts()] == [True, True]
    assert empty.served.goals() == before
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        assert page.evaluate(CONTRAST) == []
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(SMALL, 24) == []
    assert empty.errors == []


def test_grid_is_added_and_edited_by_keyboard(empty, home):
    page = empty.page
    page.locator("#add-grid").press("Enter")
    rows = page.get_by_label("Number of rows, 1 to 30, step 1")
    rows.fill("0")
    rows.press("Enter")
    page.wait_for_selector("#banner-message:has-text('step 1, grid.rows: is 0')")
    expect(rows).to_have_value("2")
    rows.fill("5")
    rows.press("Tab")
    expect(page.locator("#program-steps .what")).to_contain_text("15 places")
    distance = page.get_by_label("From one row to the next: x, y, z in mm, step 1")
    expect(distance).to_be_focused()
    distance.fill("0, 12.5, -1")
    distance.press("Enter")
    corner = page.get_by_label("The tip is at the last place of the first row, step 1")
    expect(corner).to_have_attribute("title", "The tip is at the last place of the first row")
    corner.press("Enter")  # the tip has not moved since
    expect(page.locator("#program-steps [data-part=column_m]")).to_have_value("0, 0, 0")
    page.fill("#program-name", "tray")
    page.click("#program-save")
    empty.until("document.getElementById('program-title').textContent === 'tray'")
    grid = read_program(home / "programs" / "tray.toml").steps[0].grid
    assert (grid.rows, grid.row_m) == (5, (0.0, 0.0125, -0.001))
    assert empty.errors == []


def test_record_button_starts_and_ends_recording_of_limp_arm(empty):
    empty.page.click("#release")
    empty.page.click("#release")
    empty.wait_for(
        "status.mode === 'preview' && status.health.joints.every((j) => j.torque !== 'on')"
    )
    empty.page.click("#record-step")
    empty.wait_for("status.mode === 'busy'")
    empty.until("document.getElementById('record-step').textContent === 'End recording'")
    expect(empty.page.locator("#record-step")).to_be_enabled()
    empty.page.click("#record-step")
    empty.until("document.querySelectorAll('#program-steps li').length === 1")
    expect(empty.page.locator("#program-steps li")).to_contain_text("recording-1.jsonl")
    assert empty.page.locator("#add-recording option").all_inner_texts() == [
        "+ Recording …",
        "recording-1",
    ]
    assert empty.errors == []
