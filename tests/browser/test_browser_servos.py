"""The servo panel in a browser: registers read, filtered, changed and refused."""

import pytest

from tests.arm.simulated import servo_id
from tests.browser.test_browser_page import CONTRAST, NAMES, SMALL

pytestmark = pytest.mark.browser

ROW = "#servos-table li[data-register={}]"


def open_servo(operator, joint="wrist_roll"):
    operator.page.click("#servos summary")
    operator.page.wait_for_selector(ROW.format("p_gain"))
    operator.page.select_option("#servos-joint", joint)
    operator.page.wait_for_selector("#servos-title:has-text('id 5')")
    return operator


@pytest.mark.smoke
def test_servo_panel_reads_filters_and_writes_a_register(operator):
    open_servo(operator)
    switch = operator.page.locator("[data-joint=wrist_roll] .torque")
    switch.click()
    switch.click()  # it falls: sure
    operator.page.wait_for_selector("[data-joint=wrist_roll] .torque[aria-checked=false]")
    held = operator.served.line.servos[servo_id("so101", "wrist_roll")]
    operator.page.fill("#servos-filter", "torque_limit")
    operator.page.wait_for_function(
        "() => document.querySelectorAll('#servos-table li').length === 1"
    )
    field = operator.page.locator(ROW.format("torque_limit") + " input")
    assert field.input_value() == str(held.read("torque_limit"))
    field.fill("60%")
    field.press("Enter")
    operator.page.wait_for_selector("#servos-note:has-text('→ 600')")
    assert held.read("torque_limit") == 600
    field.fill("5000")
    field.press("Enter")
    operator.page.wait_for_selector("#servos-note:has-text('outside')")
    assert held.read("torque_limit") == 600
    field.fill("1000")
    field.press("Enter")
    operator.page.wait_for_selector("#servos-note:has-text('→ 1000')")
    switch.click()
    operator.page.wait_for_selector("[data-joint=wrist_roll] .torque[aria-checked=true]")


def test_servo_panel_is_legible_and_finger_sized(visit):
    operator = open_servo(visit(color_scheme="dark"))
    operator.page.set_viewport_size({"width": 390, "height": 844})
    assert operator.page.evaluate(CONTRAST) == []
    assert operator.page.evaluate(SMALL, 24) == []
    assert all(operator.page.evaluate(NAMES))
