"""`--save-pictures` and `--from-pictures`: a calibration is repeated without the arm."""

import re
import signal

import pytest

from ikservo.apps.cameras.camera_calibration import CameraCalibration
from ikservo.apps.cameras.camera_dialogue import _kept_at_failure
from ikservo.apps.cameras.picture_folder import PictureFolder, PictureIndex
from ikservo.calibration.calibration_file import read_calibration
from ikservo.calibration.paths import calibration_path
from ikservo.cli.terminal import print_status
from ikservo.files.reading import config_dir
from tests.apps.cameras.test_camera_by_hand import Person
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL

pytest.importorskip("cv2")

from tests.apps.cameras.hidden_arms import hidden_arm

REPEAT = "calibrate so101 --yes --json --from-pictures"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_camera_calibration_is_repeated_from_saved_pictures(tmp_path, monkeypatch, run_cli):
    arm, camera = hidden_arm(monkeypatch, "so101", 0)
    person = Person(arm, camera)
    monkeypatch.setattr("ikservo.apps.cameras.camera_sources.LiveCamera", lambda _: person)
    folder, path = tmp_path / "pictures", calibration_path("so101", SERIAL)
    words = f"calibrate so101 --port {PORT} --camera 0 --by-hand --pictures 12 --yes --json"
    first = run_cli(f"{words} --save-pictures {folder}")
    assert first.code == 0, first.err
    found = read_calibration(path)
    assert run_cli(f"calibration undo so101 --port {PORT}").code == 0

    monkeypatch.setattr(
        "ikservo.apps.cameras.camera_sources.LiveCamera", None
    )  # neither camera nor arm
    monkeypatch.setattr("ikservo.hardware.port.open_transport", None)
    undone = path.read_bytes()
    unasked = run_cli(f"calibrate so101 --json --from-pictures {folder}")
    assert (unasked.code, unasked.json["path"]) == (0, None)
    assert path.read_bytes() == undone
    again = run_cli(f"{REPEAT} {folder}")
    assert again.code == 0, again.err
    assert again.json["estimated"] == first.json["estimated"]
    assert again.json["after_m"] == pytest.approx(first.json["after_m"], rel=1e-4)
    repeated = read_calibration(path)
    assert [j.name for j in repeated.joints] == [j.name for j in found.joints]
    assert repeated.camera.at_mm == pytest.approx(found.camera.at_mm, abs=0.01)
    assert repeated.camera.turned_deg == pytest.approx(found.camera.turned_deg, abs=0.01)

    before = path.read_bytes()
    refused = run_cli(f"{words} --save-pictures {folder}")
    assert (refused.code, "is not empty" in refused.err) == (2, True)
    assert "arm: is so101" in run_cli(f"calibrate koch --yes --from-pictures {folder}").err
    (folder / "picture-003.png").write_bytes(b"no picture")
    damaged = run_cli(f"{REPEAT} {folder}")
    assert (damaged.code, "picture-003.png" in damaged.err) == (2, True)
    assert path.read_bytes() == before


def test_empty_picture_folder_is_refused(tmp_path, run_cli):
    index = PictureIndex(arm="so101", source="0", camera_name="", board="5x7-12mm-4x4",
                         by_hand=True, joints=load_model("so101").chain.names)  # fmt: skip
    PictureFolder(tmp_path / "pictures", index, None)
    done = run_cli(f"{REPEAT} {tmp_path / 'pictures'}")
    assert (done.code, "No picture shows the board" in done.err) == (6, True)


def test_camera_repeat_refuses_bad_folder_and_extra_options(tmp_path, run_cli):
    missing = run_cli(f"{REPEAT} {tmp_path}")
    assert (missing.code, "pictures.toml" in missing.err) == (2, True)
    assert "Leave those out" in run_cli(f"{REPEAT} {tmp_path} --camera 0").err
    assert "does not move the arm" in run_cli(f"{REPEAT} {tmp_path} --touch").err


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_stopped_camera_calibration_keeps_its_pictures(monkeypatch, run_cli):
    keep, taken = CameraCalibration._keep, []

    def interrupted(self, picture):
        taken.append(picture)
        if len(taken) == 12:
            raise KeyboardInterrupt
        keep(self, picture)

    monkeypatch.setattr(CameraCalibration, "_keep", interrupted)
    words = "calibrate so101 --port sim:?pose=home --camera sim --pictures 13 --yes"
    stopped = run_cli(words)
    assert stopped.code == 130
    assert re.search(r"picture 9 of 13, 69 %, about \d+ s left", stopped.err)
    (again,) = re.findall(r"To calibrate with them: ikservo (.*)", stopped.err)
    (folder,) = (config_dir() / "pictures").iterdir()
    assert again == f"calibrate so101 --from-pictures {folder}"
    assert run_cli(f"{again} --yes").code == 0


@pytest.mark.parametrize(
    ("taken", "chosen", "said", "stays"),
    [
        (6, False, "--from-pictures", True),
        (5, False, "at least 6. Start it again", False),
        (5, True, "at least 6. Start it again", True),
        (0, True, "", False),
    ],
)
def test_stopped_camera_calibration_says_how_to_continue(
    tmp_path, capsys, taken, chosen, said, stays
):
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number in range(taken):
        (folder / f"picture-{number}.png").touch()
    kept = _kept_at_failure(folder, "so101", print_status, chosen=chosen)
    with pytest.raises(KeyboardInterrupt), kept:
        raise KeyboardInterrupt
    words = capsys.readouterr().err
    assert (said in words, bool(words)) == (True, taken > 0)
    assert folder.exists() is stays


@pytest.mark.parametrize("number", [signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)])
def test_signal_while_taking_picture_says_how_to_continue(tmp_path, capsys, number):
    folder = tmp_path / "pictures"
    folder.mkdir()
    for i in range(6):
        (folder / f"picture-{i}.png").touch()
    before = signal.signal(number, signal.SIG_IGN)  # the default would end the tests
    try:
        kept = _kept_at_failure(folder, "so101", print_status, chosen=False)
        with pytest.raises(SystemExit), kept:
            signal.raise_signal(number)
    finally:
        signal.signal(number, before)
    assert "--from-pictures" in capsys.readouterr().err
