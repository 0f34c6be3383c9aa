"""Joints, tool, gripper and torque operated from the panel, judged by the servos' registers."""

import numpy as np
import pytest

from tests.arm.simulated import registers, servo_id
from tests.browser.page_operator import until

pytestmark = pytest.mark.browser


def tick_of(operator, joint):
    return operator.served.ticks()[servo_id("so101", joint)]


def turned_deg(operator, joint, before):
    return (tick_of(operator, joint) - before) * 360 / 4096


def until_turned(operator, joint, before, wanted_deg):
    until(
        lambda: abs(abs(turned_deg(operator, joint, before)) - wanted_deg) < 1.0,
        lambda: (turned_deg(operator, joint, before), operator.status["banner"]),
    )


def row(operator, joint):
    return operator.page.locator(f"[data-joint={joint}]")


def test_number_field_step_button_and_slider_turn_their_joint(live):
    before = tick_of(live, "wrist_roll")
    field = row(live, "wrist_roll").locator("input[type=text]")
    field.fill("20")
    field.press("Enter")
    until_turned(live, "wrist_roll", before, 20.0)
    live.page.click("#joint-steps button[value='5']")
    row(live, "wrist_roll").get_by_label("wrist_roll more by one step").click()
    until_turned(live, "wrist_roll", before, 25.0)
    row(live, "wrist_roll").locator("input[type=range]").fill("0")
    until_turned(live, "wrist_roll", before, 0.0)


def test_invalid_joint_number_is_refused_without_motion(live):
    before = live.served.goals()
    field = row(live, "elbow_flex").locator("input[type=text]")
    for typed, words in [
        ("twelve", "“twelve” is not a number of degrees: elbow_flex stays."),
        ("1e99", "“1e99” is not a number"),
        ("120", "elbow_flex cannot be at 120°; its range is -96.8 to 96.8°"),
    ]:
        field.fill(typed)
        field.press("Enter")
        live.until(f"document.getElementById('banner-message').textContent.includes('{words}')")
    live.until_still()
    assert max(abs(live.served.goals()[i] - before[i]) for i in before) <= 2
    assert live.errors == []


def test_joint_controls_in_preview_mode_move_only_preview(operator):
    before = operator.served.goals()
    operator.page.fill("#tool-direction", "0 0 -1")
    operator.page.press("#tool-direction", "Enter")
    operator.wait_for("Math.abs(status.tool.pitch + 90) < 0.6")
    x_mm = operator.status["tool"]["x"]
    operator.page.get_by_label("Tool x less by one step").click()
    operator.wait_for(f"Math.abs(status.tool.x - {x_mm - 5}) < 0.2")
    operator.page.fill("#tool-z", "120")
    operator.page.press("#tool-z", "Enter")
    operator.wait_for("Math.abs(status.tool.z - 120) < 0.2")
    grip = operator.status["goals"][-1]
    operator.page.click("#gripper-open")
    operator.wait_for(
        f"status.goals.at(-1) > {grip + 2} && items.some(({{ style }}) => style === 'ghost')"
    )
    assert operator.served.goals() == before


@pytest.mark.campaign
def test_short_click_on_gripper_button_opens_it_a_little(live):
    before = tick_of(live, "gripper")
    live.page.click("#gripper-open")
    until(lambda: abs(tick_of(live, "gripper") - before) > 30)


@pytest.mark.campaign
def test_typed_tool_height_moves_tip_to_that_height(live):
    goal_m = live.served.tip_m() + np.array([0.0, 0.0, 0.03])
    live.page.fill("#tool-z", f"{1000 * goal_m[2]:.1f}")
    live.page.press("#tool-z", "Enter")
    live.until_near(live.served.tip_m, goal_m, 3.0)


def test_torque_switch_needs_two_presses_only_for_off(operator):
    switch = row(operator, "gripper").get_by_role("switch")
    own = servo_id("so101", "gripper")

    def torque():
        return registers(operator.served.arm, "torque_enable")

    switch.click()
    assert switch.inner_text() == "The joint may fall. Sure?"
    assert all(torque().values())
    switch.click()
    until(lambda: not torque()[own])
    assert all(on for i, on in torque().items() if i != own)
    operator.wait_for("status.health.joints.at(-1).torque === 'off'")
    switch.click()
    until(lambda: all(torque().values()))


def test_watching_page_has_no_enabled_joint_controls(operator, visit):
    other = visit()
    enabled = other.page.locator(".panel :is(input, .step, .torque):enabled")
    other.wait_for("status.controller === 'other'")
    assert enabled.count() == 0
