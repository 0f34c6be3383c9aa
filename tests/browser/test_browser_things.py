"""Obstacles around the arm in a browser: added, typed, dragged, removed."""

import numpy as np
import pytest

from tests.browser.page_operator import Operator, until
from tests.browser.test_browser_arms import opened_panel
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

pytestmark = pytest.mark.browser


def scene_of(operator):
    return operator.served.arm.scene


def add(operator, kind, name):
    """Add the only obstacle around the arm, which the tests of this module share."""
    for left in scene_of(operator).names:
        scene_of(operator).remove(left)
    operator.page.click("#things-card summary")
    operator.page.click(f"#add-{kind}")
    operator.page.wait_for_selector(f"[data-thing='{name}']")


def pixel_of(operator, point_m):
    """Return the pixel of a point (3,) in a flat view."""
    camera = operator.page.evaluate("ikservo.scene.camera")
    T = np.reshape(camera["pose"], (4, 4))
    right, up, _ = T[:3, :3].T @ (point_m - T[:3, 3])
    return 0.5 * np.array(camera["size"]) + camera["scale_px"] * np.array([right, -up])


def type_number(operator, label, value):
    field = operator.page.get_by_label(label, exact=True)
    field.fill(value)
    field.press("Enter")


def type_until(operator, label, value, is_there):
    type_number(operator, label, value)
    operator.repeat(lambda: type_number(operator, label, value), is_there)


def test_page_adds_places_names_and_removes_box(operator):
    add(operator, "box", "the box 1")
    type_number(operator, "the box 1: x, mm", "150")
    type_number(operator, "the box 1: y, mm", "0")
    type_number(operator, "the box 1: length z, mm", "100")
    until(lambda: scene_of(operator).things[0].high_m[2] > 0.07)
    (box,) = scene_of(operator).things
    np.testing.assert_allclose(box.row[9:15], (0.15, 0.0, 0.03, 0.03, 0.03, 0.05), atol=1e-9)
    type_number(operator, "Name of the box 1", "the shelf")
    operator.page.wait_for_selector("[data-thing='the shelf']")
    assert scene_of(operator).names == ("the shelf",)
    operator.page.get_by_label("Remove the shelf").click()
    until(lambda: scene_of(operator).names == ())
    operator.page.wait_for_function("() => !document.querySelector('#things li')")


def test_invalid_size_of_scene_object_is_refused_with_message(operator):
    add(operator, "sphere", "the ball 1")
    type_number(operator, "the ball 1: radius, mm", "-5")
    operator.page.wait_for_selector("#log :text('radius_m')")
    type_number(operator, "the ball 1: radius, mm", "wide")
    operator.page.wait_for_selector("#log :text('is not a number of millimetres')")
    assert scene_of(operator).things[0].row[15] == pytest.approx(0.03)


def test_cylinder_is_dragged_along_the_table(operator):
    add(operator, "cylinder", "the can 1")
    type_number(operator, "the can 1: y, mm", "250")
    until(lambda: scene_of(operator).things[0].row[10] > 0.2)
    operator.page.click("#views [value=top]")
    operator.wait_for("scene.camera.pose[10] > 0.9")
    before_m = scene_of(operator).things[0].row[9:12]
    operator.drag(pixel_of(operator, before_m), (40.0, 0.0)).release()
    until(lambda: np.linalg.norm(scene_of(operator).things[0].row[9:12] - before_m) > 0.01)
    assert scene_of(operator).things[0].row[11] == pytest.approx(0.03)


def test_scene_panel_is_legible_and_finger_sized(visit):
    operator = visit(color_scheme="dark")
    add(operator, "box", "the box 1")
    operator.page.set_viewport_size({"width": 390, "height": 844})
    assert operator.page.evaluate(CONTRAST) == []
    assert operator.page.evaluate(SMALL, 24) == []
    assert all(operator.page.evaluate(NAMES))


def test_second_arm_is_placed_and_removed_as_scene_object(browser):
    with opened_panel(("so101", "sim:?pose=home"), ("koch", "sim:?pose=home")) as served:
        context = browser.new_context(viewport={"width": 1100, "height": 720})
        operator = Operator(context.new_page(), served)
        scene = served.app.arms.find("so101").arm_thread.arm.scene

        def is_at(*at_m):
            return scene.arms[0].placed.at_m == pytest.approx(at_m)

        operator.page.click("#things-card summary")
        operator.page.click("#add-arms :text('koch')")
        operator.page.wait_for_selector("[data-thing='koch']")
        assert operator.page.locator("#add-arms button").count() == 0
        type_until(operator, "koch: x, mm", "450", lambda: is_at(0.45, 0.0, 0.0))
        type_until(operator, "koch: y, mm", "100", lambda: is_at(0.45, 0.1, 0.0))
        type_until(
            operator,
            "koch: yaw, degrees",
            "170",
            lambda: scene.arms[0].placed.rpy_deg[2] == pytest.approx(170.0),
        )
        drawn = "({ name, drawn }) => drawn && name === `koch's gripper`"
        operator.until(f"window.ikservo.rendering.things.some({drawn})")
        assert operator.page.evaluate(CONTRAST) == []
        assert operator.page.evaluate(SMALL, 24) == []
        assert all(operator.page.evaluate(NAMES))
        type_until(operator, "koch: x, mm", "0", lambda: is_at(0.0, 0.1, 0.0))
        refused = '#log :text("away from this arm\'s base")'
        type_until(operator, "koch: y, mm", "0", lambda: operator.page.locator(refused).count() > 0)
        assert is_at(0.0, 0.1, 0.0)
        type_until(operator, "koch: z, mm", "20", lambda: is_at(0.0, 0.1, 0.02))
        operator.page.get_by_label("Remove koch").click()
        operator.page.wait_for_selector("#add-arms :text('koch')")
        assert scene.names == ()
        context.close()
