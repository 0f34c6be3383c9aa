"""The path to a target in a browser: shown before execution, and around obstacles."""

import math

import numpy as np
import pytest
from playwright.sync_api import expect

from ikservo.apps.page.picking.link_poses import link_poses
from tests.browser.page_operator import Operator, serve_view, until

pytestmark = pytest.mark.browser

SCENE = """
[[box]]
name = "the post"
center_m = [0.17, -0.1, 0.15]
size_m = [0.04, 0.04, 0.3]
"""
GOAL_DEG = 60.0
COPIES = """() => {
  const { ghost, sweep } = window.ikservo.rendering.scene3d;
  const [part] = ghost.parts.get("gripper");
  const copies = sweep.copies[sweep.parts.indexOf(part)];
  const rows = (m) => Array.from({ length: 16 }, (_, i) => m[4 * (i % 4) + Math.floor(i / 4)]);
  const matrices = Array.from({ length: copies.count }, (_, i) => rows(copies.instanceMatrix.array.slice(16 * i, 16 * i + 16)));
  return [rows(part.matrix.elements), matrices];
}"""  # noqa: E501


@pytest.fixture
def served(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    with serve_view(scene=path) as view:
        yield view


@pytest.fixture
def person(browser, served):
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield Operator(context.new_page(), served)
    context.close()


def aim(operator):
    """Type a target beyond the post, and wait until its path can be executed."""
    operator.page.get_by_label("shoulder_pan, degrees", exact=True).fill(f"{GOAL_DEG:g}")
    operator.page.keyboard.press("Enter")
    operator.wait_for("scene.path && scene.swept && status.path === scene.path.number")
    operator.until("!document.getElementById('execute').disabled")


def way_row(operator):
    return dict(row[:2] for row in operator.status["tip"])["path"]


def test_path_around_obstacle_is_shown_and_executed(person):
    page, arm = person.page, person.served.arm
    page.click("#speeds button[value=fast]")
    aim(person)
    assert way_row(person).startswith("around, ")
    expect(page.locator("#log")).to_contain_text("would touch the post; the arm goes around")
    (planned,) = person.items("planned")
    assert len(planned["points"]) == 25
    expect(page.locator("#refusal")).to_be_hidden()
    page.click("#execute")
    nearest = []

    def is_there():
        nearest.append(arm.clearance_m(person.served.joints()))
        return math.degrees(person.served.joints()["shoulder_pan"]) > GOAL_DEG - 1.0

    until(is_there, lambda: (person.served.joints(), person.status))
    assert min(nearest) > 0.0
    person.wait_for("status.mode === 'preview' && !scene.path")
    assert person.errors == []


def test_obstacle_changes_the_shown_path_and_stop_clears_it(person):
    page = person.page
    aim(person)
    number, before = person.page.evaluate("ikservo.scene.path.number"), person.served.goals()
    words = way_row(person)
    page.click("#things-card summary")
    field = page.get_by_label("the post: length z, mm", exact=True)
    field.fill("200")
    field.press("Enter")
    person.wait_for(f"scene.path && scene.path.number > {number}")
    person.wait_for("status.path === scene.path.number")
    assert way_row(person) != words
    page.click("#stop")
    person.wait_for("status.mode === 'stopped' && !scene.path && status.path === null")
    page.click("#acknowledge")
    person.wait_for("status.mode === 'preview' && !status.target")
    expect(page.locator("#execute")).to_be_disabled()
    assert max(abs(person.served.goals()[i] - before[i]) for i in before) <= 2


def test_3d_postures_on_path_match_forward_kinematics(webgl_browser, served):
    context = webgl_browser.new_context(viewport={"width": 700, "height": 600})
    operator = Operator(context.new_page(), served, options="&draw=3d")
    operator.until("Boolean(window.ikservo.rendering.scene3d) && window.ikservo.rendering.tried")
    aim(operator)
    path = served.view.controller._planner.path
    T_link_part, copies = operator.page.evaluate(COPIES)
    assert len(copies) == 5
    for copy, (q, others) in zip(copies, path.postures[4:24:4], strict=True):
        T = link_poses(served.arm.chain, q, others)["gripper"] @ np.reshape(T_link_part, (4, 4))
        np.testing.assert_allclose(np.reshape(copy, (4, 4)), T, atol=1e-5)
    context.close()
