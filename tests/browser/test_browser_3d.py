"""The orbit view in 3D: the scene graph and its picture agree with the arm's position."""

import io
import itertools

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from ikservo.apps.page.picking.link_poses import link_poses
from tests.browser.page_operator import Operator, until

pytestmark = pytest.mark.browser

SMALL = {"width": 480, "height": 700}  # each pixel of software WebGL takes time
SCENE = "window.ikservo.rendering.scene3d"
DRAWN_IN_3D = (
    f"{SCENE} && scene.webgl && scene.measured && !document.getElementById('webgl').hidden"
)
A_CARD = """() => {
  // 37446 is UNMASKED_RENDERER_WEBGL
  const { getParameter } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.getParameter = function (name) {
    return name === 37446 ? "A graphics card" : getParameter.call(this, name);
  };
}"""
NO_WEBGL = """() => {
  const open = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : open.call(this, kind, ...more);
  };
}"""


def orbiting(page, served):
    """Return an operator who has chosen the orbit view in 3D, even if it is slow."""
    operator = Operator(page, served, options="&draw=3d")
    operator.page.click("#views button[value=orbit]")
    operator.wait_for(DRAWN_IN_3D)
    return operator


@pytest.fixture(scope="module")
def page_in_3d(webgl_browser, shared):
    context = webgl_browser.new_context(viewport=SMALL)
    context.add_init_script(f"({A_CARD})()")
    yield orbiting(context.new_page(), shared.brought_home())
    context.close()


@pytest.fixture
def onlooker(page_in_3d):
    """Return a person in front of the arm in 3D, at the top of the page and without a goal."""
    page_in_3d.served.view.controller._interaction.reset()
    page_in_3d.page.evaluate("scrollTo(0, 0)")
    return page_in_3d.wait_for(f"{DRAWN_IN_3D} && !scene.goal")


def camera_of(served):
    """Return the camera by which the server picks for the only client."""
    controller = served.view.controller
    (client,) = controller._clients.values()
    return controller._composer.camera(client)


def poses_of(served, joints):
    """Return T_world_link of every link at joints (n,), by the server's forward kinematics."""
    index = served.arm.joint_index
    return link_poses(served.arm.chain, index.chain_joints(joints), index.by_name(joints))


def misplaced(operator, tree, joints):
    """Return the links whose drawn pose differs from forward kinematics."""
    expected = poses_of(operator.served, joints)
    drawn = operator.page.evaluate(f"{SCENE}.poses({SCENE}.{tree})")
    assert set(drawn) == set(expected)
    return [
        link
        for link, T in expected.items()
        if np.abs(np.reshape(drawn[link], (4, 4)) - T).max() >= 1e-6
    ]


def measured(operator):
    return operator.served.view.arm_thread.snapshot.measured


def goal(operator):
    return operator.served.view.controller._interaction.goal


def picture(operator):
    shot = operator.page.locator("#webgl").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def test_3d_links_of_arm_and_preview_match_forward_kinematics(onlooker):
    until(lambda: not misplaced(onlooker, "arm", measured(onlooker)))
    onlooker.drag(onlooker.tip_px(), np.array([50.0, -50.0])).release()
    onlooker.wait_for("scene.goal && !status.refused")
    until(lambda: not misplaced(onlooker, "ghost", goal(onlooker)))
    assert onlooker.errors == []


def test_3d_arm_covers_pixels_at_which_it_is_picked(onlooker):
    served = onlooker.served
    until(lambda: not misplaced(onlooker, "arm", measured(onlooker)))
    poses, camera = poses_of(served, measured(onlooker)), camera_of(served)
    middle = poses["upper_arm"] @ np.array([-0.0514, 0.002, 0.0183, 1.0])  # of its beam
    seen = picture(onlooker)
    x, y = np.rint(camera.project(middle[:3])[0]).astype(int)
    r, g, b = seen[y, x]
    assert r > g > b + 60  # the yellow of its URDF, in the light
    r, g, b = np.median(seen[150:250, 10:60].reshape(-1, 3), axis=0)
    assert max(r, g, b) - min(r, g, b) < 16  # the table behind is grey
    onlooker.page.mouse.move(*onlooker.over((float(x), float(y))))
    onlooker.wait_for("scene.hover === 'upper_arm'")


@pytest.mark.smoke
def test_drag_in_3d_view_moves_target_to_pointer(onlooker):
    start = onlooker.tip_px()
    x, y = start + np.array([40.0, -60.0])
    onlooker.drag(start, np.array([40.0, -60.0]), steps=2)
    onlooker.wait_for(
        "items.some(({ style, at }) => style === 'target'"
        f" && Math.abs(at[0] - {x}) < 1 && Math.abs(at[1] - {y}) < 1)"
    ).release()
    onlooker.until(f"{SCENE}.markings.dots.count > 0")  # the path of the tip


