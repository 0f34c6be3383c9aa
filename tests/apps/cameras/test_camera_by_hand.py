"""A hand moves a limp arm in front of a camera: pictures are used while the arm is still."""

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import (
    load_calibration,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.paths import calibration_path
from ikservo.errors import CalibrationError
from servosim.joint import Hand
from tests.arm.seeds import log, part_of
from tests.calibration.mounted_arms import STRENGTH, load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, WHEN

cv2 = pytest.importorskip("cv2")

from ikservo.apps.cameras.camera_by_hand import HandCalibration  # noqa: E402
from ikservo.apps.cameras.camera_calibration import ArmBefore, save_camera_result  # noqa: E402
from tests.apps.cameras.hidden_arms import (  # noqa: E402
    BOARD,
    finish,
    hidden_arm,
    tip_errors_m,
)
from tests.apps.cameras.test_click_campaign import arm_before_a_camera  # noqa: E402

REACH_RAD, MOVING_S, POSTURE_S = 0.5, 0.7, 2.0


def wander(start, postures):
    """Return the path of a hand: from posture to posture, still for a while in each."""
    ends = np.append(start, start + postures)

    def path(time_s):
        number, since_s = divmod(time_s, POSTURE_S)
        number = min(int(number), len(ends) - 2)
        share = np.clip(since_s / MOVING_S, 0.0, 1.0)
        by = ends[number + 1] - ends[number]
        return ends[number] + share * by, by / MOVING_S if share < 1.0 else 0.0

    return path


class Person:
    """Holds the arm, moves it from posture to posture, and looks at the camera's pictures."""

    def __init__(self, arm, camera, seed=0, spoil=None):
        self._camera, self._spoil, self._taken = camera, spoil, 0
        chance, self.hint = np.random.default_rng(seed), ""
        for joint in arm.world.joints:
            path = wander(joint.position, chance.uniform(-REACH_RAD, REACH_RAD, 60))
            arm.world.grasp(joint.name, Hand(path, STRENGTH))

    def take(self):
        self._taken += 1
        picture = self._camera.take()
        return picture if self._spoil is None else self._spoil(picture, self._taken)


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


def run_by_hand(monkeypatch, spoil=None, count=12, meanwhile=None):
    """Return result, messages, arm and camera of a calibration by hand."""
    arm, camera = hidden_arm(monkeypatch, "so101", 0)
    said = []
    with open_own_arm(load_model("so101"), PORT) as opened:
        opened.disable_torque()
        person = Person(arm, camera, spoil=spoil)
        if meanwhile is not None:
            meanwhile(opened)
        session = HandCalibration(opened, person, BOARD, count)
        return finish(session.run(), said), said, arm, camera


def errors_over_workspace_m(arm, camera, name="so101"):
    """Return the distances between the true tip and that of the saved calibration, m."""
    with open_own_arm(load_model(name), PORT) as opened:
        here, names = opened.where(), opened.chain.names
        off = np.array([here[name].position_rad - arm.true_position(name) for name in names])
        T = opened.camera.model().T_base_camera
        return tip_errors_m(arm, camera, opened.chain, off, np.linalg.inv(T))


@pytest.mark.full
@pytest.mark.timeout(600)
def test_camera_calibration_by_hand_is_saved_and_undone(monkeypatch, run_cli):
    arm, camera = hidden_arm(monkeypatch, "so101", 0, compliance=0.0)
    person = Person(arm, camera)
    monkeypatch.setattr("ikservo.apps.cameras.camera_sources.LiveCamera", lambda _: person)
    path = calibration_path("so101", SERIAL)
    before = path.read_text()
    done = run_cli(f"calibrate so101 --port {PORT} --camera 0 --by-hand --pictures 16 --yes --json")
    assert done.code == 0, done.err
    found = read_calibration(path)
    assert (done.json["pictures"], done.json["estimated"]) == (16, "camera and zeros")
    assert done.json["carried"] is None
    assert 0.002 < done.json["sag_m"] < 0.02
    assert "When the arm carries itself" in done.err
    assert found.camera.after_mm < 0.5 * found.camera.before_mm
    assert np.median(errors_over_workspace_m(arm, camera)) < 0.003
    assert run_cli(f"calibration undo so101 --port {PORT}").code == 0
    assert path.read_text() == before


def carry(arm, monkeypatch, share):
    """Let the hand carry a fraction of the arm's weight, so that its links bend less."""
    bend = arm.world.tip.link_positions

    def bend_less(positions):
        return np.asarray(positions) + (1.0 - share) * np.subtract(bend(positions), positions)

    monkeypatch.setattr(arm.world.tip, "link_positions", bend_less)


def save_compliances(name, seed, wrong=0.0):
    """Save the compliances of a hidden arm with relative errors; return its joints."""
    chance, model = np.random.default_rng(seed), load_model(name)
    known = load_calibration(name, SERIAL)
    compliance = chance.uniform(0.0, 0.15, model.chain.dof)  # as ``hidden_arm`` draws them
    compliance *= chance.uniform(1.0 - wrong, 1.0 + wrong, model.chain.dof)
    by_name = dict(zip(model.chain.names, compliance.tolist(), strict=True))
    joints = tuple(
        joint.model_copy(update={"compliance": by_name.get(joint.name, 0.0)})
        for joint in known.joints
    )
    save_calibration(known.model_copy(update={"joints": joints}))
    return joints


@pytest.mark.campaign
@pytest.mark.timeout(0)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_camera_calibration_by_hand_reaches_4_mm(monkeypatch, capsys, name, share):
    everywhere_m = []
    for seed in part_of(5):
        arm, camera = arm_before_a_camera(monkeypatch, name, seed)
        save_compliances(name, seed, wrong=0.15)
        with open_own_arm(load_model(name), PORT) as opened:
            with monkeypatch.context() as by_hand:
                carry(arm, by_hand, share)
                opened.disable_torque()
                session = HandCalibration(opened, Person(arm, camera, seed), BOARD, 30)
                result = finish(session.run())
            save_camera_result(ArmBefore.of(opened), "0", result, WHEN)
        everywhere_m.append(errors_over_workspace_m(arm, camera, name))
        log(capsys, f"{name} {seed}, {share} carried: median {np.median(everywhere_m[-1])} m")
    assert np.percentile(everywhere_m, 95) < 0.004


@pytest.mark.campaign
@pytest.mark.timeout(600)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_camera_calibration_by_hand_keeps_known_compliance(monkeypatch, run_cli, share):
    arm, camera = hidden_arm(monkeypatch, "so101", 1)
    joints = save_compliances("so101", 1)
    person = Person(arm, camera)
    monkeypatch.setattr("ikservo.apps.cameras.camera_sources.LiveCamera", lambda _: person)
    with monkeypatch.context() as by_hand:
        carry(arm, by_hand, share)
        done = run_cli(f"calibrate so101 --port {PORT} --camera 0 --by-hand --pictures 16 --yes")
    assert done.code == 0, done.err
    assert f"the arm carried about {1.0 - share:.0%} of its weight" in done.out
    assert "carries itself" not in done.out
    found = read_calibration(calibration_path("so101", SERIAL))
    assert [joint.compliance for joint in found.joints] == [joint.compliance for joint in joints]
    median_m = np.median(errors_over_workspace_m(arm, camera))
    assert median_m < 0.002  # 8 mm where the hand carried it and the arm is taken to have done so


@pytest.mark.campaign
def test_camera_calibration_by_hand_uses_pictures_at_rest_only(monkeypatch):
    result, said, *_ = run_by_hand(monkeypatch)
    assert result.pictures == 12
    assert [line for line in said if line.startswith("picture")] == [
        f"picture {i} of 12 taken: move the arm to another posture" for i in range(1, 13)
    ]
    assert len(result.estimate.fit.kept) == 12
    assert result.estimate.fit.kept.all()  # a picture of a moving arm would be an outlier
    assert result.duration_s > 11 * POSTURE_S - 1.0


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda picture, n: np.full_like(picture, 100 + n % 2),
            "0 of 12 so far. The board .* is not in the picture",
        ),
        (lambda picture, _: np.full_like(picture, 100), "same picture"),
    ],
)
def test_camera_calibration_by_hand_ends_if_board_is_never_seen(monkeypatch, spoil, message):
    monkeypatch.setattr("ikservo.apps.cameras.camera_by_hand._WAIT_S", 3.0)
    with pytest.raises(CalibrationError, match=message):
        run_by_hand(monkeypatch, spoil)


def test_camera_calibration_by_hand_refuses_arm_with_torque_on(monkeypatch):
    with pytest.raises(CalibrationError, match="no longer limp"):
        run_by_hand(monkeypatch, meanwhile=lambda opened: opened.enable())


def test_camera_calibration_by_hand_needs_consent_and_camera(monkeypatch, run_cli):
    _, camera = hidden_arm(monkeypatch, "so101", 3)
    monkeypatch.setattr("ikservo.apps.cameras.camera_sources.LiveCamera", lambda _: camera)
    words = f"calibrate so101 --port {PORT} --by-hand"
    refused = run_cli(f"{words} --camera 0")
    assert (refused.code, "--yes" in refused.err) == (2, True)
    assert "Add --camera" in run_cli(words).err
