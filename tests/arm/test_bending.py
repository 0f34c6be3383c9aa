"""A calibrated arm with compliant links brings its true, sagging tip to the target."""

import numpy as np
import pytest

from ikservo.arm.opening import open_own_arm
from ikservo.calibration.calibration_file import (
    dump_calibration,
    read_calibration,
    save_calibration,
)
from ikservo.calibration.paths import calibration_path
from ikservo.errors import ConstraintError, RefusedError
from ikservo.planning.path_constraint import PathConstraint
from servosim.joint import Hand, hold
from servosim.specimen import Specimen
from tests.calibration.mounted_arms import STRENGTH, load_model
from tests.cli.fixtures_mounted_arm import PORT, SERIAL, connect_arm, write_calibration

COMPLIANCE = {"shoulder_lift": 0.12, "elbow_flex": 0.08, "wrist_flex": 0.05}


@pytest.fixture
def own_arm(tmp_path, monkeypatch):
    """Connect a calibrated arm with compliant links."""
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    model = load_model("so101")
    same = dict.fromkeys((joint.name for joint in model.joints), 1.0)
    specimen = Specimen(mass_scales=same, compliances=COMPLIANCE)
    arm = connect_arm(monkeypatch, "so101", gravity=True, specimen=specimen, spoiled=False)
    for joint in arm.world.joints:
        arm.world.grasp(joint.name, Hand(hold(joint.position), STRENGTH))
    write_calibration(arm)
    for joint in arm.world.joints:
        arm.world.release(joint.name)
    return arm


def learn(compliance):
    calibration = read_calibration(calibration_path("so101", SERIAL))
    joints = [
        joint.model_copy(update={"compliance": compliance.get(joint.name, 0.0)})
        for joint in calibration.joints
    ]
    save_calibration(calibration.model_copy(update={"joints": tuple(joints)}))


def true_tip_m(arm):
    return arm.world.tip.position_m([joint.position for joint in arm.world.joints])


@pytest.mark.sample(1)
@pytest.mark.full
@pytest.mark.parametrize(
    ("known", "low_m", "high_m"),
    [({}, 0.006, 0.05), (COMPLIANCE, 0.0, 0.002)],
)
def test_compliance_in_calibration_brings_true_tip_to_target(own_arm, known, low_m, high_m):
    learn(known)
    errors_m = []
    with open_own_arm(load_model("so101"), PORT) as opened:
        for point in ((0.25, 0.05, 0.15), (0.3, -0.08, 0.12), (0.28, 0.02, 0.1)):
            opened.move_to(point)
            errors_m.append(np.linalg.norm(true_tip_m(own_arm) - point))
            if known:
                where = np.array(opened.where().tip_m)
                np.testing.assert_allclose(where, true_tip_m(own_arm), atol=0.002)
    assert low_m <= max(errors_m) <= high_m


def test_calibration_file_of_rigid_arm_omits_compliance(own_arm):
    path = calibration_path("so101", SERIAL)
    text = path.read_text()
    assert "compliance" not in text
    assert "play" not in text
    assert dump_calibration(read_calibration(path)) == text


def test_compliance_is_kept_in_calibration_file(own_arm):
    learn(COMPLIANCE)
    found = read_calibration(calibration_path("so101", SERIAL))
    assert found.joint("shoulder_lift").compliance == 0.12
    assert found.joint("gripper").compliance == 0.0


@pytest.mark.full
def test_collision_and_constraint_checks_use_sagged_links(own_arm):
    learn(COMPLIANCE)
    with open_own_arm(load_model("so101"), PORT) as opened:
        opened.move_to((0.3, 0.0, 0.12))
        droop_m = opened.context.chain.rigid.forward(opened.where().positions_rad[:5])[2, 3]
        assert droop_m - opened.where().tip_m[2] > 0.008  # a rigid arm would stay above
        above = PathConstraint(above_m=(0.0, 0.0, 0.1))
        with pytest.raises(ConstraintError):
            opened.move_to((0.3, 0.0, 0.095), within=above)
        with pytest.raises(RefusedError):
            opened.move_to((0.3, 0.0, -0.005))
