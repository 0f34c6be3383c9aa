"""The orbit view in 3D: the scene graph is where the arm is, and the picture shows it there."""

import io

import numpy as np
import pytest
from PIL import Image

from ikservo.view.draw_items import link_poses
from tests.browser.page_operator import Operator

pytestmark = pytest.mark.browser

SCENE = "window.ikservo.rendering.scene3d"
DRAWN_IN_3D = (
    f"{SCENE} && scene.webgl && scene.measured && !document.getElementById('webgl').hidden"
)
NO_WEBGL = """() => {
  const open = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : open.call(this, kind, ...more);
  };
}"""


def orbiting(page, served):
    """Return an operator who has chosen the orbit view, in 3D however slow it is."""
    operator = Operator(page, served, options="&draw=3d")
    operator.page.click("#views button[value=orbit]")
    operator.wait_for(DRAWN_IN_3D)
    return operator


@pytest.fixture(scope="module")
def page_in_3d(webgl_browser, shared):
    context = webgl_browser.new_context(viewport={"width": 900, "height": 640})
    yield orbiting(context.new_page(), shared.brought_home())
    context.close()


@pytest.fixture
def onlooker(page_in_3d):
    """A person before the arm in 3D, without a goal and with the pointer elsewhere."""
    page_in_3d.page.click("#stop")
    page_in_3d.page.click("#acknowledge")
    return page_in_3d.wait_for("status.mode === 'preview' && !scene.goal && !scene.hover")


def camera_of(served):
    """Return the camera with which the server picks for the only client."""
    controller = served.view.controller
    (client,) = controller._clients.values()
    return controller._composer.camera(client)


def poses_of(served, joints):
    """Return T_world_link of every link at joints (n,), by the server's forward kinematics."""
    index = served.arm.joint_index
    return link_poses(served.arm.chain, index.chain_joints(joints), index.by_name(joints))


def assert_placed(operator, tree, joints):
    expected = poses_of(operator.served, joints)
    drawn = operator.page.evaluate(f"{SCENE}.poses({SCENE}.{tree})")
    assert set(drawn) == set(expected)
    for link, T in expected.items():
        assert np.abs(np.reshape(drawn[link], (4, 4)) - T).max() < 1e-6, link


def still_joints(operator):
    """Return the measured joints (n,) once the page has drawn them."""
    operator.until_still()
    snapshot = operator.served.view.arm_thread.snapshot
    operator.page.wait_for_timeout(200)
    return snapshot.measured


def picture(operator):
    shot = operator.page.locator("#webgl").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def test_every_link_of_arm_and_ghost_is_where_forward_kinematics_puts_it(onlooker):
    assert_placed(onlooker, "arm", still_joints(onlooker))
    onlooker.drag(onlooker.tip_px(), np.array([70.0, -50.0])).release()
    onlooker.wait_for("scene.goal && !status.refused")
    onlooker.page.wait_for_timeout(200)
    assert_placed(onlooker, "ghost", onlooker.served.view.controller._interaction.goal)
    assert onlooker.errors == []


def test_the_arm_is_seen_in_its_colour_where_the_server_picks_it_and_nowhere_else(onlooker):
    served = onlooker.served
    poses, camera = poses_of(served, still_joints(onlooker)), camera_of(served)
    middle = poses["upper_arm"] @ np.array([-0.0514, 0.002, 0.0183, 1.0])  # of its beam
    seen = picture(onlooker)
    x, y = np.rint(camera.project(middle[:3])[0]).astype(int)
    r, g, b = seen[y, x]
    assert r > g > b + 60  # the yellow of its URDF, in the light
    r, g, b = seen[60, 400]
    assert max(r, g, b) - min(r, g, b) < 12  # the wall behind is grey
    onlooker.page.mouse.move(*onlooker.over((float(x), float(y))))
    onlooker.wait_for("scene.hover === 'upper_arm'")


def test_a_drag_takes_the_tip_to_the_pointer(onlooker):
    start = onlooker.tip_px()
    onlooker.drag(start, np.array([40.0, -60.0])).release()
    x, y = start + np.array([40.0, -60.0])
    onlooker.wait_for(
        "scene.items.some(({ style, at }) => style === 'target'"
        f" && Math.abs(at[0] - {x}) < 1 && Math.abs(at[1] - {y}) < 1)"
    )
    assert onlooker.page.evaluate(f"{SCENE}.markings.dots.count") > 0  # the way of the tip


def test_a_ghost_that_would_touch_something_turns_red_and_the_pair_is_named(onlooker):
    onlooker.page.fill("#tool-z", "-40")
    onlooker.page.keyboard.press("Enter")
    onlooker.wait_for("scene.refused_pair?.includes('gripper')")
    onlooker.page.wait_for_timeout(100)
    style = (
        f"(link) => Object.entries({SCENE}.ghostMaterials)"
        f".find(([, each]) => each === {SCENE}.ghost.parts.get(link)[0].material)[0]"
    )
    assert onlooker.page.evaluate(style, "gripper") == "touching"
    assert onlooker.page.evaluate(style, "upper_arm") == "refused"
    r, g, b = onlooker.page.evaluate(f"{SCENE}.ghostMaterials.touching.color.toArray()")
    assert r > 3 * max(g, b)
    assert "gripper would touch the floor" in onlooker.page.inner_text("#refusal")


def test_frames_too_slow_fall_back_to_the_canvas_and_the_switch_returns_to_3d(onlooker):
    onlooker.page.evaluate(
        f"""() => {{
          const {{ rendering }} = window.ikservo;
          window.timeFrame = {SCENE}.timeFrame;
          {SCENE}.timeFrame = async () => 120;
          rendering.wanted = null;
          return rendering.timeFrames({SCENE});
        }}"""
    )
    onlooker.wait_for("!scene.webgl && scene.items.some((item) => item.style === 'measured')")
    assert onlooker.page.inner_text("#render-note") == "3D takes 120 ms a frame here: drawn in 2D."
    assert onlooker.page.get_attribute("#render-3d", "aria-checked") == "false"
    assert onlooker.page.is_hidden("#webgl")
    onlooker.page.click("#render-3d")
    onlooker.wait_for(DRAWN_IN_3D)
    assert onlooker.page.inner_text("#render-note") == ""


def test_without_webgl_the_canvas_draws_the_orbit_view(browser, shared):
    context = browser.new_context(viewport={"width": 900, "height": 640})
    operator = Operator(context.new_page(), shared)
    operator.page.evaluate(NO_WEBGL)
    operator.page.click("#views button[value=orbit]")
    operator.until("document.getElementById('render-note').textContent")
    assert operator.page.inner_text("#render-note") == "This browser has no WebGL: drawn in 2D."
    operator.wait_for("!scene.webgl && scene.items.some((item) => item.style === 'measured')")
    assert not operator.page.is_hidden("#backdrop")
    operator.page.click("#render-3d")
    operator.until("document.getElementById('render-note').textContent")
    operator.wait_for("!scene.webgl && scene.items.some((item) => item.style === 'measured')")
    context.close()
