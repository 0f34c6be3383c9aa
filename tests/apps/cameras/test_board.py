import re
from types import SimpleNamespace

import numpy as np
import pytest

from ikservo.apps.cameras.board import Board
from ikservo.cli.camera_options import DEFAULT_BOARD
from ikservo.errors import BadValueError, CalibrationError, PictureError

cv2 = pytest.importorskip("cv2")

from ikservo.apps.cameras.board_detection import Intrinsics, board_pose, find_board  # noqa: E402
from ikservo.apps.cameras.camera_calibration import BoardPictures  # noqa: E402
from servosim import read_arm_file  # noqa: E402
from servosim.assembly import make_arm_world  # noqa: E402
from servosim.camera import SimulatedCamera  # noqa: E402
from tests.oracle import CONFIGS  # noqa: E402

BOARD = Board.named(DEFAULT_BOARD)
LENS = Intrinsics(
    np.array([[900.0, 0, 480], [0, 900.0, 360], [0, 0, 1]]),
    np.array([-0.12, 0.04, 0, 0, 0]),
    (960, 720),
)


@pytest.fixture
def camera():
    world = make_arm_world(read_arm_file(CONFIGS / "so101" / "arm.toml"), "home")
    return SimulatedCamera(world, BOARD.opencv())


def drawn(svg, pixels_per_mm=10):
    """Draw the rectangles of an SVG; return the picture."""
    width, height = map(float, re.search(r'viewBox="0 0 (\S+) (\S+)"', svg).groups())
    picture = np.full((round(height * pixels_per_mm), round(width * pixels_per_mm)), 255, np.uint8)
    for row in re.findall(r'<rect x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)"/>', svg):
        x, y, w, h = (float(each) * pixels_per_mm for each in row)
        picture[round(y) : round(y + h), round(x) : round(x + w)] = 0
    return picture


def test_board_name_encodes_its_size_and_markers():
    assert Board(5, 7, 0.012, "4x4") == BOARD
    assert Board.named("7x9-15.5mm-6x6").name == "7x9-15.5mm-6x6"


@pytest.mark.parametrize("name", ["", "5x7", "5x7-12mm-8x8", "2x7-12mm-4x4", "5x7-12mm-4x5",
                                  "5x7-0mm-4x4", "50x50-5mm-4x4", "5x7-12mm-4x4 "])  # fmt: skip
def test_invalid_board_name_is_refused(name):
    with pytest.raises(BadValueError, match="board"):
        Board.named(name)


@pytest.mark.parametrize("name", [DEFAULT_BOARD, "6x5-20mm-5x5"])
def test_printed_board_is_found_by_opencv(name):
    board = Board.named(name)
    view = find_board(board, drawn(board.svg()))
    assert len(view.ids) == (board.columns - 1) * (board.rows - 1)
    across = view.pixels - view.pixels.mean(axis=0)
    expected = (board.corners_m()[view.ids] * 10_000)[:, :2]
    np.testing.assert_allclose(across, expected - expected.mean(axis=0), atol=0.7)


def test_board_pdf_has_same_rectangles_as_svg():
    pdf, svg = BOARD.pdf().decode("ascii"), BOARD.svg()
    boxes = re.findall(r"^(\S+) \S+ (\S+) (\S+) re$", pdf, re.MULTILINE)
    drawn_svg = re.findall(r'<rect x="(\S+)" y="\S+" width="(\S+)" height="(\S+)"/>', svg)
    np.testing.assert_allclose(np.array(boxes, float), np.array(drawn_svg, float), atol=1e-3)
    start = int(re.search(r"startxref\n(\d+)", pdf).group(1))
    assert pdf[start:].startswith("xref")
    for number, at in enumerate(re.findall(r"^(\d{10}) 00000 n", pdf, re.MULTILINE), start=1):
        assert pdf[int(at) :].startswith(f"{number} 0 obj")


def test_simulated_camera_shows_board_at_its_pose(camera):
    found = board_pose(BOARD, find_board(BOARD, camera.take()), LENS)
    off = np.linalg.inv(camera.T_camera_board()) @ found
    assert np.abs(off[:3, 3]).max() < 2e-4
    np.testing.assert_allclose(off[:3, :3], np.eye(3), atol=3e-3)


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_simulated_camera_pose_does_not_depend_on_arm_pose(name):
    arm = read_arm_file(CONFIGS / name / "arm.toml")
    worlds = [make_arm_world(arm, pose) for pose in ("home", "rest")]
    cameras = [SimulatedCamera(world, BOARD.opencv()) for world in worlds]
    np.testing.assert_array_equal(cameras[0].T_base_camera, cameras[1].T_base_camera)
    assert all(len(find_board(BOARD, camera.take()).ids) > 20 for camera in cameras)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: np.ascontiguousarray(p[:, ::-1]), "is mirrored"),
        (lambda p: cv2.GaussianBlur(p, (0, 0), 9), "is blurred"),
        (lambda p: np.full_like(p, 120), "is not in the picture"),
        (lambda p: p[:, : p.shape[1] // 2 - 40], "too little of the board"),
    ],
)
def test_picture_without_usable_board_is_refused_with_reason(camera, spoil, message):
    with pytest.raises(CalibrationError, match=message):
        find_board(BOARD, spoil(camera.take()))


def test_picture_of_another_board_is_refused(camera):
    with pytest.raises(CalibrationError, match=r"a board other than 7x5"):
        find_board(Board.named("7x5-12mm-4x4"), camera.take())


def test_picture_of_another_size_than_the_first_is_refused(camera):
    pictures = BoardPictures(SimpleNamespace(bending=None), BOARD)
    picture = camera.take()
    pictures.add(picture, find_board(BOARD, picture), np.zeros(5))
    smaller = cv2.resize(picture, (768, 576))
    with pytest.raises(PictureError, match="768 x 576 pixels, the first one had 960 x 720"):
        pictures.add(smaller, find_board(BOARD, smaller), np.zeros(5))
    assert len(pictures) == 1