def test_3d_preview_in_collision_is_red_and_links_are_named(onlooker):
    onlooker.type("#tool-z", "-40", "scene.refused_pair?.includes('gripper')")
    style = (
        f"(link) => Object.entries({SCENE}.ghostMaterials)"
        f".find(([, each]) => each === {SCENE}.ghost.parts.get(link)[0].material)[0]"
    )
    assert onlooker.page.evaluate(style, "gripper") == "touching"
    assert onlooker.page.evaluate(style, "upper_arm") == "refused"
    r, g, b = onlooker.page.evaluate(f"{SCENE}.ghostMaterials.touching.color.toArray()")
    assert r > 3 * max(g, b)
    expect(onlooker.page.locator("#refusal")).to_contain_text("gripper would touch the table")


HANDLE_PX = """([kind, axis]) => {
  const { handles } = window.ikservo.rendering.scene3d;
  const box = document.getElementById("drawing").getBoundingClientRect();
  const hits = (x, y) => { handles.hover({ x, y }); return handles[kind].axis === axis; };
  for (let y = 0.95; y > -0.95; y -= 0.01) for (let x = -0.95; x < 0.95; x += 0.01) {
    if (!hits(x, y) || !hits(x + 0.02, y - 0.01)) continue;
    handles.leave();
    return [box.x + (x + 1.01) / 2 * box.width, box.y + (1.005 - y) / 2 * box.height];
  }
}"""


MOVES = 100


def press_until_received(onlooker, x, y):
    """Press at a pixel until the server accepts it: it ignores presses on an old picture.

    On a busy machine, software WebGL takes a second per frame, so that most presses are too late.
    """
    drag = onlooker.served.view.controller._interaction._tool_drag
    for _ in range(10):
        onlooker.page.mouse.move(x, y)
        onlooker.page.mouse.down()
        for _ in range(20):
            onlooker.page.wait_for_timeout(50)
            if drag.is_busy:
                return
        onlooker.page.mouse.up()
    raise AssertionError("no press was heard")


@pytest.mark.campaign  # wants quick frames; tests/apps/page/test_tool_handles.py without a browser
@pytest.mark.parametrize(("kind", "axis", "moved"), [("arrows", "Z", "z"), ("rings", "Y", "pitch")])
def test_3d_handle_changes_one_target_coordinate_only(onlooker, kind, axis, moved):
    page, ticks = onlooker.page, onlooker.served.goals()
    if page.get_attribute("#handles", "aria-checked") == "false":
        page.click("#handles")
    onlooker.wait_for("scene.handles && !scene.goal")
    before = onlooker.status["tool"]
    x, y = page.evaluate(HANDLE_PX, [kind, axis])
    press_until_received(onlooker, x, y)
    shifted = f"Math.abs(window.ikservo.status.tool.{moved} - {before[moved]}) > 5"
    for wobble in itertools.islice(itertools.cycle((0, 1)), MOVES):
        page.mouse.move(x + 12, y - 24 - wobble, steps=3)
        if page.evaluate(shifted):
            break
    assert page.evaluate(shifted)
    page.mouse.up()
    after = onlooker.status["tool"]
    for name in {"x", "y", "z", "pitch"} - {moved}:
        assert after[name] == pytest.approx(before[name], abs=0.6), name
    assert onlooker.served.goals() == ticks  # a preview
    page.click("#handles")
    onlooker.wait_for("!scene.handles")
    assert page.evaluate(f"{SCENE}.handles.root.visible") is False
    assert onlooker.errors == []


def test_slow_3d_view_falls_back_to_canvas_until_3d_is_chosen(onlooker):
    onlooker.page.evaluate(
        f"""() => {{
          const {{ rendering }} = window.ikservo;
          window.timeFrame = {SCENE}.timeFrame;
          {SCENE}.timeFrame = async () => 120;
          rendering.wanted = null;
          return rendering.timeFrames({SCENE});
        }}"""
    )
    onlooker.wait_for("!scene.webgl && items.some((item) => item.style === 'measured')")
    note = onlooker.page.inner_text("#render-note")
    assert note == "A 3D frame takes 120 ms here, so the view is 2D."
    expect(onlooker.page.locator("#render-3d")).to_have_attribute("aria-checked", "false")
    expect(onlooker.page.locator("#webgl")).to_be_hidden()
    onlooker.page.click("#render-3d")
    onlooker.wait_for(DRAWN_IN_3D)
    expect(onlooker.page.locator("#render-note")).to_have_text("")


def test_lost_webgl_context_falls_back_to_canvas_until_restored(onlooker):
    onlooker.page.evaluate("window.ikservo.rendering.renderer.forceContextLoss()")
    onlooker.wait_for("!scene.webgl && items.some((item) => item.style === 'measured')")
    gave_up = "The graphics driver failed, so the view is 2D."
    expect(onlooker.page.locator("#render-note")).to_have_text(gave_up)
    onlooker.page.click("#render-3d")
    expect(onlooker.page.locator("#render-note")).to_have_text(gave_up)
    onlooker.page.evaluate("window.ikservo.rendering.renderer.forceContextRestore()")
    onlooker.until("!window.ikservo.rendering.renderer.getContext().isContextLost()")
    onlooker.page.click("#render-3d")
    onlooker.wait_for(DRAWN_IN_3D)


