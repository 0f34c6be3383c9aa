"""Gestures on the page, judged by the resulting positions of the servos."""

import numpy as np
import pytest

from tests.arm.simulated import servo_id
from tests.browser.page_operator import apart_mm, until

pytestmark = pytest.mark.browser

# Servos of this class stand within two ticks; a pixel is about a millimetre.
NEAR_MM = 3.0
ASIDE = np.array([60.0, -60.0])  # over nothing, within reach


def aside(operator, move_px):
    """Return the expected tip (3,) after a move in the picture: the side view shows x and z."""
    along = np.array([move_px[0], 0.0, -move_px[1]]) / operator.pixels_per_metre
    return operator.served.tip_m() + along


def test_browser_click_in_live_mode_moves_tip_to_that_point(live):
    goal_m = aside(live, ASIDE)
    live.click(live.tip_px() + ASIDE).until_near(live.served.tip_m, goal_m, NEAR_MM)


@pytest.mark.campaign
def test_browser_click_in_preview_mode_moves_nothing(operator):
    before = operator.served.goals()
    operator.click(operator.tip_px() + ASIDE).wait_for(
        "items.some(({ style }) => style === 'ghost')"
    )
    operator.until_still()
    assert operator.served.goals() == before


def test_chosen_solver_and_preferred_posture_apply_to_a_drag(operator):
    operator.open_solver().page.click("#solvers button[value=ccd]")
    operator.wait_for("status.solver.name === 'ccd'")
    operator.drag(operator.tip_px(), ASIDE / 2).wait_for(
        "status.solver.text.startsWith('ccd: 0.0 mm')"
    )
    operator.release()
    operator.page.click("#preference summary")
    operator.page.click("#preferred button[value=rest]")
    operator.wait_for("status.preference.pose === 'rest' && status.preference.note")
    operator.page.get_by_label("Weight of the preferred posture for elbow_flex").fill("0.3")
    operator.wait_for("status.preference.weights.elbow_flex === 0.3")
    operator.page.click("#solvers button[value=auto]")
    operator.page.click("#preferred button[value=none]")
    operator.wait_for("status.solver.name === 'auto' && status.preference.pose === 'none'")
    assert operator.errors == []


def test_link_behind_another_is_chosen_by_key_and_second_click(operator):
    operator.page.mouse.move(*operator.over(operator.hub_px("elbow_flex")))
    operator.wait_for("status.under.length > 2 && status.under[0].chosen")
    first = operator.page.evaluate("window.ikservo.scene.hover")
    operator.page.keyboard.press("n")
    operator.wait_for(f"status.under[1].chosen && scene.hover !== '{first}'")
    assert operator.page.inner_text("#under .chosen").startswith(
        operator.status["under"][1]["name"]
    )
    operator.page.keyboard.press("Shift+N")
    operator.wait_for("status.under[0].chosen")
    operator.click(operator.hub_px("elbow_flex"))
    operator.wait_for("status.under[1].chosen")
    assert operator.errors == []


@pytest.mark.campaign
def test_enabling_live_mode_after_preview_moves_nothing(operator):
    before = operator.served.ticks()
    operator.click(operator.tip_px() + ASIDE).wait_for("status.tip.length > 1")
    operator.enable_live().until_still()
    assert max(abs(operator.served.ticks()[i] - before[i]) for i in before) <= 2


def test_grabbed_elbow_follows_the_pointer(live):
    before, move = live.served.place_m("wrist_flex"), np.array([30.0, 25.0])
    scale = live.pixels_per_metre
    goal_m = before + np.array([move[0], 0.0, -move[1]]) / scale
    live.drag(live.hub_px("wrist_flex"), move)
    live.until_near(lambda: live.served.place_m("wrist_flex"), goal_m, NEAR_MM).release()


@pytest.mark.campaign
def test_dragging_link_keeps_joints_beyond_it(live):
    before = live.served.ticks()
    live.drag(live.hub_px("wrist_flex"), np.array([25.0, 20.0])).until_still().release()
    assert max(abs(live.served.ticks()[i] - before[i]) for i in (5, 6)) <= 1


