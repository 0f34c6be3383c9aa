"""An arm with several cameras: each is stored and chosen by its name."""

import pytest

import ikservo
from ikservo.apps.calibrating.calibration_session import find_lost_camera
from ikservo.apps.cameras.camera_file import SIMULATED, camera_names, load_camera, save_camera
from ikservo.calibration.calibration_file import dump_calibration, parse_calibration
from ikservo.errors import InputError, UnknownNameError

pytest.importorskip("cv2")

from ikservo.apps.cameras.camera_and_arm_fit import Extent
from ikservo.apps.cameras.camera_calibration import ArmBefore
from servosim.camera import SimulatedCamera
from tests.apps.cameras.saved_camera import save_simulated_camera
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import connect_arm, write_calibration

ARM = "so101 --port sim:?pose=home"


@pytest.fixture
def arm(tmp_path, monkeypatch):
    """Return an arm with two cameras, ``left`` 0.1 m beside the one without a name."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr(SimulatedCamera, "set_stage", lambda _: None)  # the board is enough
    with ikservo.open_arm("so101", "sim:?pose=home") as arm:
        save_simulated_camera(arm)
        _, known = load_camera("so101", SIMULATED)
        x, y, z = known.camera.at_mm
        left = known.camera.model_copy(update={"at_mm": (x, y + 100.0, z), "source": "1"})
        save_camera("so101", SIMULATED, known.model_copy(update={"camera": left}), "left")
        yield arm


def test_each_named_camera_uses_its_own_calibration(arm):
    assert camera_names("so101", SIMULATED) == ["", "left"]
    here = arm.camera.point_on_table(480, 500)
    there = arm.camera.named("left").point_on_table(480, 500)
    assert there - here == pytest.approx([0.0, 0.1, 0.0])


def test_look_and_camera_check_choose_camera_by_name(arm, run_cli):
    arm.close()
    here = run_cli(f"look 480 500 --arm {ARM} --json").json["point_m"]
    there = run_cli(f"look 480 500 --arm {ARM} --camera-name left --json").json["point_m"]
    assert there[1] - here[1] == pytest.approx(0.1)
    assert run_cli(f"camera check {ARM} --camera sim").code == 0
    moved = run_cli(f"camera check {ARM} --camera sim --camera-name left")
    assert (moved.code, "has moved" in moved.out) == (6, True)
    assert run_cli(f"look 480 500 --arm {ARM} --camera-name left").code == 6
    assert run_cli(f"look 480 500 --arm {ARM}").code == 0


def test_look_command_selects_camera_by_source(arm, run_cli):
    arm.close()
    named = run_cli(f"look 480 500 --arm {ARM} --camera-name left --json").json["point_m"]
    assert run_cli(f"look 480 500 --arm {ARM} --camera 1 --json").json["point_m"] == named
    other = run_cli(f"look 480 500 --arm {ARM} --camera rtsp://me:secret@host/x")
    assert (other.code, "secret" in other.err) == (6, False)
    assert "calibrated with camera sim, not rtsp://" in other.err


def test_unknown_camera_name_error_lists_known_cameras(arm, run_cli):
    with pytest.raises(UnknownNameError, match="no camera named 'right'") as refused:
        arm.camera.named("right")
    assert "Known: left" in refused.value.hint
    arm.close()
    done = run_cli(f"look 480 500 --arm {ARM} --camera-name ../a")
    assert (done.code, "no camera named" in done.err) == (2, True)
    words = f"calibrate {ARM} --camera sim --yes --camera-name ../a"
    assert "--camera-name is '../a'" in run_cli(words).err


def test_camera_name_is_needed_only_if_there_are_several(arm):
    camera, known = load_camera("so101", SIMULATED, "left")
    folder = ikservo.calibration.paths.camera_path("so101", SIMULATED)
    folder.unlink()
    assert arm.camera.model().T_base_camera[1, 3] == pytest.approx(camera.at_mm[1] / 1000)
    save_camera("so101", SIMULATED, known, "right")
    with pytest.raises(InputError, match="several cameras") as refused:
        arm.camera.point_on_table(480, 500)
    assert "left, right" in refused.value.hint


def test_calibration_stores_several_cameras_and_reads_old_one(arm, tmp_path, monkeypatch):
    camera = load_camera("so101", SIMULATED)[0]
    mounted = connect_arm(monkeypatch, "so101")
    plain = write_calibration(mounted)
    one = plain.with_cameras({"": camera})
    assert "[cameras" not in dump_calibration(one)
    both = one.with_cameras({"": camera, "left": camera})
    found = parse_calibration(tmp_path / "a.toml", dump_calibration(both))
    assert found.cameras_by_name == {"": camera, "left": camera}
    model = load_model("so101")
    assert ArmBefore(model, both).extents("right", by_hand=False) == (Extent.CAMERA,)
    assert ArmBefore(model, one).extents("", by_hand=False) == tuple(Extent)
    assert ArmBefore(model, one).extents("", by_hand=True) == (Extent.CAMERA, Extent.ZEROS)
    assert ["--camera-name left" in line for line in find_lost_camera(found)] == [False, True]
