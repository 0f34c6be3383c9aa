"""``base`` in an arm file places the arm in the model and in the simulator."""

import shutil

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, FileFormatError
from ikservo.kinematics.se3 import exp_so3, make_pose
from ikservo.model import load_model
from ikservo.model.base_placement import parse_frame
from ikservo.model.collision_capsules import collision_body
from servosim.arm_file import read_arm_file
from servosim.dynamics import RigidArm
from tests.oracle import CONFIGS


@pytest.fixture
def placed(tmp_path):
    def copy(base):
        folder = tmp_path / "planted"
        shutil.copytree(CONFIGS / "so101", folder, dirs_exist_ok=True)
        text = (CONFIGS / "so101" / "arm.toml").read_text().replace('"so101"', '"planted"', 1)
        (folder / "arm.toml").write_text(f'base = "{base}"\n{text}')
        return folder

    return copy


def test_base_placement_words_give_rotation_and_offset():
    T = make_pose(np.zeros(3), exp_so3([0.0, 0.0, np.pi / 2]))
    lifted = make_pose(np.array([0.2, 0.0, 0.05]))
    assert np.allclose(parse_frame("rotate 90, raise 0.05, forward 0.2"), lifted @ T)


@pytest.mark.parametrize("base", ["rotate 90, raise 0.05", "left -0.1", "upside down, raise 0.6"])
def test_model_and_simulator_agree_on_base_placement(placed, base):
    plain, folder = load_model("so101"), placed(base)
    model, simulated = load_model(folder), read_arm_file(folder / "arm.toml")
    q = plain.chain_pose("home")
    assert np.allclose(model.chain.forward(q), parse_frame(base) @ plain.chain.forward(q))
    body = RigidArm(simulated.urdf, model.chain.names, base=simulated.base)
    tip_m = body.tip(model.chain.tip).position_m(q.tolist())
    assert np.allclose(tip_m, model.chain.forward(q)[:3, 3])
    still = [0.0] * len(q)
    loads = [each.load_nm(q.tolist(), still)
             for each in (body, RigidArm(simulated.urdf, model.chain.names))]  # fmt: skip
    assert np.allclose(*loads) == ("upside" not in base)
    boxes = [collision_body(each).floor_distances(q[None], 0.0).pairs for each in (plain, model)]
    assert boxes[0] == boxes[1]  # the base stands on the table, wherever it stands


@pytest.mark.full
def test_arm_on_turned_base_moves_to_point_of_table(placed):
    folder = placed("rotate 90, raise 0.05")
    with ikservo.open_arm(folder, port="sim:?pose=home", uncalibrated=True) as arm:
        assert arm.move_to((0.0, 0.25, 0.2)).reached
        assert arm.where().tip_m == pytest.approx((0.0, 0.25, 0.2), abs=0.003)


def test_unknown_base_placement_words_are_refused(placed):
    with pytest.raises(FileFormatError, match="base"):
        load_model(placed("sideways 3"))


@pytest.mark.parametrize("base", ["rotate 1e300", "raise inf", "left nan", "forward -1e9"])
def test_base_placement_value_out_of_range_is_refused(base):
    with pytest.raises(BadValueError):
        parse_frame(base)