def test_drag_out_of_reach_ends_at_workspace_border(live):
    goals = []
    live.drag(live.tip_px(), np.array([420.0, -150.0]), steps=20)
    for _ in range(20):
        goals.append(live.served.joints())
        live.page.wait_for_timeout(30)
    live.until_still()
    assert live.items("target_far")
    nearest = live.served.tip_m()
    live.release().wait_for("status.messages.some((m) => m.message.includes('cannot be reached'))")
    assert apart_mm(live.served.tip_m(), nearest) < NEAR_MM
    chain = live.served.arm.chain
    for joints in goals:
        q = np.array([joints[name] for name in chain.names])
        assert (q >= chain.lower_rad - 2e-3).all()
        assert (q <= chain.upper_rad + 2e-3).all()


@pytest.mark.campaign
def test_shift_drag_turns_one_joint_only(live):
    before = live.served.ticks()
    live.page.keyboard.down("Shift")
    live.drag((live.hub_px("elbow_flex") + live.hub_px("wrist_flex")) / 2, np.array([0.0, 40.0]))
    live.page.keyboard.up("Shift")
    live.release().until_still()
    moved = [
        i for i, tick in live.served.ticks().items() if abs(tick - before[i]) > 40
    ]  # others lift their load: 26
    assert moved == [servo_id("so101", "elbow_flex")]


@pytest.mark.campaign
def test_mouse_wheel_notch_in_browser_turns_joint_by_1_degree(live):
    before = live.served.ticks()
    live.page.mouse.move(*live.over(live.hub_px("elbow_flex")))
    live.page.mouse.wheel(0, -500)
    live.until_moving().until_still()
    turned = (live.served.ticks()[3] - before[3]) * 360 / 4096
    assert abs(abs(turned) - 5.0) < 0.3


@pytest.mark.parametrize(
    ("key", "way_mm"),
    [
        ("ArrowUp", (0, 0, 20)),
        pytest.param("ArrowRight", (20, 0, 0), marks=pytest.mark.campaign),
        pytest.param("Alt+ArrowDown", (0, 0, -4), marks=pytest.mark.campaign),
    ],
)
def test_arrow_keys_move_the_tip(live, key, way_mm):
    goal_m = live.served.tip_m() + np.array(way_mm) / 1000
    live.page.focus("#drawing")
    for _ in range(4):
        live.page.keyboard.press(key)
    live.until_near(live.served.tip_m, goal_m, NEAR_MM)


def test_finger_tap_moves_tip_to_tapped_point(visit):
    operator = visit(has_touch=True).enable_live().until_still()
    move = np.array([-50.0, -40.0])
    goal_m = aside(operator, move)
    operator.page.touchscreen.tap(*operator.over(operator.tip_px() + move))
    operator.until_near(operator.served.tip_m, goal_m, NEAR_MM)


@pytest.mark.campaign
def test_click_after_resize_on_high_dpi_screen_is_exact(visit):
    operator = visit(device_scale_factor=2)
    operator.page.set_viewport_size({"width": 800, "height": 900})
    operator.wait_for_picture()
    operator.enable_live().until_still()
    goal_m = aside(operator, ASIDE)
    operator.click(operator.tip_px() + ASIDE).until_near(operator.served.tip_m, goal_m, NEAR_MM)
    assert operator.page.evaluate("drawing.width / drawing.clientWidth") == 2


@pytest.mark.campaign
def test_pose_button_moves_every_joint_to_the_pose(live):
    live.page.click("#poses >> text=Rest")
    live.until_moving().until_still()
    goal_rad = live.served.arm.model.pose("rest")
    chain = live.served.arm.chain
    for name, low, high in zip(chain.names, chain.lower_rad, chain.upper_rad, strict=True):
        off_rad = live.served.joints()[name] - min(max(goal_rad[name], low), high)
        assert abs(off_rad) < 7e-3  # a joint at rest within 4.5 ticks is left there


PAD = """
const pad = { id: "a pad", connected: true, axes: [0, 0, 0, 0], buttons: [] };
navigator.getGamepads = () => [pad];
window.push = (axes) => { pad.axes = axes; };
0;
"""


