"""Pictures of a simulated camera: the arm, its table, a board and cubes, drawn by MuJoCo."""

import sys

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

import servosim  # noqa: E402
from ikservo.apps.cameras.board import Board  # noqa: E402
from ikservo.apps.cameras.board_detection import find_board  # noqa: E402
from ikservo.cli.camera_options import DEFAULT_BOARD  # noqa: E402
from servosim.camera import SimulatedCamera, SimulatedView  # noqa: E402
from servosim.errors import SimulatorError  # noqa: E402
from tests.oracle import CONFIGS  # noqa: E402

BOARD = Board.named(DEFAULT_BOARD)
CUBES = "physics=1&cubes=red@0.24,-0.06;blue@0.2,0.09"


def open_port(options="", name="so101"):
    return servosim.open_port(f"sim:{CONFIGS}/{name}/arm.toml?pose=home&{options}")


def open_camera(port):
    camera = servosim.open_camera(port, BOARD.opencv())
    if camera.hint:
        pytest.skip(camera.hint)
    return camera


def seen_at(picture, channel):
    """Return the centre of the pixels of a colour (0 blue, 1 green, 2 red)."""
    others = np.delete(picture, channel, axis=2).max(axis=2).astype(int)
    v, u = np.nonzero(picture[..., channel] > 2 * others + 30)
    return np.array([u.mean(), v.mean()])


def outline(camera, T):
    """Return the centre of a cube's outline, through the camera's lens."""
    half = 0.0175 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.array([camera.pixel(T[:3, :3] @ each + T[:3, 3]) for each in half])
    hull = cv2.convexHull(corners.astype(np.float32))
    moments = cv2.moments(hull)
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


@pytest.mark.full
def test_simulated_camera_shows_cubes_and_board_in_place():
    port = open_port(CUBES)
    camera = open_camera(port)
    picture = camera.take()
    for T, channel in zip(port.line.world.cube_poses(), (2, 0), strict=True):
        np.testing.assert_allclose(seen_at(picture, channel), outline(camera, T), atol=1.5)
    view = find_board(BOARD, picture)
    assert len(view.ids) == 24
    T = camera.T_base_camera @ camera.T_camera_board()
    for corner, pixel in zip(BOARD.corners_m()[view.ids], view.pixels, strict=True):
        expected = camera.pixel(T[:3, :3] @ corner + T[:3, 3])
        np.testing.assert_allclose(pixel, expected, atol=0.4)


@pytest.mark.full
def test_simulated_arm_in_front_of_board_hides_corners():
    world = open_port().line.world
    camera = SimulatedCamera(world, BOARD.opencv(), SimulatedView(aside_m=0.03))
    assert len(find_board(BOARD, camera.take()).ids) > 20
    camera.set_stage()
    if camera.hint:
        pytest.skip(camera.hint)
    assert 8 <= len(find_board(BOARD, camera.take()).ids) < 20  # the moving jaw is before it


@pytest.mark.full
def test_simulated_picture_follows_moving_arm():
    port = open_port("board=0")
    camera = open_camera(port)
    before = camera.take().astype(int)
    port.line.world.place("shoulder_pan", 0.5)
    moved = np.abs(camera.take() - before).max(axis=2) > 60
    assert moved[:500].mean() > 0.02  # the arm
    assert moved[:, :200].mean() < 0.001  # the table far beside it


@pytest.mark.sample(5)
@pytest.mark.full
@pytest.mark.parametrize("name", sorted(path.name for path in CONFIGS.iterdir() if path.is_dir()))
def test_simulated_camera_draws_every_shipped_arm(name):
    camera = open_camera(open_port(name=name))
    assert camera.take().std() > 20.0


@pytest.mark.full
def test_simulated_camera_without_mujoco_shows_only_board(monkeypatch):
    monkeypatch.setitem(sys.modules, "servosim.stage", None)
    camera = servosim.open_camera(open_port(), BOARD.opencv())
    assert "extra physics" in camera.hint
    picture = camera.take()
    assert picture.ndim == 2
    assert len(find_board(BOARD, picture).ids) == 24


@pytest.mark.full
def test_simulated_camera_shows_board_if_mujoco_cannot_render(monkeypatch):
    stage = pytest.importorskip("servosim.stage")

    def fail(*_):
        raise SimulatorError("MuJoCo cannot draw here (no library)")

    monkeypatch.setattr(stage, "_open_context", fail)
    camera = servosim.open_camera(open_port(), BOARD.opencv())
    assert "cannot draw here (no library)" in camera.hint
    assert len(find_board(BOARD, camera.take()).ids) == 24


def test_simulated_cube_moves_when_pushed_and_other_stays():
    world = open_port("physics=1&cubes=red@0.22,0.07;green@0.1,-0.2").line.world
    start = world.cube_poses()
    for end_s, point_m in ((1.0, (0.22, 0.0, 0.03)), (2.5, (0.22, 0.1, 0.03))):
        world.lead_tip(point_m)
        world.advance_to(end_s)
    pushed, untouched = world.cube_poses()
    assert pushed[1, 3] - start[0][1, 3] > 0.02
    np.testing.assert_allclose(untouched[:3, 3], start[1][:3, 3], atol=1e-3)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("cubes=red@0.2,0", "add physics=1"),
        ("physics=1&cubes=red", "is not a cube; try red@"),
        ("physics=1&cubes=red@0.2", "is not a cube"),
        ("physics=1&cubes=red@0.2,0,0.05,1", "is not a cube"),
        ("physics=1&cubes=red@0.2,0,1", "edges of the red cube must be 0.005 to 0.2 m"),
        ("physics=1&cubes=red@0.2,0,nan", "edges of the red cube"),
        ("physics=1&cubes=pink@0.2,0", "no cube has the colour 'pink'; known: red"),
        ("physics=1&cubes=red@0.2,0;red@0.3,0", "only one red cube"),
        ("physics=1&cubes=red@nan,0", "within 2 m"),
        ("physics=1&cubes=red@5,0", "within 2 m"),
        ("board=off", "board=off is not a number"),
    ],
)
def test_invalid_sim_cubes_option_is_refused(options, why):
    with pytest.raises(SimulatorError, match=why):
        open_port(options)