@pytest.fixture
def page_without_webgl(browser, view):
    context = browser.new_context(viewport=SMALL)
    context.add_init_script(f"({NO_WEBGL})()")
    yield Operator(context.new_page(), view, options="")
    context.close()


OWN_VIEW = pytest.mark.parametrize("view", [{}], indirect=True)  # others control the shared one


@OWN_VIEW
def test_page_starts_in_3d_drawn_by_cpu_without_webgl(page_without_webgl):
    operator = page_without_webgl
    assert chosen_view(operator.page) == "orbit"
    operator.wait_for(DRAWN_IN_3D)
    assert operator.page.inner_text("#render-note") == ""
    middle = poses_of(operator.served, measured(operator))["upper_arm"]
    beam = camera_of(operator.served).project((middle @ [-0.0514, 0.002, 0.0183, 1.0])[:3])[0]
    x, y = np.rint(beam).astype(int)
    r, g, b = picture(operator)[y, x]
    assert r > g > b + 60  # the yellow of its URDF, in the light
    operator.page.click("#render-3d")
    operator.wait_for("!scene.webgl && items.some((item) => item.style === 'measured')")
    expect(operator.page.locator("#webgl")).to_be_hidden()
    assert operator.errors == []


SLOWER = """() => {
  const { frameTime } = window.ikservo;
  frameTime.slowMs = 120;
  frameTime.set(frameTime.level + 1);
}"""


@OWN_VIEW
def test_drawing_by_cpu_becomes_coarse_and_then_flat_if_slow(page_without_webgl):
    operator = page_without_webgl.wait_for(DRAWN_IN_3D)
    page = operator.until("window.ikservo.rendering.tried").page
    page.evaluate("window.ikservo.rendering.frameMs = 5")  # as on a quick computer
    page.evaluate("window.ikservo.frameTime.set(0)")
    operator.until("2 * webgl.clientWidth === webgl.width")
    widths = [page.evaluate("document.getElementById('webgl').width")]
    for slow in range(3):
        page.evaluate(SLOWER)
        operator.wait_for("!scene.webgl" if slow == 2 else DRAWN_IN_3D)
        until(
            lambda: (
                page.evaluate("document.getElementById('webgl').width") != widths[-1]
                or page.is_hidden("#webgl")
            )
        )
        widths.append(page.evaluate("document.getElementById('webgl').width"))
    assert widths[0] == 2 * widths[1] == 4 * widths[2]
    assert page.inner_text("#render-note") == "A 3D frame takes 120 ms here, so the view is 2D."


@OWN_VIEW
def test_drawing_by_cpu_agrees_with_webgl_picture(webgl_browser, view):
    """Compare arm, preview, path, table and shadow with those that WebGL draws."""
    pictures = []
    for script in (A_CARD, NO_WEBGL):
        context = webgl_browser.new_context(viewport=SMALL)
        context.add_init_script(f"({script})()")
        operator = orbiting(context.new_page(), view)
        operator.type("#tool-z", "200", "scene.goal")
        operator.wait_for(DRAWN_IN_3D)
        operator.page.wait_for_timeout(1000)
        pictures.append(picture(operator))
        operator.served.view.controller._interaction.reset()
        context.close()
    differences = np.abs(pictures[0] - pictures[1]).max(axis=2)
    assert np.median(differences) <= 2
    assert np.mean(differences > 60) < 0.004


def chosen_view(page):
    return page.get_attribute("#views [aria-checked=true]", "value")


def test_page_starts_in_3d_with_hardware_webgl(webgl_browser, shared):
    context = webgl_browser.new_context(viewport=SMALL)
    context.add_init_script(f"({A_CARD})()")
    operator = Operator(context.new_page(), shared, options="")
    operator.until("window.ikservo.rendering.frameMs")  # it was drawn in 3D, and timed
    operator.wait_for(
        "document.querySelector('#views [aria-checked=true]').value"
        " === (window.ikservo.rendering.reason ? 'side' : 'orbit')"
    )
    context.close()


def test_page_starts_in_3d_drawn_by_cpu_with_software_webgl(webgl_browser, shared):
    context = webgl_browser.new_context(viewport=SMALL)
    operator = Operator(context.new_page(), shared, options="")
    assert chosen_view(operator.page) == "orbit"
    operator.wait_for(DRAWN_IN_3D)
    assert operator.page.evaluate("window.ikservo.rendering.hasCard") is False
    context.close()


@OWN_VIEW
def test_switch_to_3d_view_waits_until_live_mode_ends(webgl_browser, view):
    context = webgl_browser.new_context(viewport=SMALL)
    operator = Operator(context.new_page(), view, options="&draw=2d")
    operator.enable_live().page.click("#views button[value=orbit]")
    operator.page.click("#render-3d")
    operator.until("document.getElementById('render-note').textContent")
    note = operator.page.inner_text("#render-note")
    assert note == "3D begins once Live is off, so the view is 2D."
    assert operator.page.evaluate("window.ikservo.rendering.module") is None
    operator.page.click("#live")
    operator.wait_for(DRAWN_IN_3D)
    expect(operator.page.locator("#live")).to_be_disabled()
    context.close()