@pytest.mark.campaign
def test_gamepad_stick_moves_the_tip_while_held(visit):
    operator = visit()
    operator.page.evaluate(PAD)
    operator.enable_live().until_still()
    before = operator.served.tip_m()
    operator.page.evaluate("push([0, -1, 0, 0])")
    until(lambda: operator.served.tip_m()[2] - before[2] > 0.01)
    operator.page.evaluate("push([0, 0, 0, 0])")
    operator.until_still()
    rise = operator.served.tip_m() - before
    assert abs(rise[0]) < 0.004


@pytest.mark.campaign
def test_held_gripper_button_moves_gripper_until_released(live):
    before = live.served.ticks()
    live.page.hover("#gripper-open")
    live.page.mouse.down()
    live.until_moving()
    live.release().until_still()
    moved = [i for i, tick in live.served.ticks().items() if abs(tick - before[i]) > 20]
    assert moved == [servo_id("so101", "gripper")]


LISTEN = """
window.sentPhases = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  sentPhases.push(JSON.parse(text).phase);
  send.call(this, text);
};
0;
"""


MOVE_ON = """() => {
  const canvas = document.getElementById("drawing");
  const { x, y } = canvas.getBoundingClientRect();
  const send = WebSocket.prototype.send;
  window.confirmedBy = {};
  let seen = 0;
  WebSocket.prototype.send = function (text) {
    const message = JSON.parse(text);
    if (message.seen !== seen) confirmedBy[message.kind] = (confirmedBy[message.kind] ?? 0) + 1;
    seen = message.seen;
    send.call(this, text);
  };
  const move = (now) => {
    canvas.dispatchEvent(new PointerEvent("pointermove", {
      pointerId: 1, clientX: x + 400 + 50 * Math.sin(now / 300), clientY: y + 300,
    }));
    requestAnimationFrame(move);
  };
  requestAnimationFrame(move);
}"""


def test_pointer_messages_acknowledge_frames_without_heartbeat(operator):
    operator.page.evaluate(MOVE_ON)
    operator.until("(confirmedBy.pointer ?? 0) > 60")
    assert operator.page.evaluate("confirmedBy.heartbeat ?? 0") <= 2  # before the first move


@pytest.mark.campaign
def test_two_finger_pinch_zooms_and_moves_nothing(visit):
    operator = visit(has_touch=True)
    scale, goals = operator.pixels_per_metre, operator.served.goals()
    operator.page.evaluate(LISTEN)
    hand = operator.page.context.new_cdp_session(operator.page)
    middle = np.array(operator.over((400, 150)))
    for phase, half_px, count in [
        ("touchStart", 40, 1),
        ("touchStart", 40, 2),
        ("touchMove", 80, 2),
    ]:
        places = [middle - half_px, middle + half_px][:count]
        fingers = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(places)]
        hand.send("Input.dispatchTouchEvent", {"type": phase, "touchPoints": fingers})
    hand.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    until(lambda: operator.pixels_per_metre == pytest.approx(2 * scale, rel=0.3))
    assert "down" not in operator.page.evaluate("sentPhases")  # not even by the first of them
    assert operator.served.goals() == goals


@pytest.mark.campaign
@pytest.mark.parametrize("view", [{"arm": "planar3", "port": "sim"}], indirect=True)
@pytest.mark.parametrize("solver", ["ccd", "pseudo_inverse"])
def test_chosen_solver_iterations_are_shown_on_page(operator, solver):
    operator.open_solver().page.click(f"#solvers button[value={solver}]")
    operator.wait_for(f"status.solver.name === '{solver}'")
    operator.click(operator.tip_px() + 2 * ASIDE)
    operator.wait_for("status.solver.text.includes('iteration')")
    operator.wait_for("items.some((item) => item.style === 'iterate')")


@pytest.mark.campaign
def test_page_runs_without_script_errors(live):
    live.page.click("#views button[value=orbit]")
    live.page.click("#views button[value=top]")
    live.click(live.tip_px())
    assert live.errors == []
