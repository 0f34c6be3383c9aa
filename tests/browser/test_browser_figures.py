"""The figures of docs/lecture.md do what their text says."""

import re
from pathlib import Path

import pytest

from tests.browser.page_operator import with_long_timeout

pytestmark = pytest.mark.browser
FIGURES = Path(__file__).parents[2] / "docs" / "figures"
LECTURE = (FIGURES.parent / "lecture.md").read_text("utf-8")
NAMES = re.findall(r'<figure class="interactive" data-figure="(\w+)"></figure>', LECTURE)


@pytest.fixture(scope="module")
def page(browser):
    """Return a page with the figures alone, in the order of the document."""
    context = browser.new_context(viewport={"width": 700, "height": 900})
    page = with_long_timeout(context.new_page())
    page.route("http://docs.test/**", serve)
    page.goto("http://docs.test/")
    yield page
    context.close()


def serve(route):
    name = route.request.url.rpartition("/")[2]
    if name:
        route.fulfill(body=(FIGURES / name).read_text("utf-8"), content_type="text/javascript")
        return
    figures = "".join(f'<figure data-figure="{each}"></figure>' for each in NAMES)
    body = f'<!doctype html>{figures}<script type="module" src="lecture.js"></script>'
    route.fulfill(body=body, content_type="text/html")


def figure(page, name):
    return page.locator(f'figure[data-figure="{name}"]')


def drag_to(page, name, x, y):
    """Drag to a place, given as fractions of the drawing from its lower left corner."""
    svg = figure(page, name).locator("svg")
    svg.scroll_into_view_if_needed()
    box = svg.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + x * box["width"], box["y"] + (1 - y) * box["height"], steps=3)
    page.mouse.up()
    return figure(page, name).locator("output").inner_text()


def test_two_link_figure_reports_point_out_of_reach(page):
    assert drag_to(page, "twoLinks", 0.7, 0.7).startswith("two solutions")
    assert drag_to(page, "twoLinks", 0.99, 0.99).startswith("unreachable")


def test_three_link_figure_shows_reachable_tool_directions(page):
    share = re.search(r"(\d+) % of all directions", drag_to(page, "threeLinks", 0.85, 0.6))
    assert 0 < int(share[1]) < 100


def test_forward_kinematics_figure_moves_links_beyond_joint(page):
    output = figure(page, "forwardKinematics").locator("output")
    pattern = r"φ\d = (.*): link \d ends at (.*) m"
    before = re.findall(pattern, output.inner_text())
    after = re.findall(pattern, drag_to(page, "forwardKinematics", 0.9, 0.3))  # link 1 is pressed
    assert [angle for angle, _ in after][1:] == [angle for angle, _ in before][1:]
    assert all(end != start for (_, end), (_, start) in zip(after, before, strict=True))


def test_jacobian_figure_predicts_tip_motion_of_small_turn(page):
    text = drag_to(page, "jacobianColumns", 0.3, 0.7)
    tips = re.findall(r"moves the tip ([\d.]+) mm, ([\d.]+) mm beside", text)
    assert len(tips) == 3
    assert all(float(beside) <= 0.05 * float(moved) for moved, beside in tips)


def test_damping_figure_shortens_step_near_singular_posture(page):
    def furthest_deg(damping):
        figure(page, "damping").locator("input").fill(damping)
        text = figure(page, "damping").locator("output").inner_text()
        return float(re.search(r"turn by ([\d.]+)°", text)[1])

    figure(page, "damping").scroll_into_view_if_needed()
    assert furthest_deg("0.001") > 90.0
    assert furthest_deg("0.05") < 20.0


def test_joint_limit_figure_stops_at_limit_and_moves_off_again(page):
    figure(page, "jointLimits").locator("input").fill("0.75")

    def end_after_drag_to(x, y):
        assert "step 0," in drag_to(page, "jointLimits", x, y)
        figure(page, "jointLimits").get_by_text("To the end").click()
        return figure(page, "jointLimits").locator("output").inner_text()

    near = end_after_drag_to(0.7, 0.4)  # nearer than the limits let the arm bend
    joints = re.search(r"joints (.*);", near)[1].split(", ")
    assert all(abs(float(value[:-1])) <= 43.1 for value in joints)
    assert near.endswith("at a limit (red): 2, 3, 4")
    far = end_after_drag_to(0.85, 0.5)
    assert re.search(r"error 0\.[01] mm", far)
    assert far.endswith("none")


@pytest.mark.parametrize("name", ["pseudoInverse", "transpose", "ccd"])
def test_iterative_solver_figure_reaches_target(page, name):
    assert "step 0," in drag_to(page, name, 0.55, 0.8)
    figure(page, name).get_by_text("To the end").click()
    assert re.search(r"error 0\.[01] mm", figure(page, name).locator("output").inner_text())


def test_null_space_figure_moves_elbow_and_keeps_tip(page):
    figure(page, "nullSpace").scroll_into_view_if_needed()
    output = figure(page, "nullSpace").locator("output")
    before = output.inner_text()
    figure(page, "nullSpace").locator("input").fill("-0.9")
    assert output.inner_text() != before
    assert "tip 0.0 mm from the target" in output.inner_text()


def test_picking_figure_tests_only_boxes_that_the_ray_meets(page):
    text = drag_to(page, "picking", 0.9, 0.05)
    assert text.count("misses its box") == 3
    assert text.endswith("selected: nothing")
    assert "selected: nothing" not in drag_to(page, "picking", 0.3, 0.5)
