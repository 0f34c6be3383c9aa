"""Each arm of a page shows its own camera, found by name, by source, or simulated."""

from contextlib import ExitStack

import pytest

import ikservo
from ikservo.apps.cameras.camera_file import SIMULATED, load_camera, save_camera
from ikservo.apps.page.messages.page_messages import BadMessageError
from ikservo.apps.page.page_app import ViewApp
from ikservo.apps.page.panels.camera_view import CameraView
from ikservo.apps.page.panels.page_cameras import ArmCameras, PageCameras
from ikservo.apps.page.served_arms import ArmAtPort
from ikservo.clock import RealClock
from ikservo.errors import CalibrationError, InputError, UnknownNameError
from ikservo.model import load_model

pytest.importorskip("cv2")

from servosim.camera import SimulatedCamera
from tests.apps.cameras.saved_camera import save_simulated_camera
from tests.apps.page.webcam import Webcam


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr(SimulatedCamera, "set_stage", lambda _: None)  # the board is enough


@pytest.fixture
def arm():
    """An arm that was calibrated with camera 1, and with camera 2 under the name ``left``."""
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        save_simulated_camera(arm, source="1")
        _, known = load_camera("so101", SIMULATED)
        x, y, z = known.camera.at_mm
        left = known.camera.model_copy(update={"at_mm": (x, y + 100.0, z), "source": "2"})
        save_camera("so101", SIMULATED, known.model_copy(update={"camera": left}), "left")
        yield arm


@pytest.mark.parametrize(
    ("sources", "name", "shown"),
    [
        (["0", "1"], "", "1"),
        (["0", "2"], "", "2"),
        (["0"], "", "0"),  # a picture, and no view
        ([], "left", "2"),
        (["0", "2"], "left", "2"),
        (["7"], "left", "7"),  # it has another number today
        ([], "", None),
    ],
)
def test_arm_on_page_shows_its_calibrated_camera(arm, sources, name, shown):
    with PageCameras(RealClock(), sources, name) as cameras, ExitStack() as exits:
        video = cameras.open_before(arm, exits)
        assert (video and video.source) == shown
        assert cameras.open_before(arm, exits) is video


@pytest.mark.parametrize(
    ("sources", "called", "choices", "chosen"),
    [
        (["0", "1", "2"], "", {"camera 0": ("0", ""), "camera 1": ("1", ""), "left": ("2", "left")},
         "camera 1"),
        ([], "left", {"camera 1": ("1", ""), "left": ("2", "left")}, "left"),
        (["7", "0"], "left", {"left": ("7", "left"), "camera 0": ("0", "")}, "left"),
        ([], "", {}, ""),
    ],
)  # fmt: skip
def test_cameras_on_page_are_chosen_by_name(arm, sources, called, choices, chosen):
    with PageCameras(RealClock(), sources, called) as cameras, ExitStack() as exits:
        own = ArmCameras(cameras, arm, exits)
        assert (own.choices, own.chosen) == (choices, chosen)
        for each, (source, name) in choices.items():
            own.choose(each)
            assert (own.video.source, own.name, own.chosen) == (source, name, each)
        with pytest.raises(UnknownNameError, match="no camera named 'right'"):
            own.choose("right")


def test_camera_view_uses_calibration_of_given_name(arm):
    with PageCameras(RealClock(), [], "left") as cameras, ExitStack() as exits:
        video = cameras.open_before(arm, exits)
        views = [CameraView(arm, video, RealClock(), name) for name in ("left", "")]
        seen = [view._model.T_base_camera for view in views]  # the second one by its source
        for view in views:
            view.close()
    assert seen[0] == pytest.approx(arm.camera.named("left").model().T_base_camera)
    assert seen[1] == pytest.approx(seen[0])
    with pytest.raises(UnknownNameError, match="no camera named 'right'"):
        PageCameras(RealClock(), [], "right").open_before(arm, ExitStack())


def test_each_simulated_arm_gets_its_own_simulated_camera():
    places = [ArmAtPort(load_model(name), "sim:?pose=home") for name in ("so101", "koch")]
    for place in places:
        with ikservo.open_arm(place.model.name, place.port) as arm:
            save_simulated_camera(arm)
    app = ViewApp(places, cameras=["sim"])
    with app:
        videos = [each.video for each in app.arms.all()]
        arms = [each.arm_thread.arm for each in app.arms.all()]
        assert [video.before for video in videos] == [arm.context.port.transport for arm in arms]
        view = CameraView(arms[1], videos[0], RealClock())
        with pytest.raises(BadMessageError, match="shows another simulated arm"):
            view.require_usable()
        view.close()


def test_calibration_reads_camera_that_page_has_open(arm):
    with PageCameras(RealClock(), ["0", "2"]) as cameras, ExitStack() as exits:
        own, webcam = ArmCameras(cameras, arm, exits), Webcam()
        own.choose("left")
        own.video._open = webcam.open
        with own.video.watched(), own.calibrating() as (camera, options):
            assert camera is own.video
            assert (options.camera, options.camera_name) == ("2", "left")
            camera.take()
        assert webcam.opened == 1
        own.video = None
        with pytest.raises(InputError, match="shows no camera"):
            own.calibrating().__enter__()


def test_simulated_camera_follows_its_reopened_arm():
    app = ViewApp([ArmAtPort(load_model("so101"), "sim:?pose=home")], cameras=["sim"])
    with app:
        served = app.arms.find("")
        assert served.arm_thread.calibration.open_camera == served.cameras.calibrating
        video, arm = served.video, served.arm_thread.arm
        with video.watched():
            first = video.take()
            arm.close("hold")
            again = served._open_arm()
            assert video.before is again.context.port.transport is not arm.context.port.transport
            again.move_joints({"shoulder_pan": 0.5})
            assert abs(video.take().astype(int) - first).mean() > 2.0
            again.close("hold")


def test_unknown_camera_of_one_arm_is_shown_as_its_error(
    arm,
):
    so101, koch = (ArmAtPort(load_model(name), "sim") for name in ("so101", "koch"))
    with pytest.raises(CalibrationError, match="koch has no calibrated camera"):
        ViewApp([koch], camera_name="left").__enter__()
    with pytest.raises(InputError, match="no camera or file /dev/videoNOTHERE"):
        ViewApp([koch], cameras=["/dev/videoNOTHERE"]).__enter__()
    app = ViewApp([so101, koch], camera_name="left")
    with app:
        fields = {each.name: each.fields()["camera"] for each in app.arms.all()}
    assert fields["so101"] == {
        "name": "camera 2",
        "trouble": "",
        "late": False,
        "calibrated": True,
        "choices": ["camera 1", "left"],
        "chosen": "left",
    }
    assert "no calibrated camera" in fields["koch"]["trouble"]


@pytest.mark.parametrize("stored", ["rtsp://…@cam/1", "rtsp://admin:older@cam/1"])
def test_camera_name_on_page_does_not_contain_password(arm, stored):
    save_simulated_camera(arm, source=stored)
    given = "rtsp://admin:swordfish@cam/1"
    with PageCameras(RealClock(), ["0", given]) as cameras, ExitStack() as exits:
        video = cameras.open_before(arm, exits)
        assert (video.source, video.name) == (given, "…@cam/1")
        assert cameras.choices(arm)["…@cam/1"] == (given, "")
        CameraView(arm, video, RealClock())
    with (
        PageCameras(RealClock(), ["0"]) as cameras,
        ExitStack() as exits,
        pytest.raises(CalibrationError, match=r"calibrated with camera rtsp://…@cam/1, not this"),
    ):
        CameraView(arm, cameras.open_before(arm, exits), RealClock())


def test_page_says_how_an_uncalibrated_camera_is_calibrated():
    app = ViewApp([ArmAtPort(load_model("koch"), "sim")], cameras=["sim"])
    with app:
        koch = app.arms.find("")
        assert koch.fields()["camera"]["calibrated"] is False
        said = [entry.message for entry in koch.controller._interaction.messages]
    assert any("ikservo calibrate koch --camera 0" in each for each in said)
